//! The pipe to another simulator, a process beside the slot that docs/SIMULATORS.md describes:
//! starts the process, exchanges messages, and checks the answers.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::FileExt;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use benchmark::attempt::{MAX_PACKAGES, MAX_TEXT_BYTES};
use benchmark::{ACTION_WIDTH, Action, Parameters, UnknownName, VariantName};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use sim::{CameraRequest, Frame};

use crate::child::{connection, explain_status};
use crate::memory::OomKills;
use crate::message::MAX_LINE_BYTES;

/// Version of the pipe's messages.
const PROTOCOL: u32 = 1;
/// Meanings of an action's numbers, in the order of a policy's actions.
const DIMENSIONS: [&str; ACTION_WIDTH] = ["x", "y", "z", "roll", "pitch", "yaw", "gripper"];
/// Folder of files in memory; without it, frames pass through the folder of temporary files.
const SHARED_MEMORY: &str = "/dev/shm";
/// Longest wait for a process that was asked to end.
const END_DEADLINE: Duration = Duration::from_secs(1);

/// A simulator that a worker serves, written `NAME=COMMAND`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SimulatorCommand {
    /// Name in manifest rows.
    pub name: String,
    /// Command line, which `sh` reads.
    pub command: String,
}

impl std::str::FromStr for SimulatorCommand {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, command) =
            text.split_once('=').filter(|(_, command)| !command.trim().is_empty()).ok_or(
                "write NAME=COMMAND, such as metaworld='bin/rollout-env serve gym:Meta-World/MT1'",
            )?;
        VariantName::own(name).map_err(|_: UnknownName| {
            format!("the name is `{name}`: write 1 to 31 lower-case letters, digits and _")
        })?;
        Ok(Self { name: name.to_owned(), command: command.to_owned() })
    }
}

/// Reason why a simulator gave no usable answer. The messages are whole sentences.
#[derive(Debug, thiserror::Error)]
pub enum PipeError {
    /// The simulator cannot be used on this machine, as it is or as it was started.
    #[error("simulator `{simulator}` cannot be used: {problem}")]
    Unusable { simulator: String, problem: String },
    #[error("simulator `{simulator}` failed at {request}: {problem}")]
    Failed { simulator: String, request: &'static str, problem: String },
    #[error(
        "simulator `{simulator}` did not answer {request}: its process {status}; the worker's log \
         has what it printed"
    )]
    Ended { simulator: String, request: &'static str, status: String },
    /// The answer is no message of the pipe, so that the next one would not be understood either.
    #[error("simulator `{simulator}` answered {request} wrongly: {problem}")]
    Invalid { simulator: String, request: &'static str, problem: String },
    #[error(
        "simulator `{simulator}` did not answer {request} within {} s and was killed: it hangs, or \
         needs a longer `--progress-timeout-secs` of the coordinator",
        deadline.as_secs_f32()
    )]
    Late { simulator: String, request: &'static str, deadline: Duration },
}

/// Answer to `describe`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
pub struct Description {
    protocol: u32,
    pub tasks: Vec<Task>,
    pub cameras: Vec<Camera>,
    /// Sizes of the readings by name.
    pub state: BTreeMap<String, usize>,
    /// Meaning of each number of an action, one of [`DIMENSIONS`].
    action: Vec<String>,
    /// Axes that act in the simulator.
    pub axes: BTreeSet<String>,
    /// Version and digest of each package.
    pub packages: BTreeMap<String, String>,
    /// Name of the graphics driver; empty without one.
    pub driver: String,
    pub reused: bool,
}

#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Task {
    pub name: String,
    pub instruction: String,
    /// Step budget, control steps.
    pub max_steps: u32,
}

#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct Camera {
    pub name: String,
    /// Size of its frames, pixels.
    pub width: u32,
    pub height: u32,
    /// True if frames of any size are drawn.
    pub any_size: bool,
}

/// Readings by name.
pub type State = BTreeMap<String, Vec<f64>>;

#[derive(Clone, Debug, Deserialize)]
pub struct Reset {
    /// SHA-256 of the first observation, hex.
    pub digest: String,
    pub state: State,
}

#[derive(Clone, Debug, Deserialize)]
pub struct Step {
    executed: usize,
    pub success: bool,
    /// True if the simulator ended the rollout.
    pub ended: bool,
    pub state: State,
}

/// A running simulator. Its process is ended when this value is dropped.
#[derive(Debug)]
pub struct Pipe {
    simulator: String,
    process: Child,
    stream: BufReader<UnixStream>,
    frames: File,
    /// Frames of the rollout under way.
    cameras: Vec<CameraRequest>,
    pub about: Description,
    kills_before: OomKills,
}

impl Pipe {
    /// Starts a simulator and reads its description; waits at most `deadline` for it.
    pub fn start(of: &SimulatorCommand, deadline: Duration) -> Result<Self, PipeError> {
        let failed = |error: io::Error| PipeError::Unusable {
            simulator: of.name.clone(),
            problem: format!("it cannot be started ({error})"),
        };
        let folder = Path::new(SHARED_MEMORY);
        let frames = match folder.is_dir() {
            true => tempfile::NamedTempFile::new_in(folder),
            false => tempfile::NamedTempFile::new(),
        };
        let frames = frames.map_err(failed)?;
        let (stream, stdin) = connection().map_err(failed)?;
        // What libraries print to standard output is for the log too.
        let stdout = io::stderr().as_fd().try_clone_to_owned().map_err(failed)?;
        let process = Command::new("sh")
            .args(["-c", &format!("exec {}", of.command)])
            .stdin(stdin)
            .stdout(Stdio::from(stdout))
            .spawn()
            .map_err(failed)?;
        let mut pipe = Self {
            simulator: of.name.clone(),
            process,
            stream: BufReader::new(stream),
            frames: frames.reopen().map_err(failed)?,
            cameras: Vec::new(),
            about: Description::default(),
            kills_before: OomKills::read(),
        };
        let fields = json!({"protocol": PROTOCOL, "frames": frames.path()});
        // The file loses its name once both sides have opened it.
        pipe.about = pipe.call("describe", fields, deadline)?;
        pipe.check()?;
        Ok(pipe)
    }

    fn check(&self) -> Result<(), PipeError> {
        let unusable = |problem: String| {
            Err(PipeError::Unusable { simulator: self.simulator.clone(), problem })
        };
        let Description { protocol, tasks, action, packages, driver, .. } = &self.about;
        if *protocol != PROTOCOL {
            return unusable(format!(
                "it speaks version {protocol} of the pipe, this worker version {PROTOCOL}: install \
                 the rollout-env of the worker's release"
            ));
        }
        if tasks.is_empty() {
            return unusable("it describes no task: name some with --tasks".to_owned());
        }
        let mut texts = packages.iter().flat_map(|(name, value)| [name, value]).chain([driver]);
        if packages.len() > MAX_PACKAGES || texts.any(|text| text.len() > MAX_TEXT_BYTES) {
            return unusable(format!(
                "it names {} packages and its driver; results hold {MAX_PACKAGES} packages and \
                 texts of {MAX_TEXT_BYTES} bytes",
                packages.len()
            ));
        }
        let is_repeated = |at: usize| action[..at].contains(&action[at]);
        let is_invalid = |at: &usize| !DIMENSIONS.contains(&&*action[*at]) || is_repeated(*at);
        match (0..action.len()).find(is_invalid) {
            None => Ok(()),
            Some(at) => unusable(format!(
                "number {at} of its actions means `{}`, and a policy's numbers are matched by name: \
                 name each once with --action, of {}",
                action[at],
                DIMENSIONS.join(", ")
            )),
        }
    }

    pub fn reset(
        &mut self,
        (task, seed): (&str, u16),
        cameras: Vec<CameraRequest>,
        perturb: &Parameters,
        deadline: Duration,
    ) -> Result<Reset, PipeError> {
        let requested: Vec<Value> = cameras
            .iter()
            .map(|of| json!({"name": of.name, "width": of.width, "height": of.height}))
            .collect();
        let fields = json!({"task": task, "seed": seed, "cameras": requested, "perturb": perturb});
        self.cameras = cameras;
        let reset: Reset = self.call("reset", fields, deadline)?;
        let is_hex = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
        if reset.digest.len() != 64 || !reset.digest.bytes().all(is_hex) {
            let problem = "its `digest` is no SHA-256 in lower-case hex".to_owned();
            return Err(self.failed("reset", problem));
        }
        self.check_state("reset", &reset.state)?;
        Ok(reset)
    }

    /// Executes a policy's action; draws afterwards if `frames` is true.
    pub fn step(
        &mut self,
        action: &Action,
        frames: bool,
        deadline: Duration,
    ) -> Result<Step, PipeError> {
        let place = |name: &String| DIMENSIONS.iter().position(|dimension| dimension == name);
        let places = self.about.action.iter().filter_map(place);
        let numbers: Vec<f64> = places.map(|place| action[place]).collect();
        let fields = json!({"actions": [numbers], "frames": frames});
        let step: Step = self.call("step", fields, deadline)?;
        if step.executed != 1 {
            let problem = format!("it executed {} actions of 1", step.executed);
            return Err(self.failed("step", problem));
        }
        self.check_state("step", &step.state)?;
        Ok(step)
    }

    fn check_state(&self, request: &'static str, state: &State) -> Result<(), PipeError> {
        let sizes = self.about.state.iter();
        let mut wrong = sizes
            .filter(|(name, size)| state.get(*name).is_none_or(|values| values.len() != **size));
        match wrong.next() {
            None => Ok(()),
            Some((name, size)) => {
                let given = state.get(name).map_or(0, Vec::len);
                let problem = format!(
                    "reading `{name}` has {given} numbers and is described with {size}; \
                     `rollout-env check` looks for the cause"
                );
                Err(self.failed(request, problem))
            }
        }
    }

    /// Returns the frames that the last request drew.
    pub fn frames(&self) -> Result<Vec<Frame>, PipeError> {
        let mut offset = 0;
        let frame = |camera: &CameraRequest| {
            let CameraRequest { name, width, height } = camera.clone();
            let mut rgb = vec![0; width as usize * height as usize * 3];
            self.frames.read_exact_at(&mut rgb, offset)?;
            offset += rgb.len() as u64;
            Ok(Frame { camera: name, width, height, rgb })
        };
        let frames = self.cameras.iter().map(frame).collect::<io::Result<_>>();
        frames.map_err(|error| self.failed("step", format!("its frames cannot be read ({error})")))
    }

    pub(crate) fn failed(&self, request: &'static str, problem: String) -> PipeError {
        PipeError::Failed { simulator: self.simulator.clone(), request, problem }
    }

    fn call<T: DeserializeOwned>(
        &mut self,
        request: &'static str,
        fields: impl Serialize,
        deadline: Duration,
    ) -> Result<T, PipeError> {
        let line = match self.exchange(&json!({request: fields}), deadline) {
            Ok(line) => line,
            Err(error) if is_timeout(&error) => {
                let _ = self.process.kill();
                let simulator = self.simulator.clone();
                return Err(PipeError::Late { simulator, request, deadline });
            }
            // The status says more than the error of a connection whose other end is closed.
            Err(_) => Vec::new(),
        };
        if line.is_empty() {
            let (simulator, status) = (self.simulator.clone(), self.end_status());
            return Err(PipeError::Ended { simulator, request, status });
        }
        let invalid = |problem: String| {
            let simulator = self.simulator.clone();
            PipeError::Invalid { simulator, request, problem }
        };
        let answer: Result<Map<String, Value>, _> = serde_json::from_slice(&line);
        let mut answer =
            answer.map_err(|error| invalid(format!("the answer is no line of JSON ({error})")))?;
        if let Some(error) = answer.remove("error") {
            let text = |field: &str| error[field].as_str().unwrap_or_default().to_owned();
            let (simulator, problem) = (self.simulator.clone(), text("message"));
            return Err(match &*text("kind") {
                "unusable" => PipeError::Unusable { simulator, problem },
                _ => PipeError::Failed { simulator, request, problem },
            });
        }
        let fields = answer.remove(request).unwrap_or_default();
        serde_json::from_value(fields).map_err(|error| {
            let problem = benchmark::JsonError::from(error);
            invalid(format!("{problem}; docs/SIMULATORS.md has the fields"))
        })
    }

    /// Sends a line and returns the answer, which is empty at the end of the connection.
    fn exchange(&mut self, message: &Value, deadline: Duration) -> io::Result<Vec<u8>> {
        let stream = self.stream.get_mut();
        stream.set_read_timeout(Some(deadline))?;
        stream.set_write_timeout(Some(deadline))?;
        stream.write_all(format!("{message}\n").as_bytes())?;
        let mut line = Vec::new();
        self.stream.by_ref().take(MAX_LINE_BYTES).read_until(b'\n', &mut line)?;
        Ok(line)
    }

    /// Returns how the process ended; the text follows the words "its process".
    fn end_status(&mut self) -> String {
        match self.wait_for_end() {
            Some(status) => explain_status(status, OomKills::read().since(self.kills_before)),
            None => "closed its connection".to_owned(),
        }
    }

    fn wait_for_end(&mut self) -> Option<std::process::ExitStatus> {
        let until = Instant::now() + END_DEADLINE;
        loop {
            match self.process.try_wait() {
                Ok(None) if Instant::now() < until => std::thread::sleep(END_DEADLINE / 100),
                ended => return ended.ok().flatten(),
            }
        }
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        let is_asked = self.stream.get_mut().write_all(b"{\"close\": {}}\n").is_ok();
        if !(is_asked && self.wait_for_end().is_some()) {
            let _ = self.process.kill();
            let _ = self.process.wait();
        }
    }
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut)
}

/// Describes each simulator, and leaves those out that cannot be used. Waits at most `deadline` for
/// each.
pub fn usable(given: Vec<SimulatorCommand>, deadline: Duration) -> Vec<SimulatorCommand> {
    let is_usable = |of: &SimulatorCommand| match Pipe::start(of, deadline) {
        Ok(pipe) => {
            let Description { tasks, axes, .. } = &pipe.about;
            tracing::info!(tasks = tasks.len(), ?axes, "serves simulator `{}`", of.name);
            true
        }
        Err(error) => {
            tracing::warn!("takes no rollouts of another simulator: {error}");
            false
        }
    };
    given.into_iter().filter(is_usable).collect()
}

#[cfg(test)]
mod tests;
