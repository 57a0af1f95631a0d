//! Detects kills for lack of memory without the kernel's log, which needs rights that a worker may
//! not have. The kernel counts such kills per control group and for the machine; a counter that
//! rose while a process ended by SIGKILL shows that the kernel sent the signal.

use std::fs;
use std::path::{Path, PathBuf};

/// The kernel's counters of out-of-memory kills; `None` for a counter that the kernel lacks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct OomKills {
    /// Kills in the control group of this process and its slots.
    group: Option<u64>,
    /// Kills on the whole machine.
    machine: Option<u64>,
}

/// Cause of a SIGKILL, according to the counters before and after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// The kernel killed a process of this control group, presumably at the group's memory limit.
    GroupLimit,
    /// The kernel killed a process on this machine, but none that is counted for this control
    /// group.
    Machine,
    /// The kernel killed no process: another process sent the signal.
    Signal,
    /// The kernel does not count out-of-memory kills.
    Unknown,
}

impl OomKills {
    pub(crate) fn read() -> Self {
        Self::read_below(Path::new("/"))
    }

    fn read_below(root: &Path) -> Self {
        let groups = fs::read_to_string(root.join("proc/self/cgroup")).unwrap_or_default();
        let folders = group_folders(root, &groups).into_iter();
        let counters = folders.flat_map(|folder| GROUP_COUNTERS.map(|file| folder.join(file)));
        Self {
            group: counters.filter_map(|file| counter(&file)).next(),
            machine: counter(&root.join("proc/vmstat")),
        }
    }

    /// Returns the cause of a SIGKILL that was sent between an earlier reading and this one.
    pub(crate) fn since(self, earlier: Self) -> Verdict {
        let rose = |now: Option<u64>, before: Option<u64>| Some(now? > before?);
        match (rose(self.group, earlier.group), rose(self.machine, earlier.machine)) {
            (Some(true), _) => Verdict::GroupLimit,
            (_, Some(true)) => Verdict::Machine,
            (None, None) => Verdict::Unknown,
            _ => Verdict::Signal,
        }
    }
}

impl Verdict {
    /// Explains the cause; the text follows the words "was killed by SIGKILL".
    pub(crate) fn explanation(self) -> &'static str {
        match self {
            Self::GroupLimit => {
                ": out of memory, its control group or the machine had reached a limit; give the \
                 worker fewer --slots or more memory"
            }
            Self::Machine => {
                ": out of memory, the kernel was killing processes on this machine; give the \
                 worker fewer --slots or the machine more memory"
            }
            Self::Signal => ", not for lack of memory: another process sent the signal",
            Self::Unknown => {
                "; if no process sent it, the kernel ran out of memory: give the worker fewer \
                 --slots or more memory"
            }
        }
    }
}

/// Files with a control group's counter: of cgroup v2, and of v1's memory hierarchy.
const GROUP_COUNTERS: [&str; 2] = ["memory.events", "memory.oom_control"];

/// Returns the folders of a process's control group in the hierarchies that count memory. `groups`
/// is the text of its `/proc/self/cgroup`.
pub(crate) fn group_folders(root: &Path, groups: &str) -> Vec<PathBuf> {
    let folder = |line: &str| {
        let mut fields = line.splitn(3, ':');
        let (_, controllers, path) = (fields.next()?, fields.next()?, fields.next()?);
        let path = path.trim_start_matches('/');
        let base = root.join("sys/fs/cgroup");
        if controllers.is_empty() {
            Some(base.join(path))
        } else if controllers.split(',').any(|controller| controller == "memory") {
            Some(base.join("memory").join(path))
        } else {
            None
        }
    };
    groups.lines().filter_map(folder).collect()
}

/// Reads the value of `oom_kill` in a file of names and numbers.
fn counter(file: &Path) -> Option<u64> {
    let text = fs::read_to_string(file).ok()?;
    let number = |line: &str| line.strip_prefix("oom_kill ")?.trim().parse().ok();
    text.lines().find_map(number)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(root: &Path, file: &str, text: &str) {
        let path = root.join(file);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::write(path, text).expect("written");
    }

    #[test]
    fn the_counter_of_either_hierarchy_is_found() {
        let cgroup_v2 = tempfile::tempdir().expect("a folder");
        write(cgroup_v2.path(), "proc/self/cgroup", "0::/batch/job-7\n");
        let events = "low 0\noom 3\noom_kill 2\noom_group_kill 0\n";
        write(cgroup_v2.path(), "sys/fs/cgroup/batch/job-7/memory.events", events);
        write(cgroup_v2.path(), "proc/vmstat", "pgfault 9\noom_kill 5\n");
        let (group, machine) = (Some(2), Some(5));
        let read = OomKills::read_below(cgroup_v2.path());
        assert_eq!(read, OomKills { group, machine });

        let cgroup_v1 = tempfile::tempdir().expect("a folder");
        write(cgroup_v1.path(), "proc/self/cgroup", "4:memory:/job\n1:cpu,cpuacct:/job\n0::/\n");
        let control = "oom_kill_disable 0\nunder_oom 0\noom_kill 4\n";
        write(cgroup_v1.path(), "sys/fs/cgroup/memory/job/memory.oom_control", control);
        let read = OomKills::read_below(cgroup_v1.path());
        let (group, machine) = (Some(4), None);
        assert_eq!(read, OomKills { group, machine });
    }

    #[test]
    fn a_risen_counter_identifies_the_cause_of_a_kill() {
        let kills = |group, machine| OomKills { group, machine };
        let check = |before, after: OomKills, expected| {
            assert_eq!(after.since(before), expected, "{before:?} {after:?}");
        };
        let before = kills(Some(1), Some(7));
        check(before, kills(Some(2), Some(8)), Verdict::GroupLimit);
        check(before, kills(Some(1), Some(8)), Verdict::Machine);
        check(before, before, Verdict::Signal);
        check(kills(None, None), kills(None, None), Verdict::Unknown);
        check(kills(None, Some(1)), kills(None, Some(2)), Verdict::Machine);
    }

    #[test]
    fn this_machine_has_a_kill_counter() {
        // Every Linux kernel since 4.13 has the machine's counter.
        assert!(OomKills::read().machine.is_some());
    }
}
