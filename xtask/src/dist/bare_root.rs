//! Bare root: a root folder with glibc and the archive, but no shell, OpenGL or Python. A program
//! that starts in the bare root starts on any machine with a recent enough glibc. Programs of the
//! development profile also get the compiler's libraries, which those of a release do not need.

use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result};

use crate::process::capture;

use super::archive::Archive;
use super::native;

/// Path of the unpacked archive inside the root.
pub(super) const PREFIX: &str = "/opt/rollout";

/// User id that the programs run as; this user owns nothing but [`DATA`].
pub(super) const USER: u32 = 65_532;

/// Folder that the programs' user may write to.
pub(super) const DATA: &str = "/data";

/// Shell command that mounts /proc and /dev into the root and starts a program in it.
const ENTER: &str = "mount --rbind /proc \"$0/proc\" && mount --rbind /dev \"$0/dev\" && \
                     exec chroot \"$@\"";

pub(super) struct BareRoot {
    dir: PathBuf,
    /// True if this process runs as root; otherwise entering the folder requires a user namespace.
    is_root: bool,
}

impl BareRoot {
    pub(super) fn make(dir: &Path, archive: &Archive) -> Result<Self> {
        for folder in ["dev", "etc", "proc", "tmp", "opt"] {
            std::fs::create_dir_all(dir.join(folder))?;
        }
        let write = |path: &str, text: String| {
            let path = inside(dir, Path::new(path));
            std::fs::write(&path, text).with_context(|| format!("write {}", path.display()))
        };
        let world_writable = std::fs::Permissions::from_mode(0o1777);
        std::fs::set_permissions(dir.join("tmp"), world_writable)?;
        let entry = "rollout:x";
        write("/etc/passwd", format!("{entry}:{USER}:{USER}::{DATA}:/none\n"))?;
        write("/etc/group", format!("{entry}:{USER}:\n"))?;
        write("/etc/nsswitch.conf", "hosts: files dns\n".to_owned())?;

        let mut tar = Command::new("tar");
        tar.args(["--extract", "--no-same-owner", "--file"]).arg(&archive.file);
        capture(tar.arg("--directory").arg(dir.join("opt")))?;
        let unpacked = dir.join("opt").join(&archive.name);
        let prefix = inside(dir, Path::new(PREFIX));
        std::fs::rename(&unpacked, &prefix)?;

        for file in native::of_machine(&archive.staged)? {
            let to = inside(dir, &file);
            std::fs::create_dir_all(to.parent().context("name a file")?)?;
            std::fs::copy(&file, &to).with_context(|| format!("copy {}", file.display()))?;
        }
        // Puts the programs on the search path.
        std::fs::create_dir_all(dir.join("usr"))?;
        symlink(format!("{PREFIX}/bin"), dir.join("usr/bin"))?;
        let id = capture(Command::new("id").arg("-u"))?;
        Ok(Self { dir: dir.to_owned(), is_root: id == "0" })
    }

    pub(super) fn dir(&self) -> &Path {
        &self.dir
    }

    pub(super) fn add_data(&self) -> Result<()> {
        let data = inside(&self.dir, Path::new(DATA));
        std::fs::create_dir_all(&data)?;
        if self.is_root {
            std::os::unix::fs::chown(&data, Some(USER), Some(USER))?;
        }
        Ok(())
    }

    /// Returns the reason why the root cannot be entered on this machine; `None` if it can be
    /// entered.
    pub(super) fn entry_problem(&self) -> Option<String> {
        capture(Command::new("unshare").args(self.namespace_options()).arg("true"))
            .err()
            .map(|error| format!("{error:#}").replace('\n', ": "))
    }

    /// Returns `unshare`'s options for namespaces in which mounts and `chroot` are allowed.
    fn namespace_options(&self) -> &'static [&'static str] {
        if self.is_root { &["--mount"] } else { &["--user", "--map-root-user", "--mount"] }
    }

    /// Returns the command that starts a program of the archive in the root folder; if this
    /// process runs as root, the program runs as [`USER`].
    pub(super) fn program(&self, name: &str) -> Command {
        let mut command = Command::new("unshare");
        command.env_clear().env("PATH", std::env::var_os("PATH").unwrap_or_default());
        command.args(self.namespace_options()).args(["sh", "-c", ENTER]).arg(&self.dir);
        if self.is_root {
            command.arg(format!("--userspec={USER}:{USER}"));
        }
        command.arg(&self.dir).arg(format!("{PREFIX}/bin/{name}"));
        command.stdin(Stdio::null());
        command
    }
}

/// Returns the path on this machine of a path inside the bare root.
fn inside(dir: &Path, path: &Path) -> PathBuf {
    dir.join(path.strip_prefix("/").unwrap_or(path))
}
