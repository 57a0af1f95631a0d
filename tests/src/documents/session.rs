//! A shell session that executes commands one by one, with servers in the background.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command as Program, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use super::folder::Folder;

/// Timeout of a command and of the start of a server.
const PATIENCE: Duration = Duration::from_secs(240);

/// Shell script that drives the session: reads the path of an output file and a command, each
/// terminated by a zero byte, runs the command, and writes its exit status and the id of the
/// newest background process. At the end of input it kills all its processes.
const DRIVER: &str = r#"
exec 3<&0 4>&1 </dev/null
while IFS= read -r -d '' output <&3 && IFS= read -r -d '' command <&3; do
    eval "$command" >"$output" 2>&1 3<&- 4>&-
    printf '%s %s\n' "$?" "$!" >&4
done
kill -KILL 0
"#;

/// Messages that indicate that a server is ready.
const READY: [&str; 2] = ["listening on ", "registered with the coordinator"];
/// Message of `coordinator up` when all of its programs are ready.
const ALL_READY: [&str; 1] = ["Ctrl-C stops all three"];

/// A shell in the folder of a page.
pub struct Session {
    shell: Child,
    commands: ChildStdin,
    answers: Receiver<String>,
    outputs: PathBuf,
    servers: Vec<Server>,
    count: usize,
}

/// A command that runs until the page ends.
struct Server {
    process: String,
    command: String,
    output: PathBuf,
}

/// Report of a failed command.
#[derive(Debug)]
pub struct Failure {
    pub problem: String,
    /// Output of the command; only the end if it is long.
    pub output: String,
    /// True if the shell cannot execute further commands.
    pub is_fatal: bool,
}

impl Session {
    /// Starts the shell.
    pub fn start(folder: &Folder) -> Self {
        let mut words = folder.network().wrapper().iter().chain(&["bash", "-c"]);
        let mut program = Program::new(words.next().expect("a program"));
        program.args(words).arg(DRIVER);
        folder.prepare_shell(&mut program);
        program.stdin(Stdio::piped()).stdout(Stdio::piped());
        // All processes that the shell starts are in its process group.
        let mut shell = program.process_group(0).spawn().expect("a shell starts");
        let commands = shell.stdin.take().expect("a pipe");
        let stdout = BufReader::new(shell.stdout.take().expect("a pipe"));
        let (send, answers) = channel();
        std::thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                let _ = send.send(line);
            }
        });
        Self { shell, commands, answers, outputs: folder.outputs(), servers: Vec::new(), count: 0 }
    }

    /// Runs a command to its end or, for a server, until it is ready.
    pub fn run(&mut self, command: &str) -> Result<(), Failure> {
        if runs_until_stopped(command) {
            return self.start_server(command);
        }
        let (status, output) = self.call(command)?;
        if status.starts_with("0 ") {
            return Ok(());
        }
        let status = status.split(' ').next().unwrap_or_default();
        Err(failure(format!("the command ended with status {status}"), &output))
    }

    fn start_server(&mut self, command: &str) -> Result<(), Failure> {
        let (status, output) = self.call(&in_background(command))?;
        let process = status.split(' ').nth(1).unwrap_or_default().to_owned();
        self.servers.push(Server {
            process: process.clone(),
            command: command.to_owned(),
            output: output.clone(),
        });
        let is_display = displays_progress(command);
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            let printed = fs::read_to_string(&output).unwrap_or_default();
            let ready = if command.contains("coordinator up") { &ALL_READY[..] } else { &READY };
            if ready.iter().any(|ready| printed.contains(ready))
                || (is_display && !printed.is_empty())
            {
                return Ok(());
            }
            let (alive, _) = self.call(&format!("kill -0 {process}"))?;
            if !alive.starts_with("0 ") {
                self.servers.pop();
                let (status, _) = self.call(&format!("wait {process}"))?;
                if is_display && status.starts_with("0 ") {
                    return Ok(());
                }
                return Err(failure("the server ended at once".to_owned(), &output));
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        Err(failure("the server does not become ready".to_owned(), &output))
    }

    /// Checks the servers at the end of a page.
    pub fn finish(mut self) -> Result<(), Failure> {
        for server in std::mem::take(&mut self.servers) {
            let process = &server.process;
            let (alive, _) = self.call(&format!("kill -0 {process}"))?;
            if alive.starts_with("0 ") {
                continue;
            }
            let (status, _) = self.call(&format!("wait {process}"))?;
            let status = status.split(' ').next().unwrap_or_default();
            // 127: the page waited for the server; 137 and 143: the page killed it.
            if !matches!(status, "0" | "127" | "137" | "143") {
                let problem = format!("`{}` ended with status {status}", server.command);
                return Err(failure(problem, &server.output));
            }
        }
        Ok(())
    }

    /// Sends a command to the shell; returns the response and the path of the output.
    fn call(&mut self, command: &str) -> Result<(String, PathBuf), Failure> {
        self.count += 1;
        let output = self.outputs.join(format!("{}.txt", self.count));
        let text = format!("{}\0{command}\n\0", output.display());
        let sent = self.commands.write_all(text.as_bytes());
        let fatal = |problem: String| Failure { is_fatal: true, ..failure(problem, &output) };
        sent.map_err(|error| fatal(format!("the shell has ended: {error}")))?;
        match self.answers.recv_timeout(PATIENCE) {
            Ok(answer) => Ok((answer, output)),
            Err(RecvTimeoutError::Disconnected) => Err(fatal("the shell has ended".to_owned())),
            Err(RecvTimeoutError::Timeout) => {
                let secs = PATIENCE.as_secs();
                Err(fatal(format!("the command takes more than {secs} s")))
            }
        }
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        let group = format!("-{}", self.shell.id());
        let _ = Program::new("kill").args(["-KILL", "--", &group]).status();
        let _ = self.shell.wait();
    }
}

fn failure(problem: String, output: &Path) -> Failure {
    let mut text = String::new();
    if let Ok(file) = File::open(output) {
        let lines: Vec<String> = BufReader::new(file).lines().map_while(Result::ok).collect();
        text = lines[lines.len().saturating_sub(30)..].join("\n");
    }
    Failure { problem, output: text, is_fatal: false }
}

/// Returns the command with `&`, even if the page does not run it in the background, because a
/// reader would use another terminal. `$!` is then the id of the program itself.
fn in_background(command: &str) -> String {
    let bare = without_comment(command);
    format!("{} &", bare.trim_end().trim_end_matches('&'))
}

fn without_comment(command: &str) -> &str {
    match command.lines().last().and_then(|line| line.find(" #")) {
        Some(at) => {
            let last = command.rfind('\n').map_or(0, |newline| newline + 1);
            &command[..last + at]
        }
        None => command,
    }
}

fn runs_until_stopped(command: &str) -> bool {
    let mut words = command.split_whitespace().skip_while(|word| word.contains('='));
    let program = words.next().unwrap_or_default();
    let program = program.rsplit('/').next().unwrap_or_default();
    let words: Vec<&str> = words.collect();
    let first = words.first().copied().unwrap_or_default();
    match program {
        "coordinator" => ["serve", "up"].contains(&first) || displays_progress(command),
        "policy-gateway" => !["check", "compare"].contains(&first) && !words.contains(&"--help"),
        "worker" => first == "--connect",
        "python" | "python3" => {
            words.contains(&"--listen") || words.contains(&"serve") || first.ends_with("policy.py")
        }
        "node" => true,
        _ => false,
    }
}

/// Returns true if a command displays progress until it is interrupted.
fn displays_progress(command: &str) -> bool {
    command.split_whitespace().any(|word| word == "--watch")
}
