//! Event loop that owns a worker's state and carries out the decisions of `slot_state`.

mod claiming;
mod ending;
mod leases;

use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;
use std::time::Duration;

use benchmark::ManifestRow;
use benchmark::attempt::{AttemptId, Backoff, Waits};
use proto::coordinator::{RegisterRequest, SignOffRequest};
use scene::FileStamps;
use terminal::counted;
use tokio::sync::{mpsc, watch};
use tokio::task::{self, JoinError, JoinSet};
use tokio::time::{Instant, Interval, MissedTickBehavior, interval};
use transport::chain;

use super::config::{Config, TIMING_UNTIL_REGISTERED, Timing, registration};
use super::deliver::{Answer, Delivery, Ending, deliver};
use super::error::SuperviseError;
use super::event::{Event, ProcessEnd, ProcessKey};
use super::link::Link;
use super::process::SlotProcess;
use super::slot_state::{
    Decision, Kill, Mode, ProcessState, START_DEADLINE, SlotState, VideoDecision, Work,
};
use super::upload::{Upload, Uploader, remove};
use crate::message::{Assignment, Failure, FailureKind, RolloutEvent, SlotCommand, SlotEvent};

/// Interval of the checks for timeouts, and longest delay before a new lease is acknowledged.
const TICK: Duration = Duration::from_millis(250);
/// Longest wait for unfinished uploads of a worker that is otherwise done.
const UPLOAD_GRACE: Duration = Duration::from_secs(15);
/// Largest number of processes started before the loop handles signals and messages again.
const STARTS_AT_ONCE: usize = 8;
/// Longest wait for slots' processes to end by themselves.
const END_DEADLINE: Duration = Duration::from_secs(5);

#[derive(Debug)]
struct Slot {
    state: SlotState,
    process: Option<SlotProcess>,
    /// Number of starts of the slot's process.
    starts: u64,
    /// Assignment of the current job, or else of the last one. Claims name its task, whose scene
    /// the slot's process has usually compiled.
    assignment: Option<Assignment>,
    campaign: String,
    /// Assignment whose files are being fetched, with its campaign.
    preparing: Option<(Assignment, String)>,
}

/// A worker's state.
pub(super) struct Supervisor {
    config: Config,
    timing: Timing,
    link: Link,
    uploader: Uploader,
    slots: Vec<Slot>,
    /// Registration of the worker; `None` until a slot reports its renderer, which this process
    /// cannot determine without native code.
    registration: Option<RegisterRequest>,
    /// True once the worker is registered; jobs are claimed only then.
    is_registered: bool,
    mode: Mode,
    /// Signals the link to drop its claims.
    drain: watch::Sender<bool>,
    shutdown_requested_at: Option<Instant>,
    /// Start of the idle time. Outages of the coordinator do not count as idle.
    idle_since: Instant,
    /// Reason why the worker ends, unless it was asked to end.
    fault: Option<SuperviseError>,
    is_heartbeat_in_flight: bool,
    /// True if a lease was taken that no heartbeat has named yet. The first heartbeat that names a
    /// lease acknowledges it.
    has_unacknowledged_lease: bool,
    /// Back-off of failed fetches of assets.
    fetches: Backoff,
    /// Earliest time of the next claim after a failed fetch.
    claims_from: Instant,
    /// Rollouts that lacked task files, by the keys of their tasks, with the stamps of the files
    /// when they were checked.
    lacks: BTreeMap<String, (ManifestRow, FileStamps)>,
    /// The coordinator's last reason for granting no job.
    idle_reason: String,
    events: mpsc::Sender<Event>,
    calls: JoinSet<()>,
    uploads: JoinSet<()>,
    processes: JoinSet<()>,
    /// Time at which a worker that is otherwise done stops waiting for `uploads`.
    uploads_until: Option<Instant>,
}

impl Supervisor {
    pub(super) fn new(
        config: Config,
        link: Link,
        drain: watch::Sender<bool>,
        events: mpsc::Sender<Event>,
        now: Instant,
    ) -> Self {
        let slots = (0..config.slots).map(|slot| Slot {
            state: SlotState::new(now, config.seed.wrapping_add(slot as u64)),
            process: None,
            starts: 0,
            assignment: None,
            campaign: String::new(),
            preparing: None,
        });
        let seed = config.seed;
        Self {
            slots: slots.collect(),
            config,
            timing: TIMING_UNTIL_REGISTERED,
            uploader: Uploader::new(link.clone()),
            link,
            registration: None,
            is_registered: false,
            mode: Mode::Serving,
            drain,
            shutdown_requested_at: None,
            idle_since: now,
            fault: None,
            is_heartbeat_in_flight: false,
            has_unacknowledged_lease: false,
            fetches: Backoff::new(Waits::USUAL, seed),
            claims_from: now,
            lacks: BTreeMap::new(),
            idle_reason: String::new(),
            events,
            calls: JoinSet::new(),
            uploads: JoinSet::new(),
            processes: JoinSet::new(),
            uploads_until: None,
        }
    }

    pub(super) async fn serve(
        mut self,
        mut inbox: mpsc::Receiver<Event>,
        mut shutdown: mpsc::Receiver<()>,
    ) -> Result<(), SuperviseError> {
        let mut ticks = interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut heartbeats = self.heartbeats();
        let mut has_more_to_start = true;
        while !self.is_done(Instant::now()) {
            let event = tokio::select! {
                Some(event) = inbox.recv() => event,
                Some(()) = shutdown.recv() => Event::Shutdown,
                () = task::yield_now(), if has_more_to_start => Event::Tick,
                _ = ticks.tick() => Event::Tick,
                _ = heartbeats.tick() => Event::HeartbeatDue,
                // Finished tasks have already sent their events.
                Some(ended) = self.calls.join_next() => match panicked(ended) {
                    Some(event) => event,
                    None => continue,
                },
                Some(ended) = self.uploads.join_next() => match panicked(ended) {
                    Some(event) => event,
                    None => continue,
                },
                Some(ended) = self.processes.join_next() => match panicked(ended) {
                    Some(event) => event,
                    None => continue,
                },
            };
            let now = Instant::now();
            self.handle(event, now);
            if heartbeats.period() != self.timing.heartbeat {
                heartbeats = self.heartbeats();
            }
            has_more_to_start = self.carry_out_decisions(now);
        }
        self.end(inbox).await;
        self.sign_off().await;
        self.fault.map_or(Ok(()), Err)
    }

    fn heartbeats(&self) -> Interval {
        let mut heartbeats = interval(self.timing.heartbeat);
        heartbeats.set_missed_tick_behavior(MissedTickBehavior::Delay);
        heartbeats
    }

    fn is_done(&mut self, now: Instant) -> bool {
        if self.mode == Mode::Serving {
            return false;
        }
        if matches!(self.mode, Mode::Abandoning { until } if now >= until) {
            return true;
        }
        if !self.slots.iter().all(|slot| slot.state.is_done()) {
            return false;
        }
        let until = *self.uploads_until.get_or_insert(now + UPLOAD_GRACE);
        self.uploads.is_empty() || now >= until
    }

    /// Closes the slots' connections and waits for their processes to end.
    async fn end(&mut self, mut inbox: mpsc::Receiver<Event>) {
        for slot in &mut self.slots {
            if !matches!(slot.state.work, Work::Nothing | Work::Claiming) {
                tracing::warn!("a rollout was not given back in time; its lease will expire");
            }
            slot.process = None;
        }
        if !self.uploads.is_empty() {
            let videos = counted(self.uploads.len() as u64, "video");
            tracing::warn!("{videos} dropped: not stored in time");
        }
        self.calls.abort_all();
        self.uploads.abort_all();
        let processes = &mut self.processes;
        let ending = async {
            // The processes' tasks can only end while their events are received.
            loop {
                tokio::select! {
                    ended = processes.join_next() => if ended.is_none() { return },
                    _ = inbox.recv() => {}
                }
            }
        };
        if tokio::time::timeout(END_DEADLINE, ending).await.is_err() {
            tracing::warn!("some slots' processes do not end by themselves and are killed");
        }
    }

    /// Signs off at the coordinator, which would otherwise count this worker as alive until a
    /// lease's length has passed.
    async fn sign_off(&self) {
        if !self.is_registered {
            return;
        }
        let request = SignOffRequest { worker_id: self.config.identity.worker.to_string() };
        if let Err(status) = self.link.sign_off(request).await {
            tracing::debug!("the coordinator did not receive the sign-off: {}", chain(&status));
        }
    }

    fn handle(&mut self, event: Event, now: Instant) {
        match event {
            Event::Tick => {
                if self.has_unacknowledged_lease {
                    self.send_heartbeat();
                }
                self.end_in_time(now);
            }
            Event::Registered(answer) => self.registered(answer),
            Event::HeartbeatDue => self.send_heartbeat(),
            Event::Renewed(answer) => self.renewed(answer, now),
            Event::Claimed { slot, answer } => self.claimed(slot, answer, now),
            Event::Provided { slot, attempt, outcome } => {
                self.provided(slot, attempt, outcome, now)
            }
            Event::Delivered { slot, label, answer } => self.delivered(slot, &label, answer),
            Event::Slot { key, event } => {
                if self.is_current(key) {
                    self.handle_slot_event(key.slot, event, now);
                }
            }
            Event::Ended { key, end } => {
                if self.is_current(key) {
                    self.process_ended(key.slot, end, now);
                }
            }
            Event::Panicked { task, error } => self.panicked(task, error, now),
            Event::Shutdown => self.shut_down(now),
        }
    }

    fn is_current(&self, key: ProcessKey) -> bool {
        let process = self.slots[key.slot].process.as_ref();
        process.is_some_and(|process| process.key == key)
    }

    /// Carries out the decisions of all slots. Starts at most [`STARTS_AT_ONCE`] processes, since
    /// starting one takes milliseconds; returns true if more processes are to be started.
    fn carry_out_decisions(&mut self, now: Instant) -> bool {
        let mut starts_left = STARTS_AT_ONCE;
        for slot in 0..self.slots.len() {
            let state = &self.slots[slot].state;
            match state.decide(self.mode, self.timing.progress_timeout, now) {
                Some(Decision::Start) if starts_left == 0 => return true,
                Some(Decision::Start) => {
                    starts_left -= 1;
                    self.start_process(slot, now);
                }
                Some(Decision::Claim) if self.is_registered && now >= self.claims_from => {
                    self.claim(slot);
                }
                Some(Decision::Kill(reason)) => self.kill(slot, reason),
                Some(Decision::Claim) | None => {}
            }
        }
        false
    }

    fn start_process(&mut self, slot: usize, now: Instant) {
        let entry = &mut self.slots[slot];
        entry.starts += 1;
        let key = ProcessKey { slot, number: entry.starts };
        let Config { slot_program, access, .. } = &self.config;
        let (processes, events) = (&mut self.processes, self.events.clone());
        let started = SlotProcess::start(slot_program, access, key, processes, events);
        match started {
            Ok(process) => {
                entry.process = Some(process);
                entry.state.process = ProcessState::Starting { deadline: now + START_DEADLINE };
            }
            Err(error) => self.start_failed(slot, error, now),
        }
    }

    /// Handles a failed start of a process. The worker stops if a slot's first process exceeds the
    /// machine's limits, because later starts would too.
    fn start_failed(&mut self, slot: usize, error: io::Error, now: Instant) {
        if self.slots[slot].starts == 1 && is_exhaustion(&error) {
            return self.stop(SuperviseError::Exhausted { slot, error });
        }
        let program = self.config.slot_program.program.display();
        let end = ProcessEnd::from(format!("could not start {program}: {error}"));
        self.process_ended(slot, end, now);
    }

    fn kill(&mut self, slot: usize, reason: Kill) {
        let kill = match reason {
            Kill::NotReady => "its process does not become ready",
            Kill::Stuck => "its rollout makes no progress",
            Kill::StuckFilming => "its video makes no progress; the result is not affected",
            Kill::NotAbandoned => "it does not abandon its rollout",
        };
        tracing::warn!("slot {slot} is killed: {kill}");
        let slot = &mut self.slots[slot];
        slot.state.killed(reason);
        if let Some(process) = &slot.process {
            process.kill();
        }
    }

    fn handle_slot_event(&mut self, slot: usize, event: SlotEvent, now: Instant) {
        let (attempt, event) = match event {
            SlotEvent::Ready { renderer, fingerprint } => {
                return self.became_ready(slot, renderer, &fingerprint);
            }
            SlotEvent::Rollout { attempt, event } => (attempt, event),
        };
        let state = &mut self.slots[slot].state;
        let (is_filmed, ending) = match event {
            RolloutEvent::Progress(steps) => return state.advanced(attempt, steps, now),
            RolloutEvent::Filming(pictures) => {
                return state.filming_advanced(attempt, pictures, now);
            }
            RolloutEvent::Abandoned => {
                state.rollout_ended(attempt, false, now);
                return;
            }
            RolloutEvent::Filmed => {
                let decision = state.filming_ended(attempt, true);
                return self.carry_out_video(slot, decision);
            }
            RolloutEvent::NotFilmed(problem) => {
                let decision = state.filming_ended(attempt, false);
                if decision.is_some() {
                    tracing::warn!("no video of {}: failed to {problem}", self.label(slot));
                }
                return self.carry_out_video(slot, decision);
            }
            RolloutEvent::Finished(finished) => {
                (finished.is_filmed_next, Ending::Finished(finished))
            }
            RolloutEvent::Failed(failure) => (false, Ending::Failed(failure)),
        };
        if state.rollout_ended(attempt, is_filmed, now) {
            let label = self.label(slot);
            self.send_delivery(slot, attempt, label, ending);
        }
    }

    /// Handles a slot's readiness. The first ready slot registers the worker with its renderer. The
    /// other slots must have the same renderer, or the coordinator would refuse some of their
    /// results.
    fn became_ready(&mut self, slot: usize, renderer: String, fingerprint: &str) {
        self.slots[slot].state.became_ready();
        tracing::info!("slot {slot} is ready: renderer {renderer}, fingerprint {fingerprint}");
        match &self.registration {
            None => self.register(registration(&self.config, renderer)),
            Some(registration) if registration.renderer == renderer => {}
            Some(registration) => {
                let registered = registration.renderer.clone();
                self.stop(SuperviseError::Renderers { slot, renderer, registered });
            }
        }
    }

    /// Returns campaign and session of the slot's assignment, for messages.
    fn label(&self, slot: usize) -> String {
        let Slot { assignment, campaign, .. } = &self.slots[slot];
        let session = assignment.as_ref().map(|job| job.session.to_string());
        format!("{campaign}: {}", session.unwrap_or_default())
    }

    fn process_ended(&mut self, slot: usize, end: ProcessEnd, now: Instant) {
        self.slots[slot].process = None;
        let state = &mut self.slots[slot].state;
        let loss = state.ended(now);
        if state.cannot_start() {
            // The process's last output is in the log already.
            let end = end.description.clone();
            self.stop(SuperviseError::Slot { slot, end });
        } else {
            tracing::warn!("the process of slot {slot} {}", end.description);
        }
        if let Some(attempt) = loss.video {
            tracing::warn!("no video of {}: it was being made", self.label(slot));
            self.carry_out_video(slot, Some(VideoDecision::Drop(attempt)));
        }
        if let Some((attempt, kind)) = loss.rollout {
            let error = self.explain_loss(kind, &end.with_last_lines());
            let label = self.label(slot);
            let ending = Ending::Failed(Failure { kind, error });
            self.send_delivery(slot, attempt, label, ending);
        }
    }

    fn video_file(&self, attempt: AttemptId) -> PathBuf {
        self.config.scratch.join(format!("{attempt}.mp4"))
    }

    fn carry_out_video(&mut self, slot: usize, decision: Option<VideoDecision>) {
        match decision {
            None => {}
            Some(VideoDecision::Abandon(attempt)) => {
                if let Some(process) = &self.slots[slot].process {
                    process.send(SlotCommand::Abandon(attempt));
                }
            }
            Some(VideoDecision::Drop(attempt)) => {
                self.calls.spawn(remove(self.video_file(attempt)));
            }
            Some(VideoDecision::Upload(attempt)) => {
                let upload =
                    Upload { attempt, file: self.video_file(attempt), label: self.label(slot) };
                self.uploads.spawn(self.uploader.clone().upload(upload));
            }
        }
    }

    fn explain_loss(&self, kind: FailureKind, end: &str) -> String {
        let host = &self.config.identity.host;
        if kind == FailureKind::SlotStuck {
            let secs = self.timing.progress_timeout.as_secs_f64();
            format!("the rollout made no progress on {host} for {secs:.0} s and was killed")
        } else {
            format!("the slot's process on {host} {end}")
        }
    }

    fn send_delivery(&mut self, slot: usize, attempt: AttemptId, label: String, ending: Ending) {
        let delivery = Delivery { attempt, label, identity: self.config.identity.clone(), ending };
        delivery.log();
        let label = delivery.label.clone();
        let (link, events) = (self.link.clone(), self.events.clone());
        self.calls.spawn(async move {
            let answer = deliver(&link, delivery).await;
            let delivered = Event::Delivered { slot, label, answer };
            let _ = events.send(delivered).await;
        });
    }

    fn delivered(&mut self, slot: usize, label: &str, answer: Answer) {
        let decision = self.slots[slot].state.delivered(answer.is_committed());
        self.carry_out_video(slot, decision);
        answer.log(label);
        if let Some(reason) = answer.stop_leasing() {
            self.stop(SuperviseError::Stopped(reason));
        }
    }

    /// Handles a task's panic. If the task owned a slot's process, the process was killed with it.
    /// If it was another task, the worker gives up; otherwise it would renew the lease of a rollout
    /// for ever while the rollout waits for that task.
    fn panicked(&mut self, task: task::Id, error: String, now: Instant) {
        let owns = |slot: &Slot| matches!(&slot.process, Some(process) if process.task == task);
        if let Some(slot) = self.slots.iter().position(owns) {
            let end = ProcessEnd::from(format!("lost the task that supervised it: {error}"));
            return self.process_ended(slot, end, now);
        }
        tracing::error!("a task of this worker panicked: {error}");
        self.start_to_drain();
        self.fault.get_or_insert(SuperviseError::Panicked(error));
        self.give_up(now);
    }
}

/// Returns true if an error reports an exhausted limit of open files, processes or memory.
fn is_exhaustion(error: &io::Error) -> bool {
    use rustix::io::Errno;
    let limits = [Errno::MFILE, Errno::NFILE, Errno::AGAIN, Errno::NOMEM];
    let code = error.raw_os_error();
    limits.iter().any(|limit| code == Some(limit.raw_os_error()))
}

fn panicked(ended: Result<(), JoinError>) -> Option<Event> {
    // Tasks are only aborted after the loop, so a `JoinError` here is a panic.
    let error = ended.err()?;
    Some(Event::Panicked { task: error.id(), error: error.to_string() })
}

#[cfg(test)]
mod tests;
