//! Instants, and the injected clock, through which alone this crate reads the time.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde::Deserialize;

/// An instant: milliseconds since the Unix epoch, UTC.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Deserialize,
    sqlx_macros::Type,
)]
#[sqlx(transparent)]
pub struct UnixMillis(pub i64);

/// Source of the current time, which never goes backwards.
pub trait Clock: Send + Sync {
    fn now(&self) -> UnixMillis;
}

/// Wall clock read once at startup, advanced by the monotonic clock from then on. Leases keep their
/// length when the wall clock is changed; displayed instants pick up the change at the next start.
#[derive(Clone, Copy, Debug)]
pub struct SystemClock {
    started: UnixMillis,
    running: Instant,
}

/// Another clock, ahead of it by a constant span.
struct Ahead {
    clock: Arc<dyn Clock>,
    span: Duration,
}

/// A clock that changes only by [`ManualClock::advance`]: for tests, and for replaying a recorded
/// sequence of events.
#[derive(Debug, Default)]
pub struct ManualClock(AtomicI64);

impl UnixMillis {
    /// Returns the instant `span` later.
    #[must_use]
    pub fn plus(self, span: Duration) -> UnixMillis {
        UnixMillis(self.0.saturating_add(millis(span)))
    }

    /// Returns the instant `span` earlier.
    #[must_use]
    pub fn minus(self, span: Duration) -> UnixMillis {
        UnixMillis(self.0.saturating_sub(millis(span)))
    }

    /// Returns the time elapsed since `earlier`; zero if `earlier` is in the future.
    pub fn since(self, earlier: UnixMillis) -> Duration {
        Duration::from_millis(u64::try_from(self.0.saturating_sub(earlier.0)).unwrap_or(0))
    }
}

impl SystemClock {
    /// Creates a clock that starts at the current wall-clock time.
    #[allow(
        clippy::disallowed_methods,
        reason = "the one place where the machine's clocks are read"
    )]
    pub fn start() -> SystemClock {
        let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        SystemClock { started: UnixMillis(millis(since_epoch)), running: Instant::now() }
    }
}

impl Clock for SystemClock {
    fn now(&self) -> UnixMillis {
        self.started.plus(self.running.elapsed())
    }
}

impl Clock for Ahead {
    fn now(&self) -> UnixMillis {
        self.clock.now().plus(self.span)
    }
}

/// Returns a clock that begins at `newest`, the newest stored instant, or now if that is later, so
/// that stored instants lie in the past and none needs to be altered.
pub(crate) fn beginning_at(newest: UnixMillis, clock: Arc<dyn Clock>) -> Arc<dyn Clock> {
    let span = newest.since(clock.now());
    if span.is_zero() {
        return clock;
    }
    if let seconds @ 1.. = span.as_secs() {
        tracing::warn!(
            "the machine's clock is {seconds} s behind the newest time in the data folder, at \
             which the coordinator's clock begins: one of them is wrong; if it is the machine's, \
             set it right and start the coordinator again"
        );
    }
    Arc::new(Ahead { clock, span })
}

impl ManualClock {
    /// Creates a clock set to `now`.
    pub fn at(now: UnixMillis) -> ManualClock {
        ManualClock(AtomicI64::new(now.0))
    }

    pub fn advance(&self, span: Duration) {
        self.0.fetch_add(millis(span), Ordering::SeqCst);
    }
}

impl Clock for ManualClock {
    fn now(&self) -> UnixMillis {
        UnixMillis(self.0.load(Ordering::SeqCst))
    }
}

fn millis(span: Duration) -> i64 {
    i64::try_from(span.as_millis()).unwrap_or(i64::MAX)
}
