//! `coordinator up`: coordinator, gateway and worker of one machine in one terminal.
//!
//! Each child is the ordinary program from this program's folder, in a process group of its own, so
//! that Ctrl-C reaches this process alone. Children are stopped so that none loses its server: the
//! worker first, which finishes its rollouts or, at a second signal, gives them back; then the
//! gateway; then the coordinator. A child that ends unrequested once all are running is started again
//! with a back-off. If this process is killed, the kernel kills its children.
//!
//! `up` belongs to `coordinator` because operators already have it: completions, manual pages and
//! the release archive include it.

mod evaluation;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};
use std::str::FromStr;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use benchmark::Look;
use benchmark::attempt::Waits;
use clap::Args;
use rustix::process::{Pid, kill_process};
use terminal::PARENT_VARIABLE;
use tokio::io::{AsyncBufReadExt, AsyncRead, BufReader};
use tokio::process::{Child, Command};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::command::{CommandError, print_line, usage};
use evaluation::Evaluation;

/// Interval between two polls for an exited child process.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Time after which an ended program counts as one that worked, and its back-off starts anew.
const WORKED_FOR: Duration = Duration::from_secs(60);
/// Width of the program name that prefixes each output line, columns.
const NAME_COLUMNS: usize = 11;
/// Default policies: two of those that are built into the gateway.
const BUILT_IN: [&str; 2] = ["builtin:student", "builtin:expert"];

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator up
  coordinator up --policy ws://gpu1:8000 --standard
  coordinator up --policy pi05=ws://gpu1:8000 --small --slots 2
  coordinator up --data ~/campaigns --assets ~/libero-assets";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct UpArguments {
    /// Folder of the database and the artifacts; created if missing.
    #[arg(long, value_name = "DIR", default_value = "campaigns")]
    data: PathBuf,
    /// A policy: its server, as for `policy-gateway --route`, and optionally its name, which
    /// otherwise follows from the server's address; repeatable. It replaces the built-in policies:
    /// repeat theirs to keep them.
    #[arg(long = "policy", value_name = "[NAME=]BACKEND", default_values = BUILT_IN)]
    policies: Vec<Policy>,
    /// Models of objects and rooms: `libero`, fetched as tasks need it, `primitives`, or the
    /// path of a LIBERO assets folder.
    #[arg(long, value_name = "PACK_OR_PATH", default_value = "libero")]
    assets: String,
    /// Look of all scenes, as `worker --look`.
    #[arg(long, default_value_t, hide_short_help = true)]
    look: Look,
    /// Concurrent rollouts: a number, or `auto`, which takes some seconds to measure a suitable
    /// number.
    #[arg(long, value_name = "N|auto", default_value = "auto")]
    slots: String,
    /// Address of the coordinator and its page; port 0 selects a free port.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7411",
        value_parser = terminal::address)]
    listen: SocketAddr,
    /// Address of the gateway; port 0 selects a free port.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:7412",
        value_parser = terminal::address)]
    gateway_listen: SocketAddr,
    #[command(flatten)]
    evaluation: Evaluation,
}

/// Policy of the gateway.
#[derive(Clone, Debug)]
struct Policy {
    name: String,
    backend: String,
}

impl FromStr for Policy {
    type Err = std::convert::Infallible;

    /// Reads `NAME=BACKEND` or `BACKEND`; the gateway checks both parts.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        // Before a `=` in a back-end's address stands the `:` of its scheme.
        let (name, backend) = match text.split_once('=') {
            Some((name, backend)) if !name.contains(':') => (name.to_owned(), backend),
            _ => {
                let address = text.split_once(':').map_or(text, |(_, address)| address);
                let address = address.split(['?', ',']).next().unwrap_or_default();
                let name = address.trim_matches('/');
                (name.replace(|c: char| !c.is_ascii_alphanumeric() && c != '.', "-"), text)
            }
        };
        Ok(Self { name, backend: backend.to_owned() })
    }
}

pub(super) async fn up(arguments: UpArguments) -> Result<(), CommandError> {
    for address in [arguments.listen, arguments.gateway_listen] {
        if !address.ip().is_loopback() {
            let error = anyhow!(
                "`up` serves this machine alone; to serve others, start `coordinator serve` and \
                 `policy-gateway` with a certificate and tokens"
            );
            return Err(usage(error.context(format!("listen on {address}"))));
        }
    }
    let mut requests = Requests::listen()?;
    let mut programs = Programs::default();
    let ended = run(&arguments, &mut programs, &mut requests).await;
    if ended.is_err() {
        programs.print("stopping the other programs");
    }
    programs.stop(&mut requests).await;
    ended
}

/// Starts the programs in order and waits for SIGINT or SIGTERM.
async fn run(
    arguments: &UpArguments,
    programs: &mut Programs,
    requests: &mut Requests,
) -> Result<(), CommandError> {
    let strings = |words: &[&str]| words.iter().map(ToString::to_string).collect::<Vec<_>>();
    let data = arguments.data.to_str().context("read --data: write a path in UTF-8")?;
    let listen = arguments.listen.to_string();
    let serve = strings(&["serve", "--data", data, "--listen", &listen]);
    let Some(coordinator) = programs.serve("coordinator", serve, requests).await? else {
        return Ok(());
    };
    let mut gateway = strings(&["--listen", &arguments.gateway_listen.to_string()]);
    for Policy { name, backend } in &arguments.policies {
        gateway.extend(strings(&["--route", &format!("{name}={backend}")]));
    }
    let Some(gateway) = programs.serve("policy-gateway", gateway, requests).await? else {
        return Ok(());
    };
    let url = format!("http://{coordinator}");
    let worker = ["--connect", &url, "--assets", &arguments.assets, "--slots", &arguments.slots];
    let worker = strings(&[&worker[..], &["--look", arguments.look.name()]].concat());
    programs.start("worker", worker)?;
    if programs.first_line("worker ", requests).await?.is_none() {
        return Ok(());
    }
    print_line(&startup_message(arguments, &coordinator, &gateway))?;
    let evaluation = arguments.evaluation.run(&arguments.policies, &coordinator, &gateway);
    tokio::select! {
        () = requests.next() => Ok(()),
        () = programs.keep_running() => Ok(()),
        done = evaluation => done,
    }
}

fn startup_message(arguments: &UpArguments, coordinator: &str, gateway: &str) -> String {
    let policy = arguments.policies.first().map_or("student", |policy| policy.name.as_str());
    let connect = match coordinator {
        "127.0.0.1:7411" => String::new(),
        other => format!(" --connect http://{other}"),
    };
    format!(
        "\ncoordinator and page at http://{coordinator}/, gateway at http://{gateway}, data in {}\n\
         In another terminal, for example:\n  \
           coordinator campaign create --name first --policy {policy} \\\n      \
             --endpoint http://{gateway} --tasks libero_object/0 --axes all \\\n      \
             --levels L2 --configs 0-1{connect}\n  \
           coordinator campaign status first --watch{connect}\n  \
           coordinator report first{connect}\n\
         Ctrl-C stops all three.\n",
        arguments.data.display()
    )
}

/// Shutdown requests: SIGINT (Ctrl-C) and SIGTERM.
struct Requests {
    interrupt: Signal,
    terminate: Signal,
}

impl Requests {
    fn listen() -> anyhow::Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt()).context("listen for SIGINT")?,
            terminate: signal(SignalKind::terminate()).context("listen for SIGTERM")?,
        })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

/// Running child process and the lines of its standard output.
struct Program {
    name: &'static str,
    arguments: Vec<String>,
    child: Child,
    lines: mpsc::UnboundedReceiver<String>,
    started: Instant,
    /// Exits in a row soon after a start.
    failures: u32,
    /// Time to start an exited program again.
    restart: Option<Instant>,
}

/// Child processes in the order in which they were started.
#[derive(Default)]
struct Programs {
    started: Vec<Program>,
    relays: JoinSet<()>,
}

impl Programs {
    /// Starts a server and returns the address that it reports to listen on; `None` if a shutdown
    /// was requested before that.
    async fn serve(
        &mut self,
        name: &'static str,
        arguments: Vec<String>,
        requests: &mut Requests,
    ) -> anyhow::Result<Option<String>> {
        self.start(name, arguments)?;
        let line = self.first_line("listening on ", requests).await?;
        let address = |line: String| line.split([',', ' ']).next().unwrap_or_default().to_owned();
        let address = line.map(address);
        // Started again, the server listens at the same address, even if the port was free to choose.
        let arguments = self.started.last_mut().map(|program| program.arguments.iter_mut());
        let listen =
            arguments.and_then(|mut all| all.by_ref().find(|a| *a == "--listen").and(all.next()));
        if let (Some(listen), Some(address)) = (listen, &address) {
            listen.clone_from(address);
        }
        Ok(address)
    }

    fn start(&mut self, name: &'static str, arguments: Vec<String>) -> anyhow::Result<()> {
        let (child, lines) = self.spawn(name, &arguments)?;
        let (started, failures, restart) = (Instant::now(), 0, None);
        self.started.push(Program { name, arguments, child, lines, started, failures, restart });
        Ok(())
    }

    fn spawn(
        &mut self,
        name: &'static str,
        arguments: &[String],
    ) -> anyhow::Result<(Child, mpsc::UnboundedReceiver<String>)> {
        let program = sibling(name)?;
        let mut child = Command::new(&program)
            .args(arguments)
            .env(PARENT_VARIABLE, std::process::id().to_string())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0)
            .kill_on_drop(true)
            .spawn()
            .with_context(|| format!("start {}", program.display()))?;
        let (sender, lines) = mpsc::unbounded_channel();
        self.relays.spawn(relay(child.stdout.take(), name, Some(sender)));
        self.relays.spawn(relay(child.stderr.take(), name, None));
        Ok((child, lines))
    }

    /// Starts programs that exit again; never returns.
    async fn keep_running(&mut self) {
        loop {
            for index in 0..self.started.len() {
                self.keep_one_running(index);
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    }

    fn keep_one_running(&mut self, index: usize) {
        let program = &mut self.started[index];
        let exit_text = match (program.restart, program.child.try_wait()) {
            (None, Ok(None)) => return,
            (None, Ok(Some(status))) => describe_exit(status),
            (None, Err(error)) => format!("could not be waited for ({error})"),
            (Some(at), _) if Instant::now() < at => return,
            (Some(_), _) => {
                let (name, arguments) = (program.name, program.arguments.clone());
                match self.spawn(name, &arguments) {
                    Ok((child, lines)) => {
                        let program = &mut self.started[index];
                        let (started, restart) = (Instant::now(), None);
                        (program.child, program.lines) = (child, lines);
                        (program.started, program.restart) = (started, restart);
                        return;
                    }
                    Err(error) => format!("did not start ({})", transport::chain(&*error)),
                }
            }
        };
        let program = &mut self.started[index];
        if program.started.elapsed() > WORKED_FOR {
            program.failures = 0;
        }
        program.failures = program.failures.saturating_add(1);
        let wait = Waits::USUAL.after(program.failures, 0);
        program.restart = Some(Instant::now() + wait);
        let (name, secs) = (program.name, wait.as_secs());
        self.print(&format!(
            "`{name}` {exit_text}; its last lines, above, say why; starting it again in {secs} s"
        ));
    }

    /// Waits until the program that was started last prints a line that begins with `prefix`, and
    /// returns the line without the prefix; `None` if a shutdown was requested first.
    async fn first_line(
        &mut self,
        prefix: &str,
        requests: &mut Requests,
    ) -> anyhow::Result<Option<String>> {
        loop {
            let newest = self.started.last_mut().context("wait for a program")?;
            let line = tokio::select! {
                () = requests.next() => return Ok(None),
                line = newest.lines.recv() => line,
            };
            match line {
                Some(line) => {
                    if let Some(rest) = line.strip_prefix(prefix) {
                        return Ok(Some(rest.to_owned()));
                    }
                }
                // The program closed its standard output: it has exited or is about to.
                None => return Err(self.next_exit().await),
            }
        }
    }

    /// Waits until one of the programs exits and returns an error that names it.
    async fn next_exit(&mut self) -> anyhow::Error {
        loop {
            for program in &mut self.started {
                let exit_text = match program.child.try_wait() {
                    Ok(None) => continue,
                    Ok(Some(status)) => describe_exit(status),
                    Err(error) => format!("could not be waited for ({error})"),
                };
                return anyhow!(
                    "keep `{}` running: it {exit_text}; its last lines, above, say why",
                    program.name
                );
            }
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    }

    /// Stops the programs, the newest first. A further shutdown request is forwarded to the program
    /// that is stopping; a worker then gives its rollouts back.
    async fn stop(mut self, requests: &mut Requests) {
        while let Some(mut program) = self.started.pop() {
            if matches!(program.child.try_wait(), Ok(Some(_))) {
                continue;
            }
            if program.name == "worker" {
                self.print("stopping once the rollouts in flight are over; Ctrl-C gives them back");
            }
            terminate(&program.child);
            let status = loop {
                tokio::select! {
                    status = program.child.wait() => break status,
                    () = requests.next() => terminate(&program.child),
                }
            };
            if let Ok(status) = status
                && !status.success()
            {
                self.print(&format!("`{}` {}", program.name, describe_exit(status)));
            }
        }
        // The relays print the programs' last lines before they finish.
        while self.relays.join_next().await.is_some() {}
        self.print("stopped");
    }

    /// Prints a message of `up` itself, prefixed like the output of its children.
    fn print(&self, text: &str) {
        print_prefixed("up", text);
    }
}

/// Sends SIGTERM; a child that has exited is ignored.
fn terminate(child: &Child) {
    let pid = child.id().and_then(|id| Pid::from_raw(id.cast_signed()));
    if let Some(pid) = pid {
        let _ = kill_process(pid, rustix::process::Signal::TERM);
    }
}

/// Returns the path of a program in this program's folder.
fn sibling(name: &str) -> anyhow::Result<PathBuf> {
    let executable = std::env::current_exe().context("find this program's own file")?;
    let path = executable.with_file_name(name);
    match path.is_file() {
        true => Ok(path),
        false => {
            let error = anyhow!(
                "{} is not there; a release installs all programs into one folder, and `cargo build \
                 --workspace --bins` builds them in a checkout",
                path.display()
            );
            Err(error.context(format!("find `{name}` beside this program")))
        }
    }
}

/// Describes an exit status as a predicate, to follow "it" or a program name.
fn describe_exit(status: ExitStatus) -> String {
    match status.code() {
        Some(code) => format!("ended with exit code {code}"),
        None => format!("was killed ({status})"),
    }
}

/// Prints each output line of a program, prefixed with its name, and sends the line to `lines`.
async fn relay(
    output: Option<impl AsyncRead + Unpin>,
    name: &'static str,
    lines: Option<mpsc::UnboundedSender<String>>,
) {
    let Some(output) = output else { return };
    let mut output = BufReader::new(output);
    let mut line = Vec::new();
    while let Ok(1..) = output.read_until(b'\n', &mut line).await {
        let text = String::from_utf8_lossy(line.trim_ascii_end()).into_owned();
        print_prefixed(name, &text);
        if let Some(lines) = &lines {
            // The receiver may be gone; its lines matter only during startup.
            let _ = lines.send(text);
        }
        line.clear();
    }
}

fn print_prefixed(name: &str, text: &str) {
    let name = name.strip_prefix("policy-").unwrap_or(name);
    terminal::complain(&format!("{name:<NAME_COLUMNS$} | {text}"));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_without_a_name_is_named_by_its_address() {
        for (text, name, backend) in [
            ("pi05=ws://gpu1:8000?image=a", "pi05", "ws://gpu1:8000?image=a"),
            ("ws://gpu1:8000?image=a", "gpu1-8000", "ws://gpu1:8000?image=a"),
            ("grpc://10.0.0.2:5000/pi/", "10.0.0.2-5000-pi", "grpc://10.0.0.2:5000/pi/"),
            ("builtin:expert", "expert", "builtin:expert"),
        ] {
            let policy: Policy = text.parse().expect("a policy");
            assert_eq!((policy.name.as_str(), policy.backend.as_str()), (name, backend));
        }
    }
}
