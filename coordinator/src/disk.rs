//! Room on the disk of the data folder: while there is little, nothing is
//! leased, so that what is under way can still be written down.

use std::path::Path;

/// Free space that leasing jobs requires, unless the operator says otherwise, MiB: the outcomes
/// and the videos of some dozen rollouts.
pub const DEFAULT_MIN_FREE_MIB: u64 = 256;

/// Free space of a disk, and the space that leasing needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// Free for this user, bytes.
    pub free_bytes: u64,
    /// Needed for leasing, bytes.
    pub needed_bytes: u64,
}

impl Room {
    /// Looks at the disk of a folder. A disk that cannot be looked at is taken
    /// to be full: it can hardly be written.
    pub fn look(folder: &Path, needed_bytes: u64) -> Room {
        let free_bytes = rustix::fs::statvfs(folder)
            .map(|disk| disk.f_bavail.saturating_mul(disk.f_frsize))
            .unwrap_or(0);
        Room {
            free_bytes,
            needed_bytes,
        }
    }

    /// Why nothing may be leased, if that is so.
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
    fn a_disk_that_cannot_be_looked_at_is_full() {
        let nowhere = Path::new("/nowhere/at/all");
        let room = Room::look(nowhere, 1);
        assert_eq!(room.free_bytes, 0);
        let told = room.shortage(nowhere).expect("a shortage");
        assert!(told.contains("/nowhere/at/all has 0 MiB"), "{told}");
    }

    #[test]
    fn leasing_goes_on_down_to_what_is_needed() {
        let folder = Path::new("data");
        let room = |free_bytes| Room {
            free_bytes,
            needed_bytes: 5,
        };
        assert_eq!(room(5).shortage(folder), None);
        assert!(room(4).shortage(folder).is_some());
    }
}
