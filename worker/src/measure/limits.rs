//! Upper limits on a machine's number of slots. A number above a limit is refused before any
//! process starts; an implausibly large number causes a warning.

use std::num::NonZeroUsize;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use sim::SceneFolder;
use terminal::counted;

use super::{MeasureError, cores, room};

/// Least memory of a slot, bytes: the smallest scene, mapped from a file.
const LEAST_SLOT_BYTES: u64 = 16 << 20;
/// Most slots that one core can serve with any policy, reached if the policy takes 99 % of the
/// time.
const MAX_PER_CORE: usize = 100;
/// Slots that one core can serve if the policy takes as long as the simulation. More slots only
/// help with a slower policy.
const USUAL_PER_CORE: usize = 2;
/// Memory for filming one rollout, bytes: a compiled scene of LIBERO's own assets, and frames.
const FILM_BYTES: u64 = 1 << 30;
/// Memory for filming one rollout if scenes are mapped from files, bytes.
const FILM_BYTES_WITH_FILES: u64 = 128 << 20;
/// Open files of the parent process per slot: a socket, two pipes, the process itself.
const FILES_PER_SLOT: u64 = 4;
/// Open files for everything else: libraries, the coordinator's connection, video uploads.
const OTHER_FILES: u64 = 128;

/// Resources that the slots of a machine share.
#[derive(Clone, Copy, Debug)]
struct Machine {
    cores: usize,
    /// Memory that is available, bytes.
    memory: u64,
    /// Limit of open files of this process.
    files: u64,
}

/// Reason why a number of slots is refused.
#[derive(Debug, thiserror::Error)]
pub enum LimitError {
    #[error("start {slots} slots: {shortage}; `--slots auto` chooses a number by measurement")]
    TooMany { slots: usize, shortage: String },
    #[error(transparent)]
    Machine(#[from] MeasureError),
}

/// Checks that this machine can hold `slots` slots, and raises the limit of open files as far as
/// this process may. Returns a warning if the number is implausibly large.
pub fn check(slots: usize) -> Result<Option<String>, LimitError> {
    let machine =
        Machine { cores: cores()?, memory: room::available()?, files: raise_open_files() };
    if let Some(shortage) = machine.shortage(slots) {
        return Err(LimitError::TooMany { slots, shortage });
    }
    Ok(machine.warning(slots))
}

/// Returns the number of rollouts to film in parallel: one per core, if memory allows.
pub fn films() -> Result<NonZeroUsize, MeasureError> {
    let bytes = match SceneFolder::of_process().map(SceneFolder::check) {
        Some(Ok(())) => FILM_BYTES_WITH_FILES,
        Some(Err(_)) | None => FILM_BYTES,
    };
    let fitting = usize::try_from(room::available()? / bytes).unwrap_or(usize::MAX);
    Ok(NonZeroUsize::new(cores()?.min(fitting)).unwrap_or(NonZeroUsize::MIN))
}

/// Raises the soft limit of open files to the hard one, and returns the resulting limit.
fn raise_open_files() -> u64 {
    let limit = getrlimit(Resource::Nofile);
    let raised = Rlimit { current: limit.maximum, maximum: limit.maximum };
    let now = match setrlimit(Resource::Nofile, raised) {
        Ok(()) => limit.maximum,
        Err(_) => limit.current,
    };
    now.unwrap_or(u64::MAX)
}

impl Machine {
    /// Describes the resource that `slots` slots exhaust; the text follows "start N slots:".
    fn shortage(self, slots: usize) -> Option<String> {
        let count = slots as u64;
        if slots > self.cores.saturating_mul(MAX_PER_CORE) {
            return Some(format!(
                "this process may use {}, which can serve at most {} slots, even if the policy \
                 takes 99 % of the time",
                counted(self.cores as u64, "core"),
                self.cores * MAX_PER_CORE
            ));
        }
        let bytes = count.saturating_mul(LEAST_SLOT_BYTES);
        if bytes > self.memory {
            return Some(format!(
                "each takes {} MiB of memory at least, {} MiB together, and {} MiB are available",
                LEAST_SLOT_BYTES >> 20,
                bytes >> 20,
                self.memory >> 20
            ));
        }
        let files = count.saturating_mul(FILES_PER_SLOT) + OTHER_FILES;
        (files > self.files).then(|| {
            format!(
                "they need {files} open files and this process may have {}; raise the limit \
                 (`ulimit -n`, LimitNOFILE= of a unit)",
                self.files
            )
        })
    }

    fn warning(self, slots: usize) -> Option<String> {
        (slots > self.cores.saturating_mul(USUAL_PER_CORE)).then(|| {
            format!(
                "{slots} slots share {}: more than {USUAL_PER_CORE} for each core only help with \
                 a policy that takes longer than the simulation; `worker bench --policy-secs` \
                 measures how many raise the throughput",
                counted(self.cores as u64, "core")
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MACHINE: Machine = Machine { cores: 8, memory: 32 << 30, files: 1024 };

    #[test]
    fn slots_beyond_cores_memory_or_open_files_are_refused_with_the_reason() {
        let check = |machine: Machine, slots, words: &str| {
            let shortage = machine.shortage(slots).expect("a shortage");
            assert!(shortage.contains(words), "{shortage}");
        };
        check(MACHINE, 100_000, "may use 8 cores");
        let small = Machine { memory: 8 << 30, ..MACHINE };
        check(small, 600, "9600 MiB together, and 8192 MiB are available");
        check(MACHINE, 300, "need 1328 open files and this process may have 1024");
        assert_eq!(MACHINE.shortage(200), None);
        assert_eq!(MACHINE.shortage(1), None);
    }

    #[test]
    fn implausibly_many_slots_cause_a_warning() {
        assert_eq!(MACHINE.warning(16), None);
        let warning = MACHINE.warning(17).expect("a warning");
        assert!(warning.starts_with("17 slots share 8 cores"), "{warning}");
    }
}
