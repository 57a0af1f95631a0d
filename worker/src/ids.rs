//! Identifiers that this worker chooses: its own, its machine's, and those of its claims.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::{fmt, fs, process};

use benchmark::attempt::AttemptId;
use sha2::{Digest, Sha256};

/// Identifier of a worker process, new at every start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkerId(String);

impl WorkerId {
    /// Combines host, process id and `random`, so that a worker that restarts on the same machine
    /// never answers for its predecessor's leases.
    pub fn new(host: &str, random: u64) -> Self {
        let host: String = host
            .chars()
            .map(|letter| if letter.is_ascii_alphanumeric() { letter } else { '-' })
            .take(MAX_HOST_CHARS)
            .collect();
        Self(format!("{host}-{}-{:08x}", process::id(), random as u32))
    }

    /// Returns the identifier as sent to the coordinator.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for WorkerId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Longest part of a host's name in a worker's identifier.
const MAX_HOST_CHARS: usize = 40;

/// Returns the machine's host name, or `unknown-host`.
pub fn host_name() -> String {
    let kernel_name = fs::read_to_string("/proc/sys/kernel/hostname").ok();
    kernel_name
        .or_else(|| std::env::var("HOSTNAME").ok())
        .map(|name| name.trim().to_owned())
        .filter(|name| !name.is_empty())
        .unwrap_or_else(|| "unknown-host".to_owned())
}

/// Returns an identifier of this machine, the same for every worker on the machine, in a container
/// or not, until the machine is rebooted; empty if the kernel provides no boot id.
///
/// The identifier is derived from the kernel's boot id, which all containers of a machine share and
/// no other machine has. `/etc/machine-id` is unsuitable: containers have that of their image or
/// none, and cluster nodes that boot from one image often share it. The host name is unsuitable
/// too: each container has a new host name. A rebooted machine counts as a new machine, since the
/// reboot may have repaired it.
pub fn machine() -> String {
    let boot = fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    match boot.trim() {
        "" => String::new(),
        // The digest keeps the boot id itself private.
        boot => hex::encode(Sha256::digest(format!("rollout machine {boot}")))[..32].to_owned(),
    }
}

/// Returns a random number, from the operating system's randomness with which the standard library
/// seeds its hash maps.
pub fn random_number() -> u64 {
    RandomState::new().build_hasher().finish()
}

/// Returns a unique identifier for a claim, or for an attempt that no coordinator granted.
pub fn random_id() -> AttemptId {
    let bits = [random_number(), random_number()].map(u64::to_be_bytes);
    let mut bytes = [0; 16];
    bytes.copy_from_slice(bits.as_flattened());
    AttemptId::from_random(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_ids_differ() {
        let ids: std::collections::HashSet<_> = (0..1000).map(|_| random_id()).collect();
        assert_eq!(ids.len(), 1000);
    }

    #[test]
    fn a_machine_id_is_stable_and_hides_the_boot_id() {
        let boot = fs::read_to_string("/proc/sys/kernel/random/boot_id").expect("a boot id");
        assert_eq!(machine(), machine());
        assert_eq!(machine().len(), 32);
        assert!(!machine().contains(&boot.trim().replace('-', "")[..8]));
    }

    #[test]
    fn two_starts_of_a_worker_have_different_names() {
        let names = [(); 2].map(|()| WorkerId::new("node 7.cluster", random_number()));
        assert_ne!(names[0], names[1]);
        assert!(names[0].as_str().starts_with("node-7-cluster-"));
    }
}
