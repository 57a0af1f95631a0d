//! The parent of measured slots: starts their processes, starts their periods together, and adds
//! up their counts.

use std::io::{self, BufRead, BufReader, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use super::MeasureError;
use super::choice::{PerSlot, Throughput};
use super::counting::{Count, SlotMemory, SlotReport};
use crate::child::{SlotProgram, connection, explain_status};
use crate::memory::OomKills;

/// Longest silence of a slot beyond the measured period: it may load libraries, compile a scene,
/// render it, or finish a control step.
const MAX_SILENCE: Duration = Duration::from_secs(120);

/// Processes of measured slots. Dropping them kills the processes.
pub(super) struct Slots {
    program: SlotProgram,
    running: Vec<Running>,
    /// Name that the slots' renderer reports for itself.
    renderer: String,
    kills_before: OomKills,
    sender: Sender<(usize, Inbound)>,
    inbox: Receiver<(usize, Inbound)>,
    /// [`MAX_SILENCE`], or less in tests.
    max_silence: Duration,
}

struct Running {
    child: Child,
    connection: UnixStream,
}

enum Inbound {
    Report(SlotReport),
    /// The slot closed its connection.
    End,
}

/// Combined figures of a number of slots.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measured {
    /// Control steps per second, with the number of slots.
    pub(super) throughput: Throughput,
    /// Frames per second of all slots together.
    pub(super) frames_per_sec: f64,
    /// Control steps per second of the slowest slot.
    pub(super) slowest: f64,
    /// Control steps per second of the fastest slot.
    pub(super) fastest: f64,
    /// Largest use of any slot, for each kind of memory.
    pub(super) memory: SlotMemory,
}

impl Slots {
    /// Creates an empty set of slots; `program` starts each slot.
    pub(super) fn new(program: SlotProgram) -> Self {
        let (sender, inbox) = channel();
        Self {
            program,
            running: Vec::new(),
            renderer: String::new(),
            kills_before: OomKills::read(),
            sender,
            inbox,
            max_silence: MAX_SILENCE,
        }
    }

    /// Returns the name that the renderer reports; empty before the first slot is ready.
    pub(super) fn renderer(&self) -> &str {
        &self.renderer
    }

    /// Measures `slots` slots together for `secs` seconds. Starts missing slots first, and begins
    /// when the last slot is ready. Surplus slots wait, which takes memory but no processor time.
    pub(super) fn measure(&mut self, slots: usize, secs: f64) -> Result<Measured, MeasureError> {
        self.start(slots)?;
        let request = serde_json::to_string(&secs).map_err(io::Error::from)?;
        for slot in 0..slots {
            // A failed write means that the slot has ended, which `receive` reports.
            let _ = writeln!(self.running[slot].connection, "{request}");
        }
        let limit = Duration::from_secs_f64(secs) + self.max_silence;
        let begin = Instant::now();
        let mut counts = Vec::new();
        while counts.len() < slots {
            if let SlotReport::Counted(count) = self.receive(slots, begin, limit)? {
                counts.push(count);
            }
        }
        Ok(Measured::from_counts(&counts))
    }

    /// Starts slots until there are `slots`, and waits until all are ready.
    pub(super) fn start(&mut self, slots: usize) -> Result<(), MeasureError> {
        let begin = Instant::now();
        let mut missing = 0;
        while self.running.len() < slots {
            self.start_one()?;
            missing += 1;
        }
        while missing > 0 {
            let report = self.receive(slots, begin, self.max_silence)?;
            if let SlotReport::Ready { renderer } = report {
                self.renderer = renderer;
                missing -= 1;
            }
        }
        Ok(())
    }

    fn start_one(&mut self) -> Result<(), MeasureError> {
        let (parent_end, child_end) = connection()?;
        let messages = BufReader::new(parent_end.try_clone()?);
        let child = Command::new(&self.program.program)
            .args(&self.program.arguments)
            .stdin(child_end)
            // Native libraries must not write to this program's standard output.
            .stdout(io::stderr().as_fd().try_clone_to_owned()?)
            .spawn()
            .map_err(|source| MeasureError::Start {
                program: self.program.program.clone(),
                source,
            })?;
        let (slot, sender) = (self.running.len(), self.sender.clone());
        thread::spawn(move || listen(slot, messages, &sender));
        self.running.push(Running { child, connection: parent_end });
        Ok(())
    }

    /// Receives the next report of one of `slots` slots, until `limit` has passed since `begin`.
    fn receive(
        &mut self,
        slots: usize,
        begin: Instant,
        limit: Duration,
    ) -> Result<SlotReport, MeasureError> {
        let remaining = limit.saturating_sub(begin.elapsed());
        match self.inbox.recv_timeout(remaining) {
            Ok((_, Inbound::Report(message))) => Ok(message),
            Ok((slot, Inbound::End)) => {
                let status = self.running[slot].child.wait()?;
                let kills = OomKills::read().since(self.kills_before);
                let end = explain_status(status, kills);
                Err(MeasureError::Ended { slot, end })
            }
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                Err(MeasureError::Silent { slots, secs: limit.as_secs_f64() })
            }
        }
    }
}

/// Passes on a slot's messages until it closes the connection.
fn listen(slot: usize, messages: BufReader<UnixStream>, sender: &Sender<(usize, Inbound)>) {
    for line in messages.lines().map_while(Result::ok) {
        match serde_json::from_str(&line) {
            Ok(message) => {
                if sender.send((slot, Inbound::Report(message))).is_err() {
                    return;
                }
            }
            Err(_) => eprintln!("slot {slot} sent a line that is not a report: {line}"),
        }
    }
    // If the receiver is gone, no one needs the message.
    let _ = sender.send((slot, Inbound::End));
}

impl Drop for Running {
    fn drop(&mut self) {
        // A measured slot holds nothing that could be lost.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Measured {
    /// Combines at least one count.
    fn from_counts(counts: &[Count]) -> Self {
        let rates = || counts.iter().map(|count| f64::from(count.steps) / count.secs);
        let frames = counts.iter().map(|count| f64::from(count.frames) / count.secs);
        let largest = |bytes: fn(&Count) -> u64| counts.iter().map(bytes).max().unwrap_or(0);
        Self {
            throughput: Throughput { slots: counts.len(), steps_per_sec: rates().sum() },
            frames_per_sec: frames.sum(),
            slowest: rates().fold(f64::INFINITY, f64::min),
            fastest: rates().fold(0.0, f64::max),
            memory: SlotMemory {
                resident: largest(|count| count.memory.resident),
                proportional: largest(|count| count.memory.proportional),
                own: largest(|count| count.memory.own),
                files: largest(|count| count.memory.files),
                scene: largest(|count| count.memory.scene),
                scene_files: largest(|count| count.memory.scene_files),
            },
        }
    }

    /// Returns the memory of a campaign's slot that keeps `scenes` compiled scenes, extrapolated
    /// from the measured slots, which keep one scene.
    pub(super) fn per_slot(&self, scenes: usize) -> PerSlot {
        let further = (scenes as u64).saturating_sub(1);
        PerSlot {
            own: self.memory.own + self.memory.scene * further,
            scenes,
            scene_files: self.memory.scene_files,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_add_up_and_memory_is_that_of_the_largest_slot() {
        let count = |secs, steps, own| Count {
            secs,
            steps,
            frames: 2 * steps,
            memory: SlotMemory {
                resident: own + 10,
                proportional: own + 5,
                own,
                files: 10,
                scene: 40,
                scene_files: 7,
            },
        };
        let all = Measured::from_counts(&[count(2.0, 40, 100), count(2.5, 75, 90)]);
        assert_eq!(all.throughput.slots, 2);
        assert_eq!((all.throughput.steps_per_sec, all.frames_per_sec), (50.0, 100.0));
        assert_eq!((all.slowest, all.fastest), (20.0, 30.0));
        let per_slot = |scenes, own| PerSlot { own, scenes, scene_files: 7 };
        assert_eq!((all.memory.resident, all.memory.proportional), (110, 105));
        assert_eq!(all.per_slot(1), per_slot(1, 100));
        assert_eq!(all.per_slot(2), per_slot(2, 140));
    }

    #[test]
    fn a_missing_program_is_named() {
        let mut slots = Slots::new(SlotProgram {
            program: "/nonexistent/worker".into(),
            arguments: Vec::new(),
        });
        let error = slots.start(1).expect_err("a missing program").to_string();
        assert!(error.contains("/nonexistent/worker"), "{error}");
    }

    #[test]
    fn an_early_exit_is_reported_with_its_status() {
        let mut slots = Slots::new(SlotProgram {
            program: "sh".into(),
            arguments: vec!["-c".into(), "echo no JSON; exit 3".into()],
        });
        let error = slots.measure(2, 0.1).expect_err("no counts").to_string();
        assert!(error.contains("exited with code 3"), "{error}");
    }

    #[test]
    fn a_silent_slot_is_reported_with_the_number_of_measured_slots() {
        let script = r#"echo '{"ready":{"renderer":"none"}}' >&0; exec sleep 60"#;
        let mut slots = Slots::new(SlotProgram {
            program: "sh".into(),
            arguments: vec!["-c".into(), script.into()],
        });
        slots.start(2).expect("ready");
        slots.max_silence = Duration::ZERO;
        let error = slots.measure(1, 0.1).expect_err("no count").to_string();
        assert!(error.starts_with("measure with 1 slot: "), "{error}");
    }
}
