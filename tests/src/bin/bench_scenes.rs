//! Benchmark of memory and start time of slots that map compiled scenes from files: fills a
//! folder of scene files, then measures slots. Run by `cargo xtask bench scenes`.

use std::io::{BufRead, BufReader, Write, stdin};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Instant;
use std::{env, fs};

use anyhow::{Context, Result, bail, ensure};
use clap::Parser;
use libero_ctrl::{ManifestRow, Realisation, RolloutId, TaskRef};
use scene::pack::LIBERO;
use scene::{AssetPack, Sources, TaskFiles};
use serde::{Deserialize, Serialize};
use sim::{CameraRequest, ObservationRequest, Renderer, SceneFolder, Simulator, SimulatorConfig};
use tests::files::open_pack;

/// Number of scenes that a slot keeps, as in a worker.
const CACHED_SCENES: usize = 2;
/// Number of control steps after which a slot's memory is measured.
const STEPS: usize = 10;
/// Side of a frame, pixels.
const SIDE: u32 = 256;
const MIB: f64 = (1 << 20) as f64;
/// Script that prints how long the creation of an environment of a task takes, s.
const PYTHON: &str = "
import sys, time
import rollout_libero
start = time.perf_counter()
rollout_libero.Environment(sys.argv[1])
print(time.perf_counter() - start)
";
/// Script that steps many environments of the given tasks, then waits until its standard input is
/// closed.
const PYTHON_VECTOR: &str = "
import sys
import numpy as np
import rollout_libero
count = int(sys.argv[1])
environments = rollout_libero.VectorEnvironment(sys.argv[2:], count)
environments.reset(seed=0)
for _ in range(3):
    environments.step(np.zeros((count, 7), np.float32))
print('moved', flush=True)
sys.stdin.read()
";
/// Number of environments per task in the run with one Python process, and per process in the run
/// with [`PROCESSES`] processes.
const ENVIRONMENTS: usize = 16;
const PROCESSES: usize = 8;

/// Measure slots whose scenes lie in files.
#[derive(Parser)]
struct Arguments {
    /// Tasks, separated by commas. [default: all 40]
    #[arg(long, value_delimiter = ',')]
    tasks: Vec<TaskRef>,
    /// `libero`, `primitives`, or the path of a LIBERO assets folder.
    #[arg(long, default_value = LIBERO)]
    assets: String,
    /// Slots that use all scenes in turn.
    #[arg(long, default_value_t = 64)]
    slots: usize,
    /// Folder of the scene files, or `off`. [default: a temporary folder, empty at the start]
    #[arg(long)]
    scenes: Option<PathBuf>,
    /// Folder with the unpacked packages of robosuite and LIBERO.
    #[arg(long)]
    sources: Option<PathBuf>,
    /// An interpreter with `rollout_libero`, to time its environments. [default: not timed]
    #[arg(long)]
    python: Option<PathBuf>,
    /// Runs this process as a slot.
    #[arg(long, hide = true)]
    slot: bool,
}

/// Message of a slot whose rollout has started.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct RolloutStarted {
    /// Seconds until the rollout's first state was ready.
    secs: f64,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    match arguments.slot {
        true => run_slot(&arguments),
        false => measure(&arguments),
    }
}

/// Runs a slot: starts a rollout of each task read from standard input, reports how long the
/// start took, then renders and steps it.
fn run_slot(arguments: &Arguments) -> Result<()> {
    if let Some(scenes) = &arguments.scenes {
        SceneFolder::choose(scenes.as_os_str());
    }
    let dir = arguments.sources.clone();
    let sources = Sources::open(&dir.unwrap_or_else(Sources::default_dir))?;
    let pack = AssetPack::open(&arguments.assets, &sources)?;
    let mut simulator = Simulator::new(SimulatorConfig {
        sources: sources.clone(),
        pack: pack.clone(),
        renderer: Renderer::Software,
        cached_scenes: CACHED_SCENES,
    });
    // Like a worker's slot before its first rollout.
    simulator.fingerprint()?;
    for task in stdin().lock().lines() {
        let task: TaskRef = task?.parse()?;
        // Like a worker before it assigns a task to a slot.
        pack.provide_with_bar(&[TaskFiles::of_task(&sources, task)])?;
        let start = Instant::now();
        let row = ManifestRow::new(RolloutId::clean(task, 0), 0, 0, Default::default());
        let mut episode = simulator.begin(&row, Realisation::Matched)?;
        let secs = start.elapsed().as_secs_f64();
        let request = ObservationRequest {
            cameras: ["agentview", "robot0_eye_in_hand"]
                .map(|name| CameraRequest { name: name.to_owned(), width: SIDE, height: SIDE })
                .to_vec(),
            privileged: false,
        };
        println!("{}", serde_json::to_string(&RolloutStarted { secs })?);
        for step in 0..STEPS {
            episode.observe(&request)?;
            episode.step(&worker::measure::open_loop::smooth_action(step))?;
        }
        println!("moved");
    }
    if let Some(problem) = SceneFolder::take_problem() {
        bail!(problem);
    }
    Ok(())
}

/// A measured process: a slot or a Python program.
struct Slot {
    child: Child,
    commands: Option<ChildStdin>,
    responses: BufReader<ChildStdout>,
}

impl Slot {
    fn start(arguments: &Arguments, scenes: &Path) -> Result<Self> {
        let mut command = Command::new(env::current_exe()?);
        command.args(["--slot", "--assets", &arguments.assets]);
        command.arg("--scenes").arg(scenes);
        if let Some(sources) = &arguments.sources {
            command.arg("--sources").arg(sources);
        }
        Self::spawn(&mut command)
    }

    /// Starts a Python process with environments of the tasks.
    fn python(
        python: &Path,
        count: usize,
        tasks: &[TaskRef],
        variables: &[(&str, &Path)],
    ) -> Result<Self> {
        let mut command = Command::new(python);
        command.args(["-c", PYTHON_VECTOR, &count.to_string()]);
        command.args(tasks.iter().map(TaskRef::to_string));
        Self::spawn(command.envs(variables.iter().copied()))
    }

    fn spawn(command: &mut Command) -> Result<Self> {
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().context("start a slot")?;
        let responses = BufReader::new(child.stdout.take().expect("piped"));
        Ok(Self { commands: child.stdin.take(), responses, child })
    }

    /// Sends the slot a task to start.
    fn send(&mut self, task: TaskRef) -> Result<()> {
        let commands = self.commands.as_mut().context("the slot's input is closed")?;
        writeln!(commands, "{task}").context("send a slot its task")
    }

    fn wait_for_start(&mut self) -> Result<RolloutStarted> {
        Ok(serde_json::from_str(&self.line()?)?)
    }

    /// Waits until the slot has completed its steps.
    fn wait_for_steps(&mut self) -> Result<()> {
        ensure!(self.line()?.trim() == "moved", "the slot did not report `moved`");
        Ok(())
    }

    fn line(&mut self) -> Result<String> {
        let mut line = String::new();
        match self.responses.read_line(&mut line)? {
            0 => bail!("a slot ended early; its error output is above"),
            _ => Ok(line),
        }
    }

    fn memory(&self) -> Result<Memory> {
        let read = |file: &str, fields: &[&str]| -> Result<f64> {
            let path = format!("/proc/{}/{file}", self.child.id());
            let text = fs::read_to_string(&path).with_context(|| format!("read {path}"))?;
            let kib = |field: &&str| -> Result<f64> {
                let line = text.lines().find_map(|line| line.strip_prefix(*field));
                let line = line.with_context(|| format!("find {field} in {path}"))?;
                Ok(line.split_whitespace().next().unwrap_or_default().parse()?)
            };
            Ok(fields.iter().map(kib).sum::<Result<f64>>()? / 1024.0)
        };
        let tables = read("status", &["VmPTE:"])?;
        Ok(Memory {
            resident: read("smaps_rollup", &["Rss:"])?,
            private: read("smaps_rollup", &["Private_Clean:", "Private_Dirty:"])? + tables,
            proportional: read("smaps_rollup", &["Pss:"])? + tables,
        })
    }

    /// Resident part of the scene files that the slot maps.
    fn resident_of(&self, scenes: &Path) -> Result<f64> {
        let path = format!("/proc/{}/smaps", self.child.id());
        let text = fs::read_to_string(&path).with_context(|| format!("read {path}"))?;
        let folder = scenes.to_str().context("the folder's name is UTF-8")?;
        let (mut is_scene, mut kib) = (false, 0.0);
        for line in text.lines() {
            let mut words = line.split_whitespace();
            match words.next() {
                Some("Rss:") if is_scene => {
                    kib += words.next().unwrap_or_default().parse::<f64>()?;
                }
                Some(field) if !field.ends_with(':') => is_scene = line.contains(folder),
                _ => {}
            }
        }
        Ok(kib / 1024.0)
    }

    fn end(mut self) -> Result<()> {
        self.commands = None;
        ensure!(self.child.wait()?.success(), "a slot failed");
        Ok(())
    }
}

/// Memory of a process, MiB.
struct Memory {
    resident: f64,
    /// Private memory including page tables.
    private: f64,
    /// Proportional set size, which divides shared memory among its processes, including page
    /// tables.
    proportional: f64,
}

fn measure(arguments: &Arguments) -> Result<()> {
    let dir = arguments.sources.clone();
    let sources = Sources::open(&dir.unwrap_or_else(Sources::default_dir))?;
    let tasks = match &arguments.tasks[..] {
        [] => TaskRef::all().collect(),
        tasks => tasks.to_vec(),
    };
    open_pack(&arguments.assets, &sources, tasks.iter().copied())?;
    let empty = tempfile::tempdir().context("make a folder for scene files")?;
    let scenes = arguments.scenes.clone();
    let scenes = scenes.unwrap_or_else(|| empty.path().to_owned());
    println!(
        "{} tasks, assets {}, {} cores, scene files in {}",
        tasks.len(),
        arguments.assets,
        std::thread::available_parallelism()?,
        scenes.display()
    );
    let start = || Slot::start(arguments, &scenes);

    let row =
        |label: &str, value: String, target: &str| println!("{label:<48} {value:>22}  {target}");
    row("", "measured".to_owned(), "target");
    let first = start_times(start()?, &tasks)?;
    row("scene ready, first time: median, most", in_ms(&first), "");
    let bytes = total_size(&scenes).unwrap_or_default();
    row("scene files together", format!("{:.0} MiB", bytes as f64 / MIB), "");
    let ready = start_times(start()?, &tasks)?;
    row("scene ready, file present: median, most", in_ms(&ready), "<= 30 ms");

    let mut starts = Vec::new();
    for task in &tasks {
        let clock = Instant::now();
        let mut slot = start()?;
        slot.send(*task)?;
        slot.wait_for_start()?;
        starts.push(clock.elapsed().as_secs_f64());
        slot.wait_for_steps()?;
        slot.end()?;
    }
    row("slot started to its first rollout: median, most", in_ms(&starts), "<= 500 ms");

    let (mut private, mut resident, mut mapped) = (Vec::new(), Vec::new(), Vec::new());
    for task in &tasks {
        let mut pair = [start()?, start()?];
        for slot in &mut pair {
            slot.send(*task)?;
            slot.wait_for_start()?;
            slot.wait_for_steps()?;
        }
        let memory = pair[1].memory()?;
        private.push(memory.private);
        resident.push(memory.resident);
        mapped.push(pair[1].resident_of(&scenes)?);
        pair.into_iter().try_for_each(Slot::end)?;
    }
    row(
        "a further slot, one scene, not shared: maximum",
        format!("{:.1} MiB", most(&private)),
        "<= 40 MiB",
    );
    row("  resident: maximum", format!("{:.1} MiB", most(&resident)), "");
    row(
        "  resident part of its scene file: mean, maximum",
        format!("{:.1}, {:.1} MiB", mean(&mapped), most(&mapped)),
        "",
    );

    let mut slots = (0..arguments.slots).map(|_| start()).collect::<Result<Vec<_>>>()?;
    let mut totals = Vec::new();
    for round in 0..tasks.len() {
        for (at, slot) in slots.iter_mut().enumerate() {
            slot.send(tasks[(at + round) % tasks.len()])?;
        }
        for slot in &mut slots {
            slot.wait_for_start()?;
            slot.wait_for_steps()?;
        }
        let all = slots.iter().map(Slot::memory).collect::<Result<Vec<_>>>()?;
        totals.push(all.iter().map(|memory| memory.proportional).sum::<f64>());
    }
    slots.into_iter().try_for_each(Slot::end)?;
    row(
        &format!("{} slots, all scenes in turn: most", arguments.slots),
        format!("{:.0} MiB", most(&totals)),
        "<= 8192 MiB",
    );

    if let Some(python) = &arguments.python {
        let variables = [
            ("ROLLOUT_SCENES", scenes.as_path()),
            ("ROLLOUT_ASSETS", Path::new(&arguments.assets)),
            ("ROLLOUT_SOURCES", sources.dir()),
        ];
        let mut environments = Vec::new();
        for task in &tasks {
            let mut command = Command::new(python);
            command.args(["-c", PYTHON, &task.to_string()]);
            command.envs(variables);
            let output = command.stderr(Stdio::inherit()).output();
            let output = output.with_context(|| format!("run {}", python.display()))?;
            ensure!(output.status.success(), "Python failed");
            let secs = String::from_utf8(output.stdout)?;
            environments.push(secs.trim().parse::<f64>()?);
        }
        row("first Environment in Python: median, most", in_ms(&environments), "<= 200 ms");
        let total_memory = |processes: usize, count: usize| -> Result<f64> {
            let start = || Slot::python(python, count, &tasks, &variables);
            let mut all = (0..processes).map(|_| start()).collect::<Result<Vec<_>>>()?;
            all.iter_mut().try_for_each(Slot::wait_for_steps)?;
            let memory = all.iter().map(Slot::memory).collect::<Result<Vec<_>>>()?;
            all.into_iter().try_for_each(Slot::end)?;
            Ok(memory.iter().map(|memory| memory.proportional).sum())
        };
        let count = ENVIRONMENTS * tasks.len();
        row(
            &format!("{count} environments in one Python process"),
            format!("{:.0} MiB", total_memory(1, count)?),
            "",
        );
        row(
            &format!("{PROCESSES} Python processes of {ENVIRONMENTS}"),
            format!("{:.0} MiB", total_memory(PROCESSES, ENVIRONMENTS)?),
            "",
        );
    }
    Ok(())
}

/// Starts all tasks in one slot in sequence and returns how long each start took, s.
fn start_times(mut slot: Slot, tasks: &[TaskRef]) -> Result<Vec<f64>> {
    let mut times = Vec::new();
    for task in tasks {
        slot.send(*task)?;
        times.push(slot.wait_for_start()?.secs);
        slot.wait_for_steps()?;
    }
    slot.end()?;
    Ok(times)
}

/// Returns the total size of a folder's files, bytes.
fn total_size(folder: &Path) -> Result<u64> {
    let sizes = fs::read_dir(folder)?.map(|entry| Ok(entry?.metadata()?.len()));
    sizes.sum()
}

/// Formats median and maximum of durations in seconds as milliseconds.
fn in_ms(secs: &[f64]) -> String {
    let mut sorted = secs.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or_default();
    format!("{:.0}, {:.0} ms", median * 1e3, most(secs) * 1e3)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn most(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}
