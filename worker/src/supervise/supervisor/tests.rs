use transport::Access;

use super::*;
use crate::child::SlotProgram;
use crate::ids::WorkerId;
use crate::supervise::config::Identity;

/// Returns a supervisor with one slot, whose process waits for its parent to end, and an
/// unreachable coordinator.
fn supervisor(events: mpsc::Sender<Event>) -> Supervisor {
    supervisor_with(1, events)
}

fn supervisor_with(slots: usize, events: mpsc::Sender<Event>) -> Supervisor {
    let config = Config {
        coordinator: "http://127.0.0.1:9".to_owned(),
        access: Access::none(),
        identity: Identity {
            worker: WorkerId::new("test", 1),
            host: "test".to_owned(),
            machine: String::new(),
            asset_pack: String::new(),
            asset_pack_digest: String::new(),
            mujoco_version: String::new(),
            look: benchmark::Look::default(),
        },
        slots,
        slot_program: SlotProgram { program: "cat".into(), arguments: Vec::new() },
        provider: None,
        lacking_tasks: Vec::new(),
        simulators: Vec::new(),
        policy_endpoint: None,
        drain: None,
        idle: None,
        scratch: std::env::temp_dir(),
        seed: 1,
    };
    let (drain, draining) = watch::channel(false);
    let link = Link::new(&config.coordinator, &config.access, 1, draining);
    let link = link.expect("a URL");
    Supervisor::new(config, link, drain, events, Instant::now())
}

#[tokio::test]
async fn a_panic_of_a_call_ends_the_worker_with_an_error() {
    let (events, inbox) = mpsc::channel(8);
    let mut supervisor = supervisor(events);
    // Without the panic's detection, the delivery would never happen and its lease would be
    // renewed for ever.
    supervisor.calls.spawn(async { panic!("a defect") });
    let (_requests, shutdown) = mpsc::channel(1);
    let serving = supervisor.serve(inbox, shutdown);
    let ended = tokio::time::timeout(Duration::from_secs(20), serving).await;
    let error = ended.expect("an end in time").expect_err("a fault");
    assert!(error.to_string().contains("a defect"), "{error}");
}

#[tokio::test]
async fn a_shutdown_request_is_handled_while_slots_start() {
    let (events, _inbox) = mpsc::channel(8);
    let mut supervisor = supervisor_with(3 * STARTS_AT_ONCE, events);
    let now = Instant::now();
    assert!(supervisor.carry_out_decisions(now), "further processes are to be started");
    let is_started = |slot: &&Slot| slot.process.is_some();
    let started = |parent: &Supervisor| parent.slots.iter().filter(is_started).count();
    assert_eq!(started(&supervisor), STARTS_AT_ONCE);
    supervisor.handle(Event::Shutdown, now);
    assert!(!supervisor.carry_out_decisions(now));
    assert_eq!(started(&supervisor), STARTS_AT_ONCE, "no further process");
}

#[tokio::test]
async fn exhausted_resources_end_the_worker_at_once() {
    let (events, _inbox) = mpsc::channel(8);
    let mut supervisor = supervisor_with(1_000, events);
    let now = Instant::now();
    supervisor.slots[7].starts = 1;
    let too_many_files = rustix::io::Errno::MFILE;
    supervisor.start_failed(7, too_many_files.into(), now);
    assert!(!supervisor.carry_out_decisions(now), "no further process may start");
    assert_eq!(supervisor.mode, Mode::Draining);
    let fault = supervisor.fault.expect("a fault").to_string();
    assert!(fault.contains("slot 7"), "{fault}");
}

#[tokio::test]
async fn a_panic_of_a_slots_task_ends_its_process() {
    let (events, mut inbox) = mpsc::channel(8);
    let mut supervisor = supervisor(events);
    let now = Instant::now();
    supervisor.start_process(0, now);
    let attempt = AttemptId::from_random([1; 16]);
    supervisor.slots[0].state.process = ProcessState::Up;
    supervisor.slots[0].state.work =
        Work::Running { attempt, control_steps: 0, progressed_at: now };
    let task = supervisor.processes.spawn(async { panic!("a defect") });
    let process = supervisor.slots[0].process.as_mut().expect("started");
    process.task = task.id();
    let ended = supervisor.processes.join_next().await.expect("a task");
    let event = panicked(ended).expect("an event");
    supervisor.handle(event, now);
    let state = &supervisor.slots[0].state;
    assert!(matches!(state.work, Work::Delivering { attempt: id, .. } if id == attempt));
    assert!(matches!(state.process, ProcessState::Down { .. }));
    assert_eq!(supervisor.mode, Mode::Serving, "the worker keeps serving");
    assert!(inbox.try_recv().is_err());
}
