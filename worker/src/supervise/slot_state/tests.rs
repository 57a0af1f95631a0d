use proptest::prelude::*;

use super::*;

const TIMEOUT: Duration = Duration::from_secs(180);

fn attempt(number: u8) -> AttemptId {
    AttemptId::from_random([number; 16])
}

fn running(now: Instant) -> SlotState {
    let mut slot = SlotState::new(now, 1);
    slot.process = ProcessState::Up;
    slot.work = Work::Running { attempt: attempt(1), control_steps: 0, progressed_at: now };
    slot
}

/// Returns a slot whose result is being delivered while its video is made.
fn filming(now: Instant) -> SlotState {
    let mut slot = running(now);
    assert!(slot.rollout_ended(attempt(1), true, now));
    slot
}

fn secs(secs: u64) -> Duration {
    Duration::from_secs(secs)
}

fn lost(kind: FailureKind) -> Loss {
    Loss { rollout: Some((attempt(1), kind)), video: None }
}

#[test]
fn a_rollout_without_progress_is_killed_and_reported_as_stuck() {
    let now = Instant::now();
    let mut slot = running(now);
    slot.advanced(attempt(1), 10, now + secs(100));
    let decide = |slot: &SlotState, at| slot.decide(Mode::Serving, TIMEOUT, now + secs(at));
    assert_eq!(decide(&slot, 279), None);
    // A repeated report of the same step is no progress.
    slot.advanced(attempt(1), 10, now + secs(200));
    assert_eq!(decide(&slot, 280), Some(Decision::Kill(Kill::Stuck)));
    slot.killed(Kill::Stuck);
    assert_eq!(decide(&slot, 281), None);
    let ended = slot.ended(now + secs(281));
    assert_eq!(ended, lost(FailureKind::SlotStuck));
    assert_eq!(slot.progress(), Some((attempt(1), 10)));
}

#[test]
fn a_crash_costs_only_the_running_rollout() {
    let now = Instant::now();
    let mut slot = running(now);
    assert_eq!(slot.ended(now), lost(FailureKind::SlotCrashed));
    // Until the report is delivered, nothing is started or claimed.
    assert_eq!(slot.decide(Mode::Serving, TIMEOUT, now + secs(60)), None);
    assert_eq!(slot.delivered(false), None);
    assert_eq!(slot.decide(Mode::Serving, TIMEOUT, now), None);
    let later = now + secs(1);
    assert_eq!(slot.decide(Mode::Serving, TIMEOUT, later), Some(Decision::Start));
    assert_eq!(slot.ended(later), Loss::default());
}

#[test]
fn filming_advances_the_video_and_never_the_rollouts_steps() {
    let now = Instant::now();
    let mut slot = running(now);
    slot.advanced(attempt(1), 290, now);
    slot.filming_advanced(attempt(1), 300, now);
    assert_eq!(slot.progress(), Some((attempt(1), 290)), "no video is being made");
    assert!(slot.rollout_ended(attempt(1), true, now));
    slot.filming_advanced(attempt(1), 300, now);
    slot.advanced(attempt(1), 570, now);
    assert_eq!(slot.progress(), Some((attempt(1), 290)));
    let Video::Filming { pictures, .. } = slot.video else { panic!("{:?}", slot.video) };
    assert_eq!(pictures, 300);
}

#[test]
fn filming_without_progress_is_killed_in_any_state_of_its_result() {
    let now = Instant::now();
    let mut slot = filming(now);
    let kill = Some(Decision::Kill(Kill::StuckFilming));
    slot.filming_advanced(attempt(1), 10, now + secs(1));
    assert_eq!(slot.decide(Mode::Serving, TIMEOUT, now + TIMEOUT), None);
    let late = now + TIMEOUT + secs(1);
    assert_eq!(slot.decide(Mode::Draining, TIMEOUT, late), kill);
    slot.delivered(true);
    assert!(!slot.is_done());
    assert_eq!(slot.decide(Mode::Serving, TIMEOUT, late), kill);
}

#[test]
fn a_video_is_sent_after_filming_and_commit_in_either_order() {
    let now = Instant::now();
    let upload = Some(VideoDecision::Upload(attempt(1)));
    let mut slot = filming(now);
    assert_eq!(slot.filming_ended(attempt(1), true), None);
    assert_eq!(slot.delivered(true), upload);
    let mut slot = filming(now);
    assert_eq!(slot.delivered(true), None);
    assert_eq!(slot.decide(Mode::Serving, TIMEOUT, now), None);
    assert_eq!(slot.filming_ended(attempt(1), true), upload);
    let claim = Some(Decision::Claim);
    assert_eq!(slot.decide(Mode::Serving, TIMEOUT, now), claim);
}

#[test]
fn a_video_of_a_refused_result_is_dropped() {
    let now = Instant::now();
    let dropped = Some(VideoDecision::Drop(attempt(1)));
    let mut slot = filming(now);
    assert_eq!(slot.filming_ended(attempt(1), true), None);
    assert_eq!(slot.delivered(false), dropped);
    let mut slot = filming(now);
    let abandon = Some(VideoDecision::Abandon(attempt(1)));
    assert_eq!(slot.delivered(false), abandon);
    assert_eq!(slot.filming_ended(attempt(1), true), dropped);
}

#[test]
fn a_rollout_whose_lease_is_lost_is_abandoned_without_a_report() {
    let now = Instant::now();
    let mut slot = running(now);
    slot.work = Work::Abandoning { attempt: attempt(1), deadline: now + ABANDON_DEADLINE };
    assert_eq!(slot.progress(), None);
    let late = slot.decide(Mode::Serving, TIMEOUT, now + ABANDON_DEADLINE);
    assert_eq!(late, Some(Decision::Kill(Kill::NotAbandoned)));
    assert!(!slot.rollout_ended(attempt(1), false, now));
    assert!(slot.is_done());
}

#[test]
fn repeated_failed_starts_give_up_the_slot() {
    let now = Instant::now();
    let mut slot = SlotState::new(now, 1);
    for _ in 0..MAX_FAILED_STARTS {
        assert!(!slot.cannot_start());
        let deadline = now + START_DEADLINE;
        slot.process = ProcessState::Starting { deadline };
        let late = slot.decide(Mode::Serving, TIMEOUT, deadline);
        assert_eq!(late, Some(Decision::Kill(Kill::NotReady)));
        slot.killed(Kill::NotReady);
        assert_eq!(slot.ended(now), Loss::default());
    }
    assert!(slot.cannot_start());
}

proptest! {
    /// Invariants under any sequence of events: a draining worker neither starts nor claims,
    /// no attempt is forgotten before its report is delivered, each report is delivered once,
    /// and a video is sent at most once, after its result was committed.
    #[test]
    fn a_draining_worker_claims_nothing_and_reports_every_attempt(
        events in proptest::collection::vec(0..10_u8, 0..40),
        is_filmed: bool,
        is_committed: bool,
    ) {
        let start = Instant::now();
        let mut slot = running(start);
        let (mut deliveries, mut has_result, mut uploads) = (0, false, 0);
        let mut answered = false;
        for (index, event) in events.into_iter().enumerate() {
            let now = start + secs(30 * index as u64);
            let mut video = None;
            match event {
                0 => slot.became_ready(),
                1 => slot.advanced(attempt(1), index as u32, now),
                2 => deliveries += u32::from(slot.ended(now).rollout.is_some()),
                3 if slot.rollout_ended(attempt(1), is_filmed, now) => {
                    deliveries += 1;
                    has_result = true;
                }
                4 => video = slot.filming_ended(attempt(1), index % 2 == 0),
                5 if matches!(slot.work, Work::Delivering { .. }) => {
                    video = slot.delivered(has_result && is_committed);
                    answered = true;
                }
                6 => prop_assert!(!slot.rollout_ended(attempt(2), is_filmed, now)),
                7 => slot.filming_advanced(attempt(1), index as u32, now),
                _ => match slot.decide(Mode::Draining, TIMEOUT, now) {
                    Some(Decision::Kill(reason)) => slot.killed(reason),
                    Some(decision) => prop_assert!(false, "{decision:?}"),
                    None => {}
                },
            }
            uploads += u32::from(matches!(video, Some(VideoDecision::Upload(_))));
            prop_assert!(uploads <= u32::from(answered && has_result && is_committed));
            let renewed = slot.progress().map(|(attempt, _)| attempt);
            prop_assert_eq!(renewed, (!answered).then_some(attempt(1)));
            let delivering = matches!(slot.work, Work::Delivering { .. });
            prop_assert_eq!(deliveries, u32::from(delivering || answered));
        }
    }
}
