//! The loop that owns a worker's state: takes one event after the other, and
//! carries out what `slot_state` decides.

mod claiming;

use std::time::Duration;

use proto::coordinator::{
    ClaimResponse, HeartbeatRequest, HeartbeatResponse, Progress, RegisterRequest, RegisterResponse,
};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval};
use tonic::Status;

use super::deliver::{Answer, Delivery, Ending, deliver};
use super::link::Link;
use super::process::{ProcessKey, SlotProcess};
use super::slot_state::{
    ABANDON_DEADLINE, Decision, Kill, Mode, ProcessState, START_DEADLINE, SlotState, Work,
};
use super::{Config, SuperviseError, TIMING_UNTIL_REGISTERED, Timing, registration};
use crate::grpc::in_words;
use crate::ids::LeaseKey;
use crate::message::{Assignment, Failure, FailureKind, Order, Report};

/// How often time-outs are looked at.
const TICK: Duration = Duration::from_millis(250);
/// A second request to end within so short a time is an echo of the first.
const ECHO: Duration = Duration::from_millis(500);
/// How long an abandoning worker tries to give its jobs back.
const GIVE_BACK_DEADLINE: Duration = Duration::from_secs(10);
/// How long slots may take to end once nothing is wanted of them.
const END_DEADLINE: Duration = Duration::from_secs(5);

/// What happens to a worker.
#[derive(Debug)]
pub(crate) enum Event {
    /// Time has passed.
    Tick,
    /// The coordinator answered the worker's registration.
    Registered(Result<RegisterResponse, Status>),
    /// Leases are to be renewed.
    HeartbeatDue,
    /// The coordinator answered a heartbeat that named these leases.
    Renewed {
        sent: Vec<LeaseKey>,
        answer: Result<HeartbeatResponse, Status>,
    },
    /// The coordinator answered a slot's claim.
    Claimed {
        slot: usize,
        answer: Result<ClaimResponse, Status>,
    },
    /// The coordinator knows how a slot's rollout ended.
    Delivered { slot: usize, answer: Answer },
    /// A slot's process said something.
    Reported { key: ProcessKey, report: Report },
    /// A slot's process ended, as told in `end`.
    Ended { key: ProcessKey, end: String },
    /// Somebody wants the worker to end: once, finish; twice, at once.
    Shutdown,
}

#[derive(Debug)]
struct Slot {
    state: SlotState,
    process: Option<SlotProcess>,
    lives: u64,
    /// The rollout in hand, or the last one: its scene is compiled.
    assignment: Option<Assignment>,
}

/// The state of a worker and the way to change it.
pub(super) struct Supervisor {
    config: Config,
    timing: Timing,
    link: Link,
    slots: Vec<Slot>,
    /// As whom the worker registers: known once a slot has said what draws,
    /// which this process cannot find out without native code.
    registration: Option<RegisterRequest>,
    /// Nothing is claimed before.
    is_registered: bool,
    mode: Mode,
    /// Tells the link that no more work is wanted.
    drain: watch::Sender<bool>,
    /// When it was first told to end.
    told_to_end_at: Option<Instant>,
    /// Why the worker ends, if not because it was told to.
    fault: Option<SuperviseError>,
    heartbeat_under_way: bool,
    /// What the coordinator last said about having no work.
    idle_reason: String,
    events: mpsc::Sender<Event>,
    calls: JoinSet<()>,
    processes: JoinSet<()>,
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
            lives: 0,
            assignment: None,
        });
        Self {
            slots: slots.collect(),
            config,
            timing: TIMING_UNTIL_REGISTERED,
            link,
            registration: None,
            is_registered: false,
            mode: Mode::Serving,
            drain,
            told_to_end_at: None,
            fault: None,
            heartbeat_under_way: false,
            idle_reason: String::new(),
            events,
            calls: JoinSet::new(),
            processes: JoinSet::new(),
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
        while !self.is_done(Instant::now()) {
            let event = tokio::select! {
                Some(event) = inbox.recv() => event,
                Some(()) = shutdown.recv() => Event::Shutdown,
                _ = ticks.tick() => Event::Tick,
                _ = heartbeats.tick() => Event::HeartbeatDue,
                // Finished tasks are let go of; what they had to say they said.
                Some(_) = self.calls.join_next() => continue,
                Some(_) = self.processes.join_next() => continue,
            };
            let now = Instant::now();
            self.handle(event, now);
            if heartbeats.period() != self.timing.heartbeat {
                heartbeats = self.heartbeats();
            }
            self.carry_out_decisions(now);
        }
        self.end(inbox).await;
        self.fault.map_or(Ok(()), Err)
    }

    fn heartbeats(&self) -> Interval {
        let mut heartbeats = interval(self.timing.heartbeat);
        heartbeats.set_missed_tick_behavior(MissedTickBehavior::Delay);
        heartbeats
    }

    fn is_done(&self, now: Instant) -> bool {
        let idle = self.slots.iter().all(|slot| slot.state.is_done());
        match self.mode {
            Mode::Serving => false,
            Mode::Draining => idle,
            Mode::Abandoning { until } => idle || now >= until,
        }
    }

    /// Lets the slots' processes end, and sees that they do.
    async fn end(&mut self, mut inbox: mpsc::Receiver<Event>) {
        for slot in &mut self.slots {
            if !matches!(slot.state.work, Work::Nothing | Work::Claiming) {
                tracing::warn!("a rollout was not given back in time; its lease will expire");
            }
            slot.process = None;
        }
        self.calls.abort_all();
        let processes = &mut self.processes;
        let ending = async {
            // Reports must be taken for the processes' tasks to end.
            loop {
                tokio::select! {
                    ended = processes.join_next() => if ended.is_none() { return },
                    _ = inbox.recv() => {}
                }
            }
        };
        if tokio::time::timeout(END_DEADLINE, ending).await.is_err() {
            tracing::warn!("a slot's process does not end by itself and is killed");
        }
    }

    fn handle(&mut self, event: Event, now: Instant) {
        match event {
            Event::Tick => {}
            Event::Registered(answer) => self.registered(answer),
            Event::HeartbeatDue => self.send_heartbeat(),
            Event::Renewed { sent, answer } => self.renewed(&sent, answer, now),
            Event::Claimed { slot, answer } => self.claimed(slot, answer, now),
            Event::Delivered { slot, answer } => self.delivered(slot, answer),
            Event::Reported { key, report } => {
                if self.is_current(key) {
                    self.reported(key.slot, report, now);
                }
            }
            Event::Ended { key, end } => {
                if self.is_current(key) {
                    self.process_ended(key.slot, end, now);
                }
            }
            Event::Shutdown => self.shut_down(now),
        }
    }

    fn is_current(&self, key: ProcessKey) -> bool {
        let process = self.slots[key.slot].process.as_ref();
        process.is_some_and(|process| process.key == key)
    }

    fn carry_out_decisions(&mut self, now: Instant) {
        for slot in 0..self.slots.len() {
            let state = &self.slots[slot].state;
            match state.decide(self.mode, self.timing.progress_timeout, now) {
                Some(Decision::Start) => self.start_process(slot, now),
                Some(Decision::Claim) if self.is_registered => self.claim(slot),
                Some(Decision::Kill(why)) => self.kill(slot, why),
                Some(Decision::Claim) | None => {}
            }
        }
    }

    fn start_process(&mut self, slot: usize, now: Instant) {
        let slots = &mut self.slots[slot];
        slots.lives += 1;
        let key = ProcessKey {
            slot,
            life: slots.lives,
        };
        let command = &self.config.slot_command;
        let started = SlotProcess::start(command, key, &mut self.processes, self.events.clone());
        match started {
            Ok(process) => {
                slots.process = Some(process);
                slots.state.process = ProcessState::Starting {
                    deadline: now + START_DEADLINE,
                };
            }
            Err(error) => {
                let program = command.program.display();
                self.process_ended(slot, format!("could not start {program}: {error}"), now);
            }
        }
    }

    fn kill(&mut self, slot: usize, why: Kill) {
        let kill = match why {
            Kill::NotReady => "its process does not become ready",
            Kill::Stuck => "its rollout stands still",
            Kill::HoldsOn => "it does not let go of its rollout",
        };
        tracing::warn!("slot {slot} is killed: {kill}");
        let slot = &mut self.slots[slot];
        slot.state.killed(why);
        if let Some(process) = &slot.process {
            process.kill();
        }
    }

    fn reported(&mut self, slot: usize, report: Report, now: Instant) {
        let state = &mut self.slots[slot].state;
        let lease = state.progress().map(|(lease, _)| lease);
        let ending = match report {
            Report::Ready {
                renderer,
                fingerprint,
            } => return self.became_ready(slot, renderer, &fingerprint),
            Report::Progress(steps) => return state.advanced(steps, now),
            Report::Abandoned => {
                state.rollout_ended();
                return;
            }
            Report::Finished(finished) => Ending::Finished(finished),
            Report::Failed(failure) => Ending::Failed(failure),
        };
        if let (true, Some(lease)) = (state.rollout_ended(), lease) {
            let session = self.session(slot);
            self.send_delivery(slot, lease, session, ending);
        }
    }

    /// A slot takes orders. The first one says as whom to register; the others
    /// must draw alike, or some of their results would be refused.
    fn became_ready(&mut self, slot: usize, renderer: String, fingerprint: &str) {
        self.slots[slot].state.became_ready();
        tracing::info!("slot {slot} is ready: renderer {renderer}, fingerprint {fingerprint}");
        match &self.registration {
            None => self.register(registration(&self.config, renderer)),
            Some(known) if known.renderer == renderer => {}
            Some(known) => {
                let registered = known.renderer.clone();
                self.stop(SuperviseError::Renderers {
                    slot,
                    renderer,
                    registered,
                });
            }
        }
    }

    fn register(&mut self, registration: RegisterRequest) {
        self.registration = Some(registration.clone());
        let (link, events) = (self.link.clone(), self.events.clone());
        self.calls.spawn(async move {
            let answer = link.register(registration).await;
            let _ = events.send(Event::Registered(answer)).await;
        });
    }

    fn registered(&mut self, answer: Result<RegisterResponse, Status>) {
        let url = &self.config.coordinator;
        match answer {
            Ok(answer) => {
                tracing::info!("registered with the coordinator at {url}");
                self.timing = Timing::from(&answer);
                self.is_registered = true;
            }
            Err(status) => {
                let (url, answer) = (url.clone(), in_words(&status));
                self.stop(SuperviseError::Refused { url, answer });
            }
        }
    }

    /// The rollout in hand, for people.
    fn session(&self, slot: usize) -> String {
        let assignment = self.slots[slot].assignment.as_ref();
        assignment.map_or_else(String::new, |it| it.session.to_string())
    }

    fn process_ended(&mut self, slot: usize, end: String, now: Instant) {
        self.slots[slot].process = None;
        let state = &mut self.slots[slot].state;
        let lost = state.ended(now);
        if state.cannot_start() {
            let end = end.clone();
            self.stop(SuperviseError::Slot { slot, end });
        } else {
            tracing::warn!("the process of slot {slot} {end}");
        }
        if let Some((lease, kind)) = lost {
            let error = self.explain_loss(kind, &end);
            let session = self.session(slot);
            self.send_delivery(
                slot,
                lease,
                session,
                Ending::Failed(Failure { kind, error }),
            );
        }
    }

    /// Reads after "failed to …".
    fn explain_loss(&self, kind: FailureKind, end: &str) -> String {
        let host = &self.config.identity.host;
        if kind == FailureKind::SlotStuck {
            let secs = self.timing.progress_timeout.as_secs_f64();
            format!("simulate on {host}: the rollout stood still for {secs:.0} s and was killed")
        } else {
            format!("simulate on {host}: the slot's process {end}")
        }
    }

    fn send_delivery(&mut self, slot: usize, lease: LeaseKey, label: String, ending: Ending) {
        let assignment = self.slots[slot].assignment.as_ref();
        let delivery = Delivery {
            lease: lease.to_wire(&self.config.identity.worker),
            label,
            realisation: assignment.map(|it| it.realisation).unwrap_or_default(),
            identity: self.config.identity.clone(),
            ending,
        };
        delivery.tell();
        let (link, events) = (self.link.clone(), self.events.clone());
        self.calls.spawn(async move {
            let answer = deliver(&link, delivery).await;
            let _ = events.send(Event::Delivered { slot, answer }).await;
        });
    }

    fn delivered(&mut self, slot: usize, answer: Answer) {
        self.slots[slot].state.work = Work::Nothing;
        answer.tell();
        if let Some(reason) = answer.stop_leasing() {
            self.stop(SuperviseError::Stopped(reason));
        }
    }

    fn send_heartbeat(&mut self) {
        if self.heartbeat_under_way || !self.is_registered {
            return;
        }
        self.heartbeat_under_way = true;
        let held: Vec<_> = self
            .slots
            .iter()
            .filter_map(|it| it.state.progress())
            .collect();
        let progress = held.iter().map(|(lease, control_steps)| Progress {
            job_id: lease.job.0,
            attempt: lease.attempt.0,
            control_steps: *control_steps,
        });
        let request = HeartbeatRequest {
            worker_id: self.config.identity.worker.to_string(),
            progress: progress.collect(),
        };
        let sent = held.into_iter().map(|(lease, _)| lease).collect();
        let (link, events) = (self.link.clone(), self.events.clone());
        let deadline = self.timing.heartbeat.max(Duration::from_secs(1));
        self.calls.spawn(async move {
            let answer = link.heartbeat(request, deadline).await;
            let _ = events.send(Event::Renewed { sent, answer }).await;
        });
    }

    fn renewed(
        &mut self,
        sent: &[LeaseKey],
        answer: Result<HeartbeatResponse, Status>,
        now: Instant,
    ) {
        self.heartbeat_under_way = false;
        // A failure is told by the link, and the next heartbeat is soon.
        let Ok(answer) = answer else { return };
        for lease in sent
            .iter()
            .filter(|it| answer.lost_jobs.contains(&it.job.0))
        {
            self.let_go(*lease, now);
        }
    }

    /// Abandons the rollout of a lost lease, if it is still being simulated.
    fn let_go(&mut self, lost: LeaseKey, now: Instant) {
        let held = |slot: &&mut Slot| matches!(slot.state.work, Work::Running { lease, .. } if lease == lost);
        let Some(slot) = self.slots.iter_mut().find(held) else {
            return;
        };
        if let Some(process) = &slot.process {
            process.order(Order::Abandon);
        }
        slot.state.work = Work::Abandoning {
            deadline: now + ABANDON_DEADLINE,
        };
        let session = slot.assignment.as_ref().map(|it| it.session.as_str());
        tracing::warn!(
            "the lease of {} was lost; it is abandoned",
            session.unwrap_or_default()
        );
    }

    /// Takes on no more work because of a fault.
    fn stop(&mut self, fault: SuperviseError) {
        if self.mode == Mode::Serving {
            self.start_to_drain();
            self.fault = Some(fault);
        }
    }

    fn start_to_drain(&mut self) {
        self.mode = Mode::Draining;
        self.drain.send_replace(true);
    }

    fn shut_down(&mut self, now: Instant) {
        if self.mode == Mode::Serving {
            self.start_to_drain();
            self.told_to_end_at = Some(now);
            let running = self.slots.iter().filter_map(|it| it.state.progress());
            tracing::info!(
                "draining: {} rollouts in hand are finished; ask again to give them back instead",
                running.count()
            );
        } else if self.mode == Mode::Draining && self.means_it(now) {
            self.mode = Mode::Abandoning {
                until: now + GIVE_BACK_DEADLINE,
            };
            tracing::info!("giving the rollouts in hand back");
            for slot in 0..self.slots.len() {
                self.give_back(slot);
            }
        }
    }

    /// Whether a request to end is not an echo of the one before: some that
    /// end programs signal the process and its group.
    fn means_it(&self, now: Instant) -> bool {
        self.told_to_end_at
            .is_none_or(|first| now.duration_since(first) >= ECHO)
    }

    fn give_back(&mut self, slot: usize) {
        let state = &mut self.slots[slot].state;
        let (Work::Running { lease, .. } | Work::Stuck { lease, .. }) = state.work else {
            return;
        };
        state.work = Work::Delivering {
            lease,
            control_steps: 0,
        };
        state.process = ProcessState::Dying;
        if let Some(process) = &self.slots[slot].process {
            process.kill();
        }
        let error = "finish the rollout: the worker was told to end at once".to_owned();
        let kind = FailureKind::Draining;
        let session = self.session(slot);
        self.send_delivery(
            slot,
            lease,
            session,
            Ending::Failed(Failure { kind, error }),
        );
    }
}
