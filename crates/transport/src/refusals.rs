//! Log of refused callers. Each kind of refusal per machine is logged once per interval, so that a
//! caller that retries all night does not fill the disk.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::Duration;

use tokio::time::Instant;
use tonic::Code;

/// Interval after which a continuing refusal is logged again.
pub const LOG_AGAIN_AFTER: Duration = Duration::from_secs(600);
/// Most refusals in memory. Further refusals are not logged until one of these expires.
pub const MAX_REMEMBERED_REFUSALS: usize = 1_024;

#[derive(Debug, Default)]
pub(crate) struct Refusals {
    logged: HashMap<(IpAddr, Code), Instant>,
}

impl Refusals {
    /// Returns true if this refusal must be logged now.
    pub(crate) fn must_log(&mut self, caller: IpAddr, code: Code, now: Instant) -> bool {
        self.logged.retain(|_, at| now.saturating_duration_since(*at) < LOG_AGAIN_AFTER);
        let key = (caller, code);
        if self.logged.contains_key(&key) || self.logged.len() >= MAX_REMEMBERED_REFUSALS {
            return false;
        }
        self.logged.insert(key, now);
        true
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;

    #[test]
    fn a_refusal_is_logged_once_per_interval() {
        let mut refusals = Refusals::default();
        let start = Instant::now();
        let local = IpAddr::from(Ipv4Addr::LOCALHOST);
        assert!(refusals.must_log(local, Code::Unauthenticated, start));
        assert!(!refusals.must_log(local, Code::Unauthenticated, start));
        assert!(refusals.must_log(local, Code::InvalidArgument, start));
        let remote = IpAddr::from([10, 0, 0, 1]);
        assert!(refusals.must_log(remote, Code::Unauthenticated, start));
        let later = start + LOG_AGAIN_AFTER;
        assert!(refusals.must_log(local, Code::Unauthenticated, later));
        assert_eq!(refusals.logged.len(), 1);
    }

    #[test]
    fn remembered_refusals_are_bounded() {
        let mut refusals = Refusals::default();
        let now = Instant::now();
        let logged = (0..5_000_u32)
            .filter(|ip| refusals.must_log(Ipv4Addr::from(*ip).into(), Code::NotFound, now));
        assert_eq!(logged.count(), MAX_REMEMBERED_REFUSALS);
    }
}
