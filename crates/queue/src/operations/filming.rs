//! Number of videos that each worker renders or uploads, as reported by its last heartbeat. The
//! numbers are kept in memory only; after a restart the next heartbeats report them again.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

use crate::clock::UnixMillis;
use crate::ids::WorkerId;

/// Non-zero numbers of videos by worker, and the instants of their reports.
#[derive(Debug, Default)]
pub(crate) struct Filming(Mutex<BTreeMap<WorkerId, (u32, UnixMillis)>>);

impl Filming {
    /// Records the number of videos that a worker's heartbeat reports. Drops workers whose last
    /// report is older than `alive_since`.
    pub(crate) fn record(
        &self,
        worker: &WorkerId,
        videos: u32,
        now: UnixMillis,
        alive_since: UnixMillis,
    ) {
        let mut reports = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        reports.retain(|id, (_, at)| id != worker && *at >= alive_since);
        if videos > 0 {
            reports.insert(worker.clone(), (videos, now));
        }
    }

    /// Returns the numbers of videos, by worker; workers without videos are absent.
    pub(crate) fn by_worker(&self) -> BTreeMap<WorkerId, u32> {
        let reports = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let reports = reports.iter();
        reports.map(|(id, (videos, _))| (id.clone(), *videos)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workers_without_videos_or_recent_reports_are_dropped() {
        let filming = Filming::default();
        let id = |name: &str| WorkerId(name.to_owned());
        let report = |name: &str, videos, now| {
            filming.record(&id(name), videos, UnixMillis(now), UnixMillis(now - 30));
            filming.by_worker()
        };
        report("a", 2, 100);
        assert_eq!(report("b", 1, 110), [(id("a"), 2), (id("b"), 1)].into());
        assert_eq!(report("b", 0, 120), [(id("a"), 2)].into());
        assert_eq!(report("c", 0, 140), [].into());
    }
}
