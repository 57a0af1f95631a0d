//! Number of slots of a machine. `--slots auto` takes one per core, if memory allows. A number above
//! a limit is refused before any process starts; an implausibly large number causes a warning.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::{fs, io};

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use sim::SceneFolder;
use terminal::counted;

use crate::memory::group_folders;

/// Least memory of a slot, bytes: the smallest scene, mapped from a file.
const LEAST_SLOT_BYTES: u64 = 16 << 20;
/// Most slots that one core can serve with any policy, reached if the policy takes 99 % of the
/// time.
const MAX_PER_CORE: usize = 100;
/// Slots that one core can serve if the policy takes as long as the simulation. More slots only
/// help with a slower policy.
const USUAL_PER_CORE: usize = 2;
/// Memory of a process with one compiled scene of LIBERO's own assets and its frames, bytes.
const SCENE_BYTES: u64 = 1 << 30;
/// The same if scenes are mapped from files.
const MAPPED_SCENE_BYTES: u64 = 128 << 20;
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
    #[error("start {slots} slots: {shortage}; `--slots auto` chooses a number that fits")]
    TooMany { slots: usize, shortage: String },
    #[error(transparent)]
    Machine(#[from] MachineError),
}

/// Reason why the machine's resources are unknown.
#[derive(Debug, thiserror::Error)]
pub enum MachineError {
    #[error("count the cores that this process may use")]
    Cores(#[source] io::Error),
    #[error("find `{FIELD}` in {}", .0.display())]
    Memory(PathBuf),
    #[error("read the available memory")]
    Read(#[from] io::Error),
}

/// Checks that this machine can hold `slots` slots, and raises the limit of open files as far as
/// this process may. Returns a warning if the number is implausibly large.
pub fn check(slots: usize) -> Result<Option<String>, LimitError> {
    let machine = Machine { cores: cores()?, memory: available()?, files: raise_open_files() };
    if let Some(shortage) = machine.shortage(slots) {
        return Err(LimitError::TooMany { slots, shortage });
    }
    Ok(machine.warning(slots))
}

/// Returns the number of processes to run in parallel, each with a number of compiled scenes: one
/// per core, if memory allows.
pub fn fitting(scenes: usize) -> Result<NonZeroUsize, MachineError> {
    let scene_bytes = match SceneFolder::of_process().map(SceneFolder::check) {
        Some(Ok(())) => MAPPED_SCENE_BYTES,
        Some(Err(_)) | None => SCENE_BYTES,
    };
    let fitting = available()? / (scene_bytes * scenes as u64);
    let fitting = usize::try_from(fitting).unwrap_or(usize::MAX);
    Ok(NonZeroUsize::new(cores()?.min(fitting)).unwrap_or(NonZeroUsize::MIN))
}

/// Returns the number of cores that this process may use; its CPU affinity or a control group's
/// quota may leave fewer than the machine has.
fn cores() -> Result<usize, MachineError> {
    let cores = std::thread::available_parallelism();
    cores.map(usize::from).map_err(MachineError::Cores)
}

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
                 a policy that takes longer than the simulation; `coordinator campaign create \
                 --dry-run` says up to how many help",
                counted(self.cores as u64, "core")
            )
        })
    }
}

/// Field of `/proc/meminfo` with the memory that new processes can take, in KiB.
const FIELD: &str = "MemAvailable:";
/// File names of a control group's limit, its use, and the field of `memory.stat` with the part
/// that the kernel reclaims first; for cgroup v2, then for v1's memory hierarchy.
const FILES: [(&str, &str, &str); 2] = [
    ("memory.max", "memory.current", "inactive_file "),
    ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file "),
];

/// Returns the bytes that this process and its children can still allocate.
fn available() -> Result<u64, MachineError> {
    available_below(Path::new("/"))
}

fn available_below(root: &Path) -> Result<u64, MachineError> {
    let file = root.join("proc/meminfo");
    let text = fs::read_to_string(&file)?;
    let machine = text.lines().find_map(|line| line.strip_prefix(FIELD)).and_then(|value| {
        let number: u64 = value.split_whitespace().next()?.parse().ok()?;
        Some(number << 10)
    });
    let machine = machine.ok_or(MachineError::Memory(file))?;
    let groups = fs::read_to_string(root.join("proc/self/cgroup")).unwrap_or_default();
    let base = root.join("sys/fs/cgroup");
    let limits = group_folders(root, &groups).into_iter().filter_map(|folder| {
        // The limits of all parent groups apply too. In a container, the path is that of the
        // host, so only the uppermost folder may exist.
        let parents = folder.ancestors().take_while(|ancestor| ancestor.starts_with(&base));
        parents.filter_map(remaining_memory).min()
    });
    Ok(limits.fold(machine, u64::min))
}

/// Returns the bytes that a control group may still take; `None` without a limit.
fn remaining_memory(group: &Path) -> Option<u64> {
    let number = |file: &str| -> Option<u64> {
        let text = fs::read_to_string(group.join(file)).ok()?;
        text.trim().parse().ok()
    };
    FILES.iter().find_map(|(limit, used, reclaimed)| {
        let (limit, used) = (number(limit)?, number(used)?);
        let stat = fs::read_to_string(group.join("memory.stat")).unwrap_or_default();
        let cached = stat.lines().find_map(|line| line.strip_prefix(reclaimed));
        let cached: u64 = cached.and_then(|text| text.trim().parse().ok()).unwrap_or(0);
        Some(limit.saturating_sub(used.saturating_sub(cached)))
    })
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

    const MEMINFO: &str = "MemTotal:       16000 kB\nMemAvailable:    8000 kB\n";

    fn machine(files: &[(&str, &str)]) -> u64 {
        let root = tempfile::tempdir().expect("a folder");
        for (file, text) in [("proc/meminfo", MEMINFO)].iter().chain(files) {
            let path = root.path().join(file);
            fs::create_dir_all(path.parent().expect("a folder")).expect("made");
            fs::write(path, text).expect("written");
        }
        available_below(root.path()).expect("readable statistics")
    }

    #[test]
    fn without_a_limit_the_machines_memory_is_available() {
        assert_eq!(machine(&[]), 8000 << 10);
        let unlimited = [
            ("proc/self/cgroup", "0::/job\n"),
            ("sys/fs/cgroup/job/memory.max", "max\n"),
            ("sys/fs/cgroup/job/memory.current", "5\n"),
        ];
        assert_eq!(machine(&unlimited), 8000 << 10);
    }

    #[test]
    fn the_tightest_parent_group_limits_the_available_memory() {
        let group = "sys/fs/cgroup/batch/memory";
        let cgroup_v2 = [
            ("proc/self/cgroup", "0::/batch/job\n"),
            ("sys/fs/cgroup/batch/job/memory.max", "max\n"),
            ("sys/fs/cgroup/batch/job/memory.current", "900000\n"),
            (&*format!("{group}.max"), "1000000\n"),
            (&*format!("{group}.current"), "950000\n"),
            (&*format!("{group}.stat"), "anon 1\ninactive_file 50000\nactive_file 7\n"),
        ];
        assert_eq!(machine(&cgroup_v2), 100_000);
        // The path is the host's, as in a container with cgroup v1.
        let cgroup_v1 = [
            ("proc/self/cgroup", "4:memory:/docker/1f\n0::/\n"),
            ("sys/fs/cgroup/memory/memory.limit_in_bytes", "600000\n"),
            ("sys/fs/cgroup/memory/memory.usage_in_bytes", "700000\n"),
            ("sys/fs/cgroup/memory/memory.stat", "inactive_file 1\ntotal_inactive_file 300000\n"),
        ];
        assert_eq!(machine(&cgroup_v1), 200_000);
    }

    #[test]
    fn the_available_memory_of_this_machine_is_read() {
        assert!(available().expect("readable statistics") > 1 << 20);
    }
}
