//! A slot's process from the parent's side: start, commands, events, kill, and an explanation of
//! its end. The supervisor decides when to start and to kill it.

use std::collections::VecDeque;
use std::io;
use std::process::{ExitStatus, Stdio};

use tokio::io::{AsyncBufRead, AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::UnixStream;
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::process::{Child, Command};
use tokio::sync::mpsc;
use tokio::task::{self, JoinSet};

use super::event::{Event, ProcessEnd, ProcessKey};
use crate::child::{SlotProgram, connection, explain_status};
use crate::memory::OomKills;
use crate::message::{MAX_LINE_BYTES, SlotCommand, SlotEvent};

/// Capacity of a process's command queue; a run and its abandonment need two places.
const COMMAND_QUEUE: usize = 4;
/// Number of the last lines of a process's standard error that explain its end.
const LAST_LINES: usize = 5;
/// Longest relayed line, bytes; longer lines are split.
const MAX_RELAYED_LINE_BYTES: u64 = 4096;

/// Running process of a slot. Dropping this value closes the connection, whereupon the process
/// ends.
#[derive(Debug)]
pub(crate) struct SlotProcess {
    requests: mpsc::Sender<Request>,
    pub(crate) key: ProcessKey,
    /// Id of the task that owns the process.
    pub(crate) task: task::Id,
}

/// Request to the task that owns a process.
#[derive(Debug)]
enum Request {
    Send(SlotCommand),
    Kill,
}

impl SlotProcess {
    /// Starts a process, and a task that forwards its events and its end to `events`.
    pub(crate) fn start(
        program: &SlotProgram,
        key: ProcessKey,
        tasks: &mut JoinSet<()>,
        events: mpsc::Sender<Event>,
    ) -> io::Result<Self> {
        let (parent_end, child_end) = connection()?;
        parent_end.set_nonblocking(true)?;
        let connection = UnixStream::from_std(parent_end)?;
        let child = Command::new(&program.program)
            .args(&program.arguments)
            .stdin(child_end)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // A Ctrl-C in the terminal must reach only the parent, which lets the slots finish
            // their rollouts.
            .process_group(0)
            .kill_on_drop(true)
            .spawn()?;
        let (sender, requests) = mpsc::channel(COMMAND_QUEUE);
        let task = tasks.spawn(run_process(child, connection, key, requests, events));
        Ok(Self {
            requests: sender,
            key,
            task: task.id(),
        })
    }

    /// Sends a command, which is lost if the queue is full. The loss does not matter: a full queue
    /// shows that the process reads no commands, so it makes no progress and is killed for that.
    pub(crate) fn send(&self, command: SlotCommand) {
        let _ = self.requests.try_send(Request::Send(command));
    }

    pub(crate) fn kill(&self) {
        let _ = self.requests.try_send(Request::Kill);
    }
}

/// Owns a process until it has ended and all its output is forwarded.
async fn run_process(
    mut child: Child,
    connection: UnixStream,
    key: ProcessKey,
    requests: mpsc::Receiver<Request>,
    events: mpsc::Sender<Event>,
) {
    let kills_before = OomKills::read();
    let (events_socket, commands) = connection.into_split();
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    let ((), _, last_lines, status) = tokio::join!(
        forward_events(events_socket, key, &events),
        relay(stdout, key.slot),
        relay(stderr, key.slot),
        handle_requests(child, commands, requests)
    );
    let kills = OomKills::read().since(kills_before);
    let description = match status {
        Ok(status) => explain_status(status, kills),
        Err(error) => format!("could not be waited for ({error})"),
    };
    let end = ProcessEnd {
        description,
        last_lines: last_lines.into(),
    };
    // The receiver may be gone if the supervisor has ended.
    let _ = events.send(Event::Ended { key, end }).await;
}

async fn handle_requests(
    mut child: Child,
    commands: OwnedWriteHalf,
    mut requests: mpsc::Receiver<Request>,
) -> io::Result<ExitStatus> {
    let mut commands = Some(commands);
    loop {
        let request = tokio::select! {
            status = child.wait() => return status,
            request = requests.recv(), if commands.is_some() => request,
        };
        let done = match (request, &mut commands) {
            (Some(Request::Send(command)), Some(commands)) => send(commands, &command).await,
            (Some(Request::Kill), _) => child.start_kill(),
            // The process ends when its connection is closed.
            (None, _) => {
                commands = None;
                Ok(())
            }
            (Some(Request::Send(_)), None) => Ok(()),
        };
        if done.is_err() {
            // The process no longer reads: it has ended or is about to.
            commands = None;
        }
    }
}

async fn send(commands: &mut OwnedWriteHalf, command: &SlotCommand) -> io::Result<()> {
    let mut line = serde_json::to_vec(command)?;
    line.push(b'\n');
    commands.write_all(&line).await
}

async fn forward_events(stream: OwnedReadHalf, key: ProcessKey, events: &mpsc::Sender<Event>) {
    let mut stream = BufReader::new(stream);
    while let Some(line) = next_line(&mut stream, MAX_LINE_BYTES).await {
        match serde_json::from_slice::<SlotEvent>(&line) {
            Ok(event) => {
                if events.send(Event::Slot { key, event }).await.is_err() {
                    return;
                }
            }
            // Only the slot's own program writes to this socket, so this is a defect.
            Err(error) => {
                let line = String::from_utf8_lossy(&line);
                tracing::error!(
                    "slot {} sent a line that is not an event ({error}): {line}",
                    key.slot
                );
            }
        }
    }
}

/// Relays the output of a process to standard error; returns its last lines.
async fn relay(output: Option<impl AsyncRead + Unpin>, slot: usize) -> VecDeque<String> {
    let mut last = VecDeque::new();
    let Some(output) = output else { return last };
    let mut output = BufReader::new(output);
    while let Some(line) = next_line(&mut output, MAX_RELAYED_LINE_BYTES).await {
        let line = String::from_utf8_lossy(&line).into_owned();
        terminal::complain(&format!("[slot {slot}] {line}"));
        if last.len() == LAST_LINES {
            last.pop_front();
        }
        last.push_back(line);
    }
    last
}

/// Reads the next line, at most `max_bytes` of it, and removes white space from its end; `None` at
/// the end of the stream or if reading fails.
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

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;

    use super::*;
    use crate::memory::Verdict;

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
    fn the_end_of_a_process_is_described() {
        let check = |wait_status: i32, expected: &str| {
            let text = explain_status(ExitStatus::from_raw(wait_status), Verdict::GroupLimit);
            assert!(text.contains(expected), "{text}");
        };
        check(9, "SIGKILL: out of memory");
        check(11, "signal 11 (SIGSEGV");
        check(1 << 8, "exited with code 1");
        let last_lines = VecDeque::from(["one".to_owned(), "two".to_owned()]);
        let end = ProcessEnd {
            description: "aborted".to_owned(),
            last_lines: last_lines.into(),
        };
        assert_eq!(end.with_last_lines(), "aborted; its last output: one | two");
    }
}
