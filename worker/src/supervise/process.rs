//! A slot's process as its parent sees it: started, given orders, listened to,
//! killed, and its end explained. Not responsible for when any of that happens.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::io;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};

use tokio::io::{AsyncBufRead, AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::memory::{OomKills, Verdict};
use super::supervisor::Event;
use crate::message::{MAX_LINE_BYTES, Order, Report};

/// Orders that wait for a process to read them: a rollout, and to let go of it.
const ORDER_QUEUE: usize = 4;
/// Lines of a process's standard error that its end is explained with.
const LAST_WORDS: usize = 5;
/// Longest line of standard error that is kept in one piece, bytes.
const MAX_STDERR_LINE_BYTES: u64 = 4096;

/// How a slot's process is started.
#[derive(Clone, Debug)]
pub struct SlotCommand {
    /// The program: this one, as a rule.
    pub program: PathBuf,
    /// Its arguments.
    pub arguments: Vec<OsString>,
}

/// One life of one slot's process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ProcessKey {
    /// Which slot, from 0.
    pub(crate) slot: usize,
    /// Which of its processes, from 1.
    pub(crate) life: u64,
}

/// A started process. Dropping it closes the process's standard input, and the
/// process ends.
#[derive(Debug)]
pub(crate) struct SlotProcess {
    commands: mpsc::Sender<ProcessCommand>,
    pub(crate) key: ProcessKey,
}

#[derive(Debug)]
enum ProcessCommand {
    Order(Order),
    Kill,
}

impl SlotProcess {
    /// Starts a process, and a task that tells `events` what it says and how it
    /// ends.
    pub(crate) fn start(
        command: &SlotCommand,
        key: ProcessKey,
        tasks: &mut JoinSet<()>,
        events: mpsc::Sender<Event>,
    ) -> io::Result<Self> {
        let child = Command::new(&command.program)
            .args(&command.arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // A Ctrl-C in the terminal is for the parent, which lets the slots
            // finish their rollouts.
            .process_group(0)
            .kill_on_drop(true)
            .spawn()?;
        let (commands, orders) = mpsc::channel(ORDER_QUEUE);
        tasks.spawn(attend(child, key, orders, events));
        Ok(Self { commands, key })
    }

    /// Gives an order. A process that reads no orders does not report either,
    /// and is killed for that: losing the order changes nothing.
    pub(crate) fn order(&self, order: Order) {
        let _ = self.commands.try_send(ProcessCommand::Order(order));
    }

    /// Kills the process.
    pub(crate) fn kill(&self) {
        let _ = self.commands.try_send(ProcessCommand::Kill);
    }
}

/// Owns a process until it has ended and everything that it said is told.
async fn attend(
    mut child: Child,
    key: ProcessKey,
    orders: mpsc::Receiver<ProcessCommand>,
    events: mpsc::Sender<Event>,
) {
    let kills_before = OomKills::read();
    let (stdin, stdout, stderr) = (child.stdin.take(), child.stdout.take(), child.stderr.take());
    let listening = async {
        if let Some(stdout) = stdout {
            tell_reports(stdout, key, &events).await;
        }
    };
    let relaying = async {
        match stderr {
            Some(stderr) => relay(BufReader::new(stderr), key.slot).await,
            None => VecDeque::new(),
        }
    };
    let ((), last_words, status) = tokio::join!(listening, relaying, obey(child, stdin, orders));
    let kills = OomKills::read().since(kills_before);
    let end = explain_end(status, kills, &last_words);
    // A supervisor that is gone needs no explanation.
    let _ = events.send(Event::Ended { key, end }).await;
}

async fn obey(
    mut child: Child,
    mut stdin: Option<ChildStdin>,
    mut commands: mpsc::Receiver<ProcessCommand>,
) -> io::Result<ExitStatus> {
    loop {
        let command = tokio::select! {
            status = child.wait() => return status,
            command = commands.recv(), if stdin.is_some() => command,
        };
        let alive = match (command, &mut stdin) {
            (Some(ProcessCommand::Order(order)), Some(stdin)) => send(stdin, &order).await,
            (Some(ProcessCommand::Kill), _) => child.start_kill(),
            // The end of its input tells the process to end.
            (None, _) => {
                stdin = None;
                Ok(())
            }
            (Some(ProcessCommand::Order(_)), None) => Ok(()),
        };
        if alive.is_err() {
            // It no longer reads: it has ended, or is about to.
            stdin = None;
        }
    }
}

async fn send(stdin: &mut ChildStdin, order: &Order) -> io::Result<()> {
    let mut line = serde_json::to_vec(order)?;
    line.push(b'\n');
    stdin.write_all(&line).await?;
    stdin.flush().await
}

async fn tell_reports(stdout: ChildStdout, key: ProcessKey, events: &mpsc::Sender<Event>) {
    let mut stdout = BufReader::new(stdout);
    while let Some(line) = next_line(&mut stdout, MAX_LINE_BYTES).await {
        match serde_json::from_slice::<Report>(&line) {
            Ok(report) => {
                if events.send(Event::Reported { key, report }).await.is_err() {
                    return;
                }
            }
            // Native libraries print where they like.
            Err(_) => eprintln!("[slot {}] {}", key.slot, String::from_utf8_lossy(&line)),
        }
    }
}

/// Passes a process's standard error on; returns its last lines.
async fn relay(mut stderr: impl AsyncBufRead + Unpin, slot: usize) -> VecDeque<String> {
    let mut last = VecDeque::new();
    while let Some(line) = next_line(&mut stderr, MAX_STDERR_LINE_BYTES).await {
        let line = String::from_utf8_lossy(&line).into_owned();
        eprintln!("[slot {slot}] {line}");
        if last.len() == LAST_WORDS {
            last.pop_front();
        }
        last.push_back(line);
    }
    last
}

/// The next line without its end, or as much of it as the bound allows; none
/// at the end of the stream.
async fn next_line(stream: &mut (impl AsyncBufRead + Unpin), max_bytes: u64) -> Option<Vec<u8>> {
    let mut line = Vec::new();
    let read = stream.take(max_bytes).read_until(b'\n', &mut line).await;
    match read {
        Ok(0) | Err(_) => None,
        Ok(_) => {
            line.truncate(line.trim_ascii_end().len());
            Some(line)
        }
    }
}

fn explain_end(
    status: io::Result<ExitStatus>,
    kills: Verdict,
    last_words: &VecDeque<String>,
) -> String {
    let mut text = match status {
        Ok(status) => explain_status(status, kills),
        Err(error) => format!("could not be waited for ({error})"),
    };
    if !last_words.is_empty() {
        text.push_str("; its last words: ");
        text.push_str(
            &last_words
                .iter()
                .map(String::as_str)
                .collect::<Vec<_>>()
                .join(" | "),
        );
    }
    text
}

/// Reads after "the process".
pub(crate) fn explain_status(status: ExitStatus, kills: Verdict) -> String {
    match (status.code(), status.signal()) {
        (_, Some(9)) => format!("was killed by SIGKILL{}", kills.in_words()),
        (_, Some(signal)) => format!("died of signal {signal} ({})", signal_name(signal)),
        (Some(code), None) => format!("exited with code {code}"),
        (None, None) => format!("ended ({status})"),
    }
}

/// The signals that native code dies of.
fn signal_name(signal: i32) -> &'static str {
    match signal {
        4 => "SIGILL, an instruction that this processor lacks",
        6 => "SIGABRT, a library gave up",
        7 => "SIGBUS, a memory or disk failure",
        8 => "SIGFPE, an arithmetic failure",
        11 => "SIGSEGV, a crash in native code",
        15 => "SIGTERM",
        _ => "see signal(7)",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn lines_are_bounded() {
        let mut stream: &[u8] = b"one\r\n\ntwelve bytes\nrest";
        let mut lines = Vec::new();
        while let Some(line) = next_line(&mut stream, 8).await {
            lines.push(String::from_utf8(line).expect("UTF-8"));
        }
        assert_eq!(lines, ["one", "", "twelve b", "ytes", "rest"]);
    }

    #[test]
    fn the_end_of_a_process_is_told_in_words() {
        let check = |wait_status: i32, expected: &str| {
            let text = explain_status(ExitStatus::from_raw(wait_status), Verdict::GroupLimit);
            assert!(text.contains(expected), "{text}");
        };
        check(9, "SIGKILL: out of memory");
        check(11, "signal 11 (SIGSEGV");
        check(1 << 8, "exited with code 1");
        let last_words = VecDeque::from(["one".to_owned(), "two".to_owned()]);
        let text = explain_end(Ok(ExitStatus::from_raw(6)), Verdict::Unknown, &last_words);
        assert!(text.ends_with("its last words: one | two"), "{text}");
    }
}
