//! How many slots a machine can hold at all. A number beyond that is refused before a
//! process is started, and one that is hardly meant is warned about.

use std::num::NonZeroUsize;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use sim::SceneFolder;
use terminal::counted;

use super::{MeasureError, cores, room};

/// Memory that a slot takes at least, with the smallest scene and that in a file, bytes.
const LEAST_SLOT_BYTES: u64 = 16 << 20;
/// Slots for each core that no policy, however slow, keeps busy: those of a policy that
/// thinks 99 % of the time.
const MAX_PER_CORE: usize = 100;
/// Slots for each core that a policy as slow as the simulation keeps busy. More are only
/// worth having with a slower one.
const USUAL_PER_CORE: usize = 2;
/// Memory for filming one rollout, bytes: a compiled scene of LIBERO's own assets and its
/// pictures.
const FILM_BYTES: u64 = 1 << 30;
/// The same where scenes lie in files.
const FILM_BYTES_WITH_FILES: u64 = 128 << 20;
/// Open files of this process for each slot: a socket, two pipes, the process itself.
const FILES_PER_SLOT: u64 = 4;
/// Open files of everything else: libraries, the coordinator, videos on their way.
const OTHER_FILES: u64 = 128;

/// Resources of the machine for slots.
#[derive(Clone, Copy, Debug)]
struct Machine {
    cores: usize,
    /// Memory that is available, bytes.
    memory: u64,
    /// Files that this process may have open.
    files: u64,
}

/// Reason for which a worker does not start so many slots.
#[derive(Debug, thiserror::Error)]
pub enum LimitError {
    /// There is no room for them.
    #[error("start {slots} slots: {shortage}; `--slots auto` chooses a number by measurement")]
    TooMany {
        /// Number of slots asked for.
        slots: usize,
        /// The resource that is exhausted.
        shortage: String,
    },
    /// The machine does not say what it has.
    #[error(transparent)]
    Machine(#[from] MeasureError),
}

/// Checks that this machine can hold so many slots, and raises the limit of open files
/// as far as this process may. Returns a warning if the number is hardly meant.
///
/// # Errors
/// If there are not enough cores, memory or open files for them, or the machine does not
/// say how much there is.
pub fn check(slots: usize) -> Result<Option<String>, LimitError> {
    let machine = Machine {
        cores: cores()?,
        memory: room::available()?,
        files: raise_open_files(),
    };
    if let Some(shortage) = machine.shortage(slots) {
        return Err(LimitError::TooMany { slots, shortage });
    }
    Ok(machine.doubt(slots))
}

/// Rollouts that this machine can film at a time: one for each core, if memory allows.
///
/// # Errors
/// If the machine does not say what it has.
pub fn films() -> Result<NonZeroUsize, MeasureError> {
    let bytes = match SceneFolder::of_process().map(SceneFolder::check) {
        Some(Ok(())) => FILM_BYTES_WITH_FILES,
        Some(Err(_)) | None => FILM_BYTES,
    };
    let fitting = usize::try_from(room::available()? / bytes).unwrap_or(usize::MAX);
    Ok(NonZeroUsize::new(cores()?.min(fitting)).unwrap_or(NonZeroUsize::MIN))
}

/// Raises the soft limit of open files to the hard one, and returns what holds then.
fn raise_open_files() -> u64 {
    let limit = getrlimit(Resource::Nofile);
    let raised = Rlimit {
        current: limit.maximum,
        maximum: limit.maximum,
    };
    let now = match setrlimit(Resource::Nofile, raised) {
        Ok(()) => limit.maximum,
        Err(_) => limit.current,
    };
    now.unwrap_or(u64::MAX)
}

impl Machine {
    /// Reads after "start N slots:".
    fn shortage(self, slots: usize) -> Option<String> {
        let count = slots as u64;
        if slots > self.cores.saturating_mul(MAX_PER_CORE) {
            return Some(format!(
                "this process may use {}, which even a policy that takes 99 % of the time keeps \
                 busy with {} slots",
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

    fn doubt(self, slots: usize) -> Option<String> {
        (slots > self.cores.saturating_mul(USUAL_PER_CORE)).then(|| {
            format!(
                "{slots} slots share {}: more than {USUAL_PER_CORE} for each core only help with \
                 a policy that takes longer than the simulation; `worker bench --policy-secs` \
                 measures how many are worth having",
                counted(self.cores as u64, "core")
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MACHINE: Machine = Machine {
        cores: 8,
        memory: 32 << 30,
        files: 1024,
    };

    #[test]
    fn slots_beyond_cores_memory_or_open_files_are_refused_with_what_is_short() {
        let check = |machine: Machine, slots, words: &str| {
            let shortage = machine.shortage(slots).expect("a shortage");
            assert!(shortage.contains(words), "{shortage}");
        };
        check(MACHINE, 100_000, "may use 8 cores");
        let small = Machine {
            memory: 8 << 30,
            ..MACHINE
        };
        check(small, 600, "9600 MiB together, and 8192 MiB are available");
        check(
            MACHINE,
            300,
            "need 1328 open files and this process may have 1024",
        );
        assert_eq!(MACHINE.shortage(200), None);
        assert_eq!(MACHINE.shortage(1), None);
    }

    #[test]
    fn more_slots_than_a_usual_policy_keeps_busy_are_doubted() {
        assert_eq!(MACHINE.doubt(16), None);
        let doubt = MACHINE.doubt(17).expect("a warning");
        assert!(doubt.starts_with("17 slots share 8 cores"), "{doubt}");
    }
}
