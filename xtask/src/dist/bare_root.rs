//! A root folder with glibc and nothing else: no shell, no library of the compiler, no
//! OpenGL, no Python. What starts in it starts on any machine with a glibc that is new
//! enough, and an image for containers is made of it.

use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result};

use crate::process::capture;

use super::archive::Archive;
use super::native;
use super::release::PROGRAMS;

/// Path of the unpacked archive in it.
pub(super) const PREFIX: &str = "/opt/rollout";

/// The user whom programs run as, and who owns nothing but [`DATA`].
pub(super) const USER: u32 = 65_532;

/// A folder of theirs.
pub(super) const DATA: &str = "/data";

/// Gives the root its devices and processes, then becomes a program in it.
const ENTER: &str = "mount --rbind /proc \"$0/proc\" && mount --rbind /dev \"$0/dev\" && \
                     exec chroot \"$@\"";

/// The root, and how it is entered.
pub(super) struct BareRoot {
    dir: PathBuf,
    as_root: bool,
}

impl BareRoot {
    /// Makes it in a folder, with the archive unpacked.
    pub(super) fn make(dir: &Path, archive: &Archive) -> Result<Self> {
        for folder in ["dev", "etc", "proc", "tmp", "opt"] {
            std::fs::create_dir_all(dir.join(folder))?;
        }
        let write = |path: &str, text: String| {
            let path = inside(dir, Path::new(path));
            std::fs::write(&path, text).with_context(|| format!("write {}", path.display()))
        };
        let everybody = std::fs::Permissions::from_mode(0o1777);
        std::fs::set_permissions(dir.join("tmp"), everybody)?;
        let entry = "rollout:x";
        write(
            "/etc/passwd",
            format!("{entry}:{USER}:{USER}::{DATA}:/none\n"),
        )?;
        write("/etc/group", format!("{entry}:{USER}:\n"))?;
        write("/etc/nsswitch.conf", "hosts: files dns\n".to_owned())?;

        let mut tar = Command::new("tar");
        tar.args(["--extract", "--no-same-owner", "--file"])
            .arg(&archive.file);
        capture(tar.arg("--directory").arg(dir.join("opt")))?;
        let unpacked = dir.join("opt").join(&archive.name);
        let prefix = inside(dir, Path::new(PREFIX));
        std::fs::rename(&unpacked, &prefix)?;

        let linker = archive
            .elf
            .interpreter(&prefix.join("bin").join(PROGRAMS[0]))?;
        for file in native::glibc().iter().chain([&linker]) {
            let to = inside(dir, file);
            std::fs::create_dir_all(to.parent().context("name a file")?)?;
            std::fs::copy(file, &to).with_context(|| format!("copy {}", file.display()))?;
        }
        // A machine's programs are on its path.
        std::fs::create_dir_all(dir.join("usr"))?;
        symlink(format!("{PREFIX}/bin"), dir.join("usr/bin"))?;
        let id = capture(Command::new("id").arg("-u"))?;
        Ok(Self {
            dir: dir.to_owned(),
            as_root: id == "0",
        })
    }

    /// Path of its folder.
    pub(super) fn dir(&self) -> &Path {
        &self.dir
    }

    /// Makes the folder of the programs' user.
    pub(super) fn add_data(&self) -> Result<()> {
        let data = inside(&self.dir, Path::new(DATA));
        std::fs::create_dir_all(&data)?;
        if self.as_root {
            std::os::unix::fs::chown(&data, Some(USER), Some(USER))?;
        }
        Ok(())
    }

    /// Reason why this machine lets nobody in, if it does not.
    pub(super) fn closed(&self) -> Option<String> {
        capture(Command::new("unshare").args(self.spaces()).arg("true"))
            .err()
            .map(|error| format!("{error:#}").replace('\n', ": "))
    }

    /// Namespaces in which one may mount and change the root.
    fn spaces(&self) -> &'static [&'static str] {
        match self.as_root {
            true => &["--mount"],
            false => &["--user", "--map-root-user", "--mount"],
        }
    }

    /// One of the archive's programs in it. Started by root, it runs as [`USER`].
    pub(super) fn program(&self, name: &str) -> Command {
        let mut command = Command::new("unshare");
        command
            .env_clear()
            .env("PATH", std::env::var_os("PATH").unwrap_or_default());
        command
            .args(self.spaces())
            .args(["sh", "-c", ENTER])
            .arg(&self.dir);
        if self.as_root {
            command.arg(format!("--userspec={USER}:{USER}"));
        }
        command.arg(&self.dir).arg(format!("{PREFIX}/bin/{name}"));
        command.stdin(Stdio::null());
        command
    }
}

/// Path outside of a path of the root.
fn inside(dir: &Path, path: &Path) -> PathBuf {
    dir.join(path.strip_prefix("/").unwrap_or(path))
}
