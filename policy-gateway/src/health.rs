//! Circuit breaker of a policy server. While the server is *out* (the breaker is open), calls fail
//! at once, except those of one probing session at a time and a Describe when a probe is due. Pure:
//! callers pass in the time. The replica classifies the failures.
//!
//! A server that did not answer in time, is broken or repeats an error counts as recovered only
//! after an answered query, since Describe and Reset often keep working when the server's
//! accelerator does not; one that repeats an error also after a different error. A server that is
//! out for any other reason counts as recovered after any answer.

use std::time::{Duration, Instant};

use benchmark::attempt::Waits;
use policy_backends::Cause;
use policy_backends::shorten::shorten;

/// Waits between probes of a server that could not be reached. A recovered server is in use again
/// within the longest wait.
pub const WAITS: Waits =
    Waits { first: Duration::from_millis(100), longest: Duration::from_secs(5) };
/// Waits between probes of a server that is out for any other reason.
pub const BROKEN_WAITS: Waits = Waits::USUAL;
/// Longest time for a probing session to produce an answer before another session may probe.
pub const PROBE_TIMEOUT: Duration = Duration::from_secs(60);
/// Number of tasks that must receive the same error, with no answered query in between, before the
/// server counts as broken. A task may cause an error itself, so its retries count once.
pub const SAME_ERROR_TASKS: usize = 3;
/// Number of leading characters of two errors that are compared.
const COMPARED_CHARS: usize = 160;
/// Phrases in accelerator errors that only a restart cures: from CUDA, cuBLAS, cuDNN, HIP and
/// PyTorch.
const FATAL_PHRASES: [&str; 8] = [
    "cuda error",
    "cuda runtime error",
    "cublas_status",
    "cudnn_status",
    "hip error",
    "device-side assert",
    "illegal memory access",
    "out of memory",
];

/// Call that is about to be sent to a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Call<'a> {
    Describe,
    InSession(&'a str),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answered {
    /// Any answer except actions.
    Other,
    Query,
}

/// Last known state of a server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Health {
    /// Calls are sent to the server.
    Up(Errors),
    /// Only probes are sent to the server.
    Out(Outage),
}

/// Most recent error of a server, and the tasks that received it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Errors {
    comparable_text: String,
    tasks: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outage {
    /// Reason why the server is out.
    pub cause: Cause,
    /// Number of consecutive failures with the same kind of wait: the failure that began the
    /// outage, and the failures of probes.
    failures: u32,
    /// Earliest time of the next probe.
    probe_at: Instant,
    probe: Option<Probe>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Probe {
    /// Session of the probe; `None` for a description, which is a single call.
    session: Option<String>,
    /// Time from which another session may probe.
    until: Instant,
}

impl Default for Health {
    fn default() -> Self {
        Self::Up(Errors::default())
    }
}

impl Health {
    /// Decides whether a call may be sent at `now`. The error is the reason and the time left to
    /// wait.
    pub fn admit(&mut self, call: Call<'_>, now: Instant) -> Result<(), (Cause, Duration)> {
        let Self::Out(outage) = self else {
            return Ok(());
        };
        let probe = outage.probe.as_ref().filter(|probe| now < probe.until);
        match (probe, call) {
            (Some(probe), Call::InSession(session))
                if probe.session.as_deref() == Some(session) =>
            {
                Ok(())
            }
            (Some(probe), _) => Err((outage.cause.clone(), probe.until - now)),
            (None, _) if now < outage.probe_at => {
                Err((outage.cause.clone(), outage.probe_at - now))
            }
            // A Describe does not show whether queries are answered, so it is not the probe.
            (None, Call::Describe) if outage.cause.needs_query() => Ok(()),
            (None, call) => {
                let session = match call {
                    Call::Describe => None,
                    Call::InSession(session) => Some(session.to_owned()),
                };
                let until = now + PROBE_TIMEOUT;
                outage.probe = Some(Probe { session, until });
                Ok(())
            }
        }
    }

    /// Records that the caller gave up before the call showed the state of the server. If the call
    /// was the probe, the next call may probe at once.
    pub fn abandoned(&mut self, call: Call<'_>) {
        let session = match call {
            Call::Describe => None,
            Call::InSession(session) => Some(session),
        };
        if let Self::Out(outage) = self {
            let probe = outage.probe.take();
            outage.probe = probe.filter(|probe| probe.session.as_deref() != session);
        }
    }

    /// Records an answer. Returns true if it shows that the server has recovered from an outage.
    pub fn answered(&mut self, answered: Answered) -> bool {
        match (&*self, answered) {
            (Self::Up(_), Answered::Other) => false,
            (Self::Out(outage), Answered::Other) if outage.cause.needs_query() => false,
            (state, _) => {
                let has_recovered = matches!(state, Self::Out(_));
                *self = Self::default();
                has_recovered
            }
        }
    }

    /// Records at `now` that the server gave no usable answer. Returns true if the server was up
    /// before.
    ///
    /// Queries in flight at the time of a failure fail together, so only a probe's failure
    /// lengthens the wait.
    pub fn failed(&mut self, cause: Cause, now: Instant) -> bool {
        let (failures, was_up) = match self {
            Self::Up(_) => (1, true),
            Self::Out(Outage { probe: None, .. }) => return false,
            // A failure with another kind of wait restarts the count.
            Self::Out(outage) if waits(&outage.cause) != waits(&cause) => (1, false),
            Self::Out(outage) => (outage.failures.saturating_add(1), false),
        };
        *self = Self::Out(Outage {
            // Jitter is unnecessary, because sessions arrive at random.
            probe_at: now + waits(&cause).after(failures, 0),
            cause,
            failures,
            probe: None,
        });
        was_up
    }

    /// Records at `now` the server's error to a query of `task`. Returns the reason if the server
    /// is out of service after this error, in which case the error is the server's fault and not
    /// the task's.
    pub fn erred(&mut self, error: &str, task: &str, now: Instant) -> Option<Cause> {
        if is_fatal(error) {
            let cause = Cause::Broken(shorten(error));
            self.failed(cause.clone(), now);
            return Some(cause);
        }
        let comparable_text = comparable(&shorten(error));
        match self {
            Self::Up(errors) => {
                if errors.comparable_text != comparable_text {
                    let tasks = vec![];
                    *errors = Errors { comparable_text, tasks };
                }
                if !errors.tasks.iter().any(|listed| listed == task) {
                    errors.tasks.push(task.to_owned());
                }
                if errors.tasks.len() < SAME_ERROR_TASKS {
                    return None;
                }
                let cause = Cause::RepeatedError(shorten(error));
                self.failed(cause.clone(), now);
                Some(cause)
            }
            Self::Out(Outage { cause: Cause::RepeatedError(earlier_error), .. })
                if comparable(earlier_error) != comparable_text =>
            {
                // A different error shows that the server works again.
                let tasks = vec![task.to_owned()];
                *self = Self::Up(Errors { comparable_text, tasks });
                None
            }
            Self::Out(outage) => {
                let cause = outage.cause.clone();
                self.failed(cause.clone(), now);
                Some(cause)
            }
        }
    }
}

fn waits(cause: &Cause) -> Waits {
    match cause {
        Cause::Unreachable(_) => WAITS,
        _ => BROKEN_WAITS,
    }
}

fn is_fatal(error: &str) -> bool {
    let error = error.to_lowercase();
    FATAL_PHRASES.iter().any(|words| error.contains(words))
}

/// Replaces the digits of an error, which often belong to a session or query, and truncates it.
fn comparable(error: &str) -> String {
    let masked = |c: char| if c.is_ascii_digit() { '#' } else { c };
    error.chars().map(masked).take(COMPARED_CHARS).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SESSIONS: [&str; 3] = ["a", "b", "c"];

    #[derive(Clone, Debug)]
    enum Event {
        Admit(Option<usize>),
        Answered(Answered),
        Failed(Cause),
        Abandoned(Option<usize>),
        Erred(&'static str, usize),
        Pass(u64),
    }

    fn unreachable() -> Cause {
        Cause::Unreachable("nothing listens there".to_owned())
    }

    fn event() -> impl Strategy<Value = Event> {
        let cause = prop_oneof![
            Just(unreachable()),
            Just(Cause::NoAnswer),
            Just(Cause::DescriptionDiffers("digest".to_owned())),
        ];
        prop_oneof![
            prop::option::of(0..SESSIONS.len()).prop_map(Event::Admit),
            prop_oneof![Just(Answered::Other), Just(Answered::Query)].prop_map(Event::Answered),
            cause.prop_map(Event::Failed),
            prop::option::of(0..SESSIONS.len()).prop_map(Event::Abandoned),
            (
                prop_oneof![Just("ValueError: 1"), Just("KeyError"), Just("CUDA error: assert")],
                0..4_usize
            )
                .prop_map(|(error, task)| Event::Erred(error, task)),
            (0..90_000_u64).prop_map(Event::Pass),
        ]
    }

    fn call(session: Option<usize>) -> Call<'static> {
        session.map_or(Call::Describe, |index| Call::InSession(SESSIONS[index]))
    }

    fn apply(health: &mut Health, event: &Event, now: &mut Instant) {
        match event {
            Event::Admit(session) => drop(health.admit(call(*session), *now)),
            Event::Answered(answered) => drop(health.answered(*answered)),
            Event::Failed(cause) => drop(health.failed(cause.clone(), *now)),
            Event::Abandoned(session) => health.abandoned(call(*session)),
            Event::Erred(error, task) => drop(health.erred(error, &task.to_string(), *now)),
            Event::Pass(millis) => *now += Duration::from_millis(*millis),
        }
    }

    proptest! {
        #[test]
        fn after_any_events_a_probe_is_admitted_and_one_answered_query_ends_the_outage(
            events in prop::collection::vec(event(), 0..60),
        ) {
            let (mut health, mut now) = (Health::default(), Instant::now());
            for event in &events {
                apply(&mut health, event, &mut now);
            }
            now += BROKEN_WAITS.longest + PROBE_TIMEOUT;
            prop_assert!(health.admit(Call::InSession("new"), now).is_ok());
            health.answered(Answered::Query);
            prop_assert_eq!(health, Health::default());
        }

        #[test]
        fn an_outage_admits_one_session_at_a_time(
            events in prop::collection::vec(event(), 0..60),
        ) {
            let (mut health, mut now) = (Health::default(), Instant::now());
            for event in &events {
                apply(&mut health, event, &mut now);
                let Health::Out(_) = &health else { continue };
                let mut probed = health.clone();
                let admitted = SESSIONS
                    .iter()
                    .filter(|id| probed.admit(Call::InSession(id), now).is_ok());
                prop_assert!(admitted.count() <= 1);
            }
        }

        #[test]
        fn a_failure_is_followed_by_a_wait_within_its_bounds(
            events in prop::collection::vec(event(), 0..60),
            cause in prop_oneof![Just(unreachable()), Just(Cause::NoAnswer)],
        ) {
            let (mut health, mut now) = (Health::default(), Instant::now());
            for event in &events {
                apply(&mut health, event, &mut now);
            }
            now += BROKEN_WAITS.longest + PROBE_TIMEOUT;
            prop_assert!(health.admit(Call::InSession("probe"), now).is_ok());
            health.failed(cause.clone(), now);
            let refusal = health.admit(Call::InSession("probe"), now);
            let (refused, wait) = refusal.expect_err("a wait");
            let Waits { first, longest } = waits(&cause);
            prop_assert_eq!(refused, cause);
            prop_assert!((first..=longest).contains(&wait), "{:?}", wait);
        }

        #[test]
        fn a_description_does_not_end_an_outage_that_needs_an_answered_query(
            events in prop::collection::vec(event(), 0..60),
        ) {
            let (mut health, mut now) = (Health::default(), Instant::now());
            for event in &events {
                apply(&mut health, event, &mut now);
                if matches!(&health, Health::Out(outage) if outage.cause.needs_query()) {
                    prop_assert!(!health.answered(Answered::Other));
                    prop_assert!(matches!(health, Health::Out(_)));
                }
            }
        }
    }

    #[test]
    fn the_cause_of_a_long_error_is_one_short_line() {
        let now = Instant::now();
        let error = format!("{}\n2026-01-01 INFO all is well", "x\n".repeat(1 << 19));
        let mut health = Health::default();
        let causes: Vec<_> = ["a", "b", "c"]
            .into_iter()
            .filter_map(|task| health.erred(&error, task, now))
            .collect();
        let broken = Health::default().erred(&format!("CUDA error\n{error}"), "a", now);
        let causes: Vec<_> = causes.into_iter().chain(broken).collect();
        assert_eq!(causes.len(), 2);
        for cause in causes {
            let text = cause.to_string();
            assert!(text.len() < 5_000 && !text.contains('\n'), "{text}");
        }
    }

    #[test]
    fn waits_double_up_to_the_longest_and_late_failures_do_not_count() {
        let mut health = Health::default();
        let mut now = Instant::now();
        let mut waits = Vec::new();
        for _ in 0..8 {
            health.failed(unreachable(), now);
            // Fails a query that was in flight when the connection broke.
            health.failed(unreachable(), now);
            let (_, wait) = health.admit(Call::Describe, now).expect_err("a wait");
            waits.push(wait.as_millis());
            now += wait;
            assert_eq!(health.admit(Call::Describe, now), Ok(()));
        }
        assert_eq!(waits, [100, 200, 400, 800, 1600, 3200, 5000, 5000]);
    }

    #[test]
    fn only_an_abandoned_probe_admits_the_next_call() {
        let mut health = Health::default();
        let mut now = Instant::now();
        health.failed(Cause::NoAnswer, now);
        let (_, wait) = health.admit(Call::InSession("a"), now).expect_err("a wait");
        now += wait;
        assert_eq!(health.admit(Call::InSession("a"), now), Ok(()));
        health.abandoned(Call::InSession("b"));
        health.abandoned(Call::Describe);
        assert!(health.admit(Call::InSession("b"), now).is_err());
        health.abandoned(Call::InSession("a"));
        assert_eq!(health.admit(Call::InSession("b"), now), Ok(()));
    }

    #[test]
    fn the_same_error_counts_once_per_task_whatever_its_numbers() {
        let (mut health, now) = (Health::default(), Instant::now());
        let mut err = |error: &str, task: &str| health.erred(error, task, now).is_some();
        assert!(!err("ValueError: session 1", "butter"));
        assert!(!err("ValueError: session 2", "butter"));
        assert!(!err("ValueError: session 3", "milk"));
        assert!(!err("KeyError", "bowl"));
        assert!(!err("ValueError: session 4", "butter"));
        assert!(!err("ValueError: session 5", "milk"));
        assert!(err("ValueError: session 6", "bowl"));
    }

    #[test]
    fn an_answered_query_restarts_the_count_of_equal_errors() {
        let (mut health, now) = (Health::default(), Instant::now());
        for task in ["butter", "milk", "bowl", "plate"] {
            assert_eq!(health.erred("ValueError", task, now), None);
            health.answered(Answered::Query);
        }
    }
}
