//! When to try a policy server again that could not be reached. Pure: the time
//! is passed in. While it waits, queries fail at once instead of piling up
//! connection attempts, and one query at a time goes through as a probe.

use std::time::{Duration, Instant};

/// Wait after the first failure.
pub const FIRST_WAIT: Duration = Duration::from_millis(100);
/// Longest wait: a server that comes back is in use again within this time.
pub const LONGEST_WAIT: Duration = Duration::from_secs(5);

/// Whether a server was reachable when last tried.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backoff {
    /// Reachable, as far as known.
    #[default]
    Up,
    /// Not reachable.
    Down {
        /// How long the next failed probe waits.
        wait: Duration,
        /// When the next probe may go.
        probe_at: Instant,
        /// A probe is out. Queries that were on their way when the connection
        /// broke fail too, all at once; only a probe's failure lengthens the
        /// wait.
        probing: bool,
    },
}

impl Backoff {
    /// Whether a query may go out at `now`.
    ///
    /// # Errors
    /// With the time that is left to wait.
    pub fn admit(&mut self, now: Instant) -> Result<(), Duration> {
        match self {
            Self::Up => Ok(()),
            Self::Down { probe_at, .. } if now < *probe_at => Err(*probe_at - now),
            Self::Down {
                wait,
                probe_at,
                probing,
            } => {
                // A probe that never comes back must not be the last one.
                *probe_at = now + *wait;
                *probing = true;
                Ok(())
            }
        }
    }

    /// Notes that the server answered. True if it had been down.
    pub fn reached(&mut self) -> bool {
        std::mem::take(self) != Self::Up
    }

    /// Notes that the server could not be reached at `now`. True if it had
    /// been up.
    pub fn failed(&mut self, now: Instant) -> bool {
        let (wait, was_up) = match *self {
            Self::Up => (FIRST_WAIT, true),
            Self::Down { probing: false, .. } => return false,
            Self::Down { wait, .. } => (wait, false),
        };
        *self = Self::Down {
            wait: (wait * 2).min(LONGEST_WAIT),
            probe_at: now + wait,
            probing: false,
        };
        was_up
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_the_longest_and_end_with_the_first_answer() {
        let mut backoff = Backoff::default();
        let mut now = Instant::now();
        let mut waits = Vec::new();
        for _ in 0..8 {
            backoff.failed(now);
            // A query that was on its way when the connection broke.
            backoff.failed(now);
            let wait = backoff
                .admit(now)
                .expect_err("a failure is followed by a wait");
            waits.push(wait.as_millis());
            now += wait;
            assert_eq!(backoff.admit(now), Ok(()));
        }
        assert_eq!(waits, [100, 200, 400, 800, 1600, 3200, 5000, 5000]);

        assert!(backoff.reached());
        assert_eq!(backoff.admit(now), Ok(()));
        assert!(!backoff.reached());
    }

    #[test]
    fn one_query_at_a_time_probes_a_server_that_is_down() {
        let mut backoff = Backoff::default();
        let start = Instant::now();
        assert!(backoff.failed(start));
        let probe = start + FIRST_WAIT;
        assert_eq!(backoff.admit(probe), Ok(()));
        assert!(backoff.admit(probe).is_err());
        assert!(!backoff.failed(probe));
    }
}
