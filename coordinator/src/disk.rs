//! Free space of the data folder's disk. While it is low, no jobs are leased, so that running
//! rollouts can still be committed.

use std::path::Path;

/// Default of the free space that leasing requires, MiB: enough for the outcomes and videos of
/// more than a hundred rollouts.
pub const DEFAULT_MIN_FREE_MIB: u64 = 256;

/// Free space of a disk, and the space that is required there, by leasing or by an archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// Free space available to this user, bytes.
    pub free_bytes: u64,
    /// Required space, bytes.
    pub needed_bytes: u64,
}

impl Room {
    /// Measures the free space of a folder's disk. If that fails, the disk counts as full, since
    /// writing to it would probably fail, too.
    pub fn measure(folder: &Path, needed_bytes: u64) -> Room {
        let free_bytes = rustix::fs::statvfs(folder)
            .map(|disk| disk.f_bavail.saturating_mul(disk.f_frsize))
            .unwrap_or(0);
        Room { free_bytes, needed_bytes }
    }

    /// Returns the message for a disk without enough space for leasing; `None` if there is enough.
    pub fn shortage(self, folder: &Path) -> Option<String> {
        (self.free_bytes < self.needed_bytes).then(|| {
            format!(
                "the disk of {} has {} MiB left and leasing needs {}: make room, or lower \
                 --min-free-mib",
                folder.display(),
                self.free_bytes >> 20,
                self.needed_bytes >> 20
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_that_cannot_be_measured_counts_as_full() {
        let nowhere = Path::new("/nowhere/at/all");
        let room = Room::measure(nowhere, 1);
        assert_eq!(room.free_bytes, 0);
        let message = room.shortage(nowhere).expect("a shortage");
        assert!(message.contains("/nowhere/at/all has 0 MiB"), "{message}");
    }

    #[test]
    fn leasing_continues_down_to_the_needed_space() {
        let folder = Path::new("data");
        let room = |free_bytes| Room { free_bytes, needed_bytes: 5 };
        assert_eq!(room(5).shortage(folder), None);
        assert!(room(4).shortage(folder).is_some());
    }
}
