//! The names that go into leases.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::{fmt, fs, process};

use proto::coordinator::LeaseRef;

/// A job: one rollout and replicate of a campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct JobId(pub i64);

/// The fencing token of a job: only the newest attempt counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Attempt(pub u32);

/// One attempt of this worker at one job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LeaseKey {
    /// The job.
    pub job: JobId,
    /// The attempt.
    pub attempt: Attempt,
}

impl LeaseKey {
    /// As the coordinator names it.
    pub fn to_wire(self, worker: &WorkerId) -> LeaseRef {
        LeaseRef {
            worker_id: worker.to_string(),
            job_id: self.job.0,
            attempt: self.attempt.0,
        }
    }
}

/// A worker, new at every start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkerId(String);

impl WorkerId {
    /// Host, process and `random`, so that a worker which starts again on the
    /// same machine never answers for its predecessor's leases.
    pub fn new(host: &str, random: u64) -> Self {
        let host: String = host
            .chars()
            .map(|letter| {
                if letter.is_ascii_alphanumeric() {
                    letter
                } else {
                    '-'
                }
            })
            .take(MAX_HOST_CHARS)
            .collect();
        Self(format!("{host}-{}-{:08x}", process::id(), random as u32))
    }

    /// As it goes over the wire.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for WorkerId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Part of a host's name that goes into a worker's.
const MAX_HOST_CHARS: usize = 40;

/// This machine's name.
pub fn host_name() -> String {
    let told = fs::read_to_string("/proc/sys/kernel/hostname").ok();
    told.or_else(|| std::env::var("HOSTNAME").ok())
        .map(|name| name.trim().to_owned())
        .filter(|name| !name.is_empty())
        .unwrap_or_else(|| "unknown-host".to_owned())
}

/// A number that no other start of a worker has: the standard library seeds
/// its hash maps from the system's random numbers.
pub fn random_number() -> u64 {
    RandomState::new().build_hasher().finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_starts_of_a_worker_have_different_names() {
        let names = [(); 2].map(|()| WorkerId::new("node 7.cluster", random_number()));
        assert_ne!(names[0], names[1]);
        assert!(names[0].as_str().starts_with("node-7-cluster-"));
    }
}
