//! Instants, and the injected clock, through which alone this crate reads the time.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

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
    Serialize,
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
    #[must_use]
    pub fn plus(self, span: Duration) -> UnixMillis {
        UnixMillis(self.0.saturating_add(millis(span)))
    }

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

/// Instants in answers: RFC 3339 to the millisecond, `2026-11-21T15:36:09.123Z`. Instants after the
/// year 9999 are clamped to its last second, instants before 1970 to the first second of 1970.
pub(crate) mod rfc3339 {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};
    use time::{Date, Month, OffsetDateTime};

    use super::UnixMillis;

    pub(crate) fn serialize<S: Serializer>(at: &UnixMillis, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&text(*at))
    }

    fn text(at: UnixMillis) -> String {
        // 9999-12-31T23:59:59Z.
        const LAST_SECS: i64 = 253_402_300_799;
        let secs = at.0.div_euclid(1_000).clamp(0, LAST_SECS);
        let millis = at.0.rem_euclid(1_000);
        let instant = OffsetDateTime::from_unix_timestamp(secs);
        let instant = instant.unwrap_or(OffsetDateTime::UNIX_EPOCH);
        let (h, m, s) = instant.to_hms();
        format!("{}T{h:02}:{m:02}:{s:02}.{millis:03}Z", instant.date())
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<UnixMillis, D::Error> {
        let text = String::deserialize(from)?;
        let invalid = || {
            D::Error::custom(format!(
                "`{text}` is not an instant such as \
                                                   `2026-11-21T15:36:09.123Z`"
            ))
        };
        parse(&text).ok_or_else(invalid)
    }

    fn parse(text: &str) -> Option<UnixMillis> {
        let parts: Vec<u16> = text
            .strip_suffix('Z')?
            .split(['-', 'T', ':', '.'])
            .map(|part| part.parse().ok())
            .collect::<Option<_>>()?;
        let &[year, month, day, h, m, s, millis] = parts.as_slice() else { return None };
        let small = |part: u16| u8::try_from(part).ok();
        let month = Month::try_from(small(month)?).ok()?;
        let date = Date::from_calendar_date(year.into(), month, small(day)?).ok()?;
        let at = date.with_hms_milli(small(h)?, small(m)?, small(s)?, millis).ok()?.assume_utc();
        Some(UnixMillis(at.unix_timestamp() * 1_000 + i64::from(millis)))
    }

    #[test]
    fn instants_are_written_to_the_millisecond_and_read() {
        let text = |ms| text(UnixMillis(ms));
        for (ms, written) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (1_795_275_369_123, "2026-11-21T15:36:09.123Z"),
            (253_402_300_799_807, "9999-12-31T23:59:59.807Z"),
        ] {
            assert_eq!(text(ms), written);
            assert_eq!(parse(written), Some(UnixMillis(ms)));
        }
        assert_eq!(text(i64::MAX), text(253_402_300_799_807));
        for unreadable in ["", "2026-11-21", "2026-13-21T15:36:09.123Z", "2026-11-21T15:36:09Z"] {
            assert_eq!(parse(unreadable), None);
        }
    }
}
