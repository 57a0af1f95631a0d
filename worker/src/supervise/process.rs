//! A slot's process from the parent's side: start, commands, events, kill, and an explanation of
//! its end. The supervisor decides when to start and to kill it.

use std::collections::VecDeque;
use std::io;
use std::process::{ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};

use tokio::io::{AsyncBufRead, AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::UnixStream;
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::process::{Child, Command};
use tokio::sync::{Notify, mpsc};
use tokio::task::{self, JoinSet};
use transport::Access;

use super::event::{Event, ProcessEnd, ProcessKey};
use crate::child::{SlotProgram, connection, explain_status};
use crate::memory::OomKills;
use crate::message::{Assignment, MAX_LINE_BYTES, RolloutEvent, SlotCommand, SlotEvent};
use crate::policy::end_session;

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
    commands: mpsc::Sender<SlotCommand>,
    kill: Arc<Notify>,
    pub(crate) key: ProcessKey,
    pub(crate) task: task::Id,
}

impl SlotProcess {
    /// Starts a process, and a task that forwards its events and its end to `events`. The task has
    /// `access` to policies, and ends the session that the process leaves open.
    pub(crate) fn start(
        program: &SlotProgram,
        access: &Access,
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
        let (sender, commands) = mpsc::channel(COMMAND_QUEUE);
        let kill = Arc::new(Notify::new());
        let running = run_process(child, connection, key, commands, Arc::clone(&kill), events);
        let access = access.clone();
        let task = tasks.spawn(async move {
            if let Some(left) = running.await {
                end_session(&left, &access).await;
            }
        });
        Ok(Self { commands: sender, kill, key, task: task.id() })
    }

    /// Sends a command, which is lost if the queue is full. The loss does not matter: a full queue
    /// shows that the process reads no commands, so it makes no progress and is killed for that.
    pub(crate) fn send(&self, command: SlotCommand) {
        let _ = self.commands.try_send(command);
    }

    /// Kills the process, even if it reads no commands or has closed its connection.
    pub(crate) fn kill(&self) {
        self.kill.notify_one();
    }
}

/// Owns a process until it has ended and all its output is forwarded. Returns the rollout that it
/// left unfinished: until its session ends, the session counts against the policy's capacity.
async fn run_process(
    mut child: Child,
    connection: UnixStream,
    key: ProcessKey,
    commands: mpsc::Receiver<SlotCommand>,
    kill: Arc<Notify>,
    events: mpsc::Sender<Event>,
) -> Option<Box<Assignment>> {
    let rollout = Mutex::new(None);
    let kills_before = OomKills::read();
    let (events_socket, commands_socket) = connection.into_split();
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    let ((), _, last_lines, status) = tokio::join!(
        forward_events(events_socket, key, &events, &rollout),
        relay(stdout, key.slot),
        relay(stderr, key.slot),
        wait_or_kill(child, forward_commands(commands_socket, commands, &rollout), &kill)
    );
    let kills = OomKills::read().since(kills_before);
    let description = match status {
        Ok(status) => explain_status(status, kills),
        Err(error) => format!("could not be waited for ({error})"),
    };
    let end = ProcessEnd { description, last_lines: last_lines.into() };
    // The receiver may be gone if the supervisor has ended.
    let _ = events.send(Event::Ended { key, end }).await;
    rollout.into_inner().unwrap_or_else(PoisonError::into_inner)
}

type Unfinished = Mutex<Option<Box<Assignment>>>;

fn set(unfinished: &Unfinished, rollout: Option<Box<Assignment>>) {
    *unfinished.lock().unwrap_or_else(PoisonError::into_inner) = rollout;
}

/// Waits for the process to end, and kills it when `kill` is notified.
async fn wait_or_kill(
    mut child: Child,
    forwarding: impl Future<Output = ()>,
    kill: &Notify,
) -> io::Result<ExitStatus> {
    tokio::pin!(forwarding);
    let mut is_forwarding = true;
    loop {
        tokio::select! {
            status = child.wait() => return status,
            () = &mut forwarding, if is_forwarding => is_forwarding = false,
            () = kill.notified() => {
                // This fails only if the process has ended, which `wait` reports.
                let _ = child.start_kill();
            }
        }
    }
}

/// Forwards commands until the supervisor drops the process or a write fails, and closes the
/// connection, whereupon the process ends.
async fn forward_commands(
    mut socket: OwnedWriteHalf,
    mut commands: mpsc::Receiver<SlotCommand>,
    rollout: &Unfinished,
) {
    while let Some(command) = commands.recv().await {
        if let SlotCommand::Run(assignment) = &command {
            set(rollout, Some(assignment.clone()));
        }
        if let Err(error) = send(&mut socket, &command).await {
            return tracing::warn!("a slot got no command: {error}");
        }
    }
}

async fn send(socket: &mut OwnedWriteHalf, command: &SlotCommand) -> io::Result<()> {
    let mut line = serde_json::to_vec(command)?;
    line.push(b'\n');
    socket.write_all(&line).await
}

async fn forward_events(
    stream: OwnedReadHalf,
    key: ProcessKey,
    events: &mpsc::Sender<Event>,
    rollout: &Unfinished,
) {
    let mut stream = BufReader::new(stream);
    while let Some(line) = next_line(&mut stream, MAX_LINE_BYTES).await {
        match serde_json::from_slice::<SlotEvent>(&line) {
            Ok(event) => {
                use RolloutEvent::{Abandoned, Failed, Finished};
                if let SlotEvent::Rollout { event: Finished(_) | Failed(_) | Abandoned, .. } = event
                {
                    set(rollout, None);
                }
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
    use std::time::Duration;

    use benchmark::attempt::AttemptId;

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
        let end = ProcessEnd { description: "aborted".to_owned(), last_lines: last_lines.into() };
        assert_eq!(end.with_last_lines(), "aborted; its last output: one | two");
    }

    #[tokio::test]
    async fn a_process_that_closed_its_connection_can_be_killed() {
        let program = SlotProgram {
            program: "sh".into(),
            arguments: vec!["-c".into(), "exec sleep 60 <&-".into()],
        };
        let key = ProcessKey { slot: 0, number: 1 };
        let (events, mut inbox) = mpsc::channel(1);
        let mut tasks = JoinSet::new();
        let process =
            SlotProcess::start(&program, &Access::none(), key, &mut tasks, events).expect("starts");
        while !process.commands.is_closed() {
            process.send(SlotCommand::Abandon(AttemptId::from_random([7; 16])));
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        process.kill();
        let ended = tokio::time::timeout(Duration::from_secs(30), inbox.recv()).await;
        match ended {
            Ok(Some(Event::Ended { end, .. })) => {
                assert!(end.description.contains("SIGKILL"), "{end:?}");
            }
            other => panic!("{other:?}"),
        }
    }
}
