//! Faults of the operating system: signals, file modes, file size limits and clocks.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

use crate::programs::Process;

/// Id of a user without write access to the test's files.
pub(super) const NOBODY: &str = "65534";

/// Finds Debian's libfaketime in any architecture's library folder.
pub(super) fn faketime() -> Option<PathBuf> {
    let folders = std::fs::read_dir("/usr/lib").ok()?.flatten();
    let mut libraries = folders.map(|folder| folder.path().join("faketime/libfaketimeMT.so.1"));
    libraries.find(|library| library.is_file())
}

/// Returns a command prefix that runs a program without write access to a folder; `None` if this
/// process is root's and cannot run programs as another user.
pub(super) fn without_write_access(folder: &Path) -> Option<Command> {
    let id = Command::new("id").arg("-u").output().expect("id runs");
    if id.stdout.trim_ascii() != b"0" {
        set_modes(folder, 0o555, 0o444);
        return Some(Command::new("env"));
    }
    // File modes do not restrict root, so the coordinator runs as another user.
    set_modes(folder, 0o755, 0o644);
    let as_nobody = || {
        let mut command = Command::new("setpriv");
        command.args(["--reuid", NOBODY, "--regid", NOBODY, "--clear-groups"]);
        command
    };
    if as_nobody().arg("true").status().is_ok_and(|status| status.success()) {
        return Some(as_nobody());
    }
    eprintln!("SKIPPED the read-only database: setpriv cannot run it as another user than root");
    None
}

pub(super) fn set_modes(folder: &Path, folder_mode: u32, file_mode: u32) {
    let set = |path: &Path, mode| {
        let mode = std::fs::Permissions::from_mode(mode);
        std::fs::set_permissions(path, mode).expect("a writable file");
    };
    for entry in std::fs::read_dir(folder).expect("a folder").flatten() {
        if entry.path().is_file() {
            set(&entry.path(), file_mode);
        }
    }
    set(folder, folder_mode);
}

pub(super) fn pause(process: &Process, time: Duration) {
    process.signal("-STOP");
    sleep(time);
    process.signal("-CONT");
}

/// Sets a process's file size limit, `soft:hard`.
pub(super) fn limit_files(process: &Process, limit: &str) {
    let status = Command::new("prlimit")
        .args(["--pid", &process.id().to_string()])
        .arg(format!("--fsize={limit}"))
        .status();
    assert!(status.expect("prlimit runs").success());
}

/// Kills processes. Some may have exited since they were listed, so errors are ignored.
pub(super) fn kill_all(processes: &[u32]) {
    for process in processes {
        let _ = Command::new("kill").args(["-KILL", &process.to_string()]).status();
    }
}

pub(super) fn children(pid: u32) -> Vec<u32> {
    let Ok(threads) = std::fs::read_dir(format!("/proc/{pid}/task")) else {
        return Vec::new();
    };
    let lists = threads.flatten().map(|thread| {
        let list = std::fs::read_to_string(thread.path().join("children"));
        list.unwrap_or_default()
    });
    lists
        .flat_map(|list| {
            let children = list.split_whitespace().map(str::parse);
            children.flatten().collect::<Vec<u32>>()
        })
        .collect()
}
