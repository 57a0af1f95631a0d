//! Rate limit per connection: a token bucket that refills over time. This module reads no clock;
//! its caller `gate` passes the current time.

use std::collections::HashMap;
use std::net::SocketAddr;

use tokio::time::Instant;

/// Sustained requests per second of one connection: far more than a worker with a hundred slots
/// sends, and far less than would starve other connections.
pub const MAX_REQUESTS_PER_SEC: f64 = 10_000.0;
/// Requests that one connection may send at once after a pause.
pub const BURST_REQUESTS: f64 = 20_000.0;
/// Maximum number of buckets. At this number full buckets are dropped, since a new bucket is full,
/// too; if no bucket is full, the requests of further connections are refused.
const MAX_BUCKETS: usize = 8_192;

/// The buckets of all connections.
#[derive(Debug, Default)]
pub(crate) struct Rates {
    buckets: HashMap<SocketAddr, Bucket>,
}

#[derive(Clone, Copy, Debug)]
struct Bucket {
    remaining: f64,
    updated: Instant,
}

impl Bucket {
    fn filled(self, now: Instant) -> f64 {
        let secs = now.saturating_duration_since(self.updated).as_secs_f64();
        (self.remaining + secs * MAX_REQUESTS_PER_SEC).min(BURST_REQUESTS)
    }
}

impl Rates {
    /// Counts a request; returns false if the connection is over its limit.
    pub(crate) fn admit(&mut self, caller: SocketAddr, now: Instant) -> bool {
        if self.buckets.len() >= MAX_BUCKETS && !self.buckets.contains_key(&caller) {
            self.buckets.retain(|_, bucket| bucket.filled(now) < BURST_REQUESTS);
            if self.buckets.len() >= MAX_BUCKETS {
                return false;
            }
        }
        let bucket = self
            .buckets
            .entry(caller)
            .or_insert(Bucket { remaining: BURST_REQUESTS, updated: now });
        let remaining = bucket.filled(now);
        let is_admitted = remaining >= 1.0;
        *bucket = Bucket {
            remaining: if is_admitted { remaining - 1.0 } else { remaining },
            updated: now,
        };
        is_admitted
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;
    use std::time::Duration;

    use super::*;

    fn caller(port: u16) -> SocketAddr {
        (Ipv4Addr::LOCALHOST, port).into()
    }

    #[test]
    fn after_a_burst_requests_are_limited_to_the_rate() {
        let mut rates = Rates::default();
        let start = Instant::now();
        let burst = BURST_REQUESTS as usize;
        assert!((0..burst).all(|_| rates.admit(caller(1), start)));
        assert!(!rates.admit(caller(1), start));
        assert!(rates.admit(caller(2), start), "other connections are not limited");
        let later = start + Duration::from_millis(100);
        let admitted = (0..burst).filter(|_| rates.admit(caller(1), later)).count();
        assert_eq!(admitted, 1_000);
    }

    #[test]
    fn buckets_are_bounded() {
        let mut rates = Rates::default();
        let start = Instant::now();
        let ports = 0..MAX_BUCKETS as u16;
        assert!(ports.clone().all(|port| rates.admit(caller(port), start)));
        assert!(!rates.admit(caller(u16::MAX), start));
        let later = start + Duration::from_secs(1);
        assert!(rates.admit(caller(u16::MAX), later));
        assert_eq!(rates.buckets.len(), 1);
    }
}
