//! Permissions of files with secrets.

use std::fs::File;
use std::io;
use std::os::unix::fs::MetadataExt;

use rustix::process::geteuid;

/// Permission bits of the group and of other users.
const OF_GROUP_AND_OTHERS: u32 = 0o077;
const OF_OTHERS: u32 = 0o007;

/// Returns the permissions of an open secret file, and the argument of `chmod` that restricts them,
/// if they are too broad.
///
/// A file of this user must not be accessible to anybody else, as `ssh` demands of its keys. A file
/// of another user, such as a mounted secret or a systemd credential, is shared with this program
/// through its group and must not be accessible to others. The permissions of a pipe do not matter.
pub(crate) fn exposed(file: &File) -> io::Result<Option<(u32, &'static str)>> {
    let metadata = file.metadata()?;
    if !metadata.is_file() {
        return Ok(None);
    }
    let (forbidden, chmod) = match metadata.uid() == geteuid().as_raw() {
        true => (OF_GROUP_AND_OTHERS, "600"),
        false => (OF_OTHERS, "o="),
    };
    let permissions = metadata.mode() & 0o777;
    Ok((permissions & forbidden != 0).then_some((permissions, chmod)))
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn a_secret_that_others_can_read_or_write_is_exposed() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        for (mode, expected) in [
            (0o600, None),
            (0o400, None),
            (0o640, Some(0o640)),
            (0o604, Some(0o604)),
            (0o644, Some(0o644)),
            (0o602, Some(0o602)),
        ] {
            let permissions = Permissions::from_mode(mode);
            std::fs::set_permissions(file.path(), permissions).expect("set");
            let found = exposed(file.as_file()).expect("permissions");
            let expected = expected.map(|permissions| (permissions, "600"));
            assert_eq!(found, expected, "{mode:o}");
        }
        let pipe = File::open("/dev/null").expect("a device");
        assert_eq!(exposed(&pipe).expect("permissions"), None);
    }
}
