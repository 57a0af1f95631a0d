//! Memory available to slots: that of the machine, or less if a control group limits this process.

use std::fs;
use std::path::Path;

use super::MeasureError;
use crate::memory::group_folders;

/// File names of a control group's limit, its use, and the field of `memory.stat` with the part
/// that the kernel reclaims first; for cgroup v2, then for v1's memory hierarchy.
const FILES: [(&str, &str, &str); 2] = [
    ("memory.max", "memory.current", "inactive_file "),
    ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file "),
];

/// Returns the bytes that this process and its children can still allocate.
pub(super) fn available() -> Result<u64, MeasureError> {
    available_below(Path::new("/"))
}

fn available_below(root: &Path) -> Result<u64, MeasureError> {
    let file = root.join("proc/meminfo");
    let field = "MemAvailable:";
    let machine = bytes(&fs::read_to_string(&file)?, field);
    let machine = machine.ok_or(MeasureError::Memory { field, file })?;
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

/// Reads a field of a text in the format of `/proc/meminfo`, converted from kibibytes to bytes.
pub(super) fn bytes(text: &str, field: &str) -> Option<u64> {
    let value = text.lines().find_map(|line| line.strip_prefix(field))?;
    let number: u64 = value.split_whitespace().next()?.parse().ok()?;
    Some(number << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

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
