//! Child processes from the parent's side: how they are started and connected, and the meaning of
//! their exit status.

use std::ffi::OsString;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{ExitStatus, Stdio};

use crate::memory::Verdict;

/// Command line of a slot's process.
#[derive(Clone, Debug)]
pub struct SlotProgram {
    /// Path of the program; by default, the running one.
    pub program: PathBuf,
    pub arguments: Vec<OsString>,
}

/// Creates a connection with a child: the parent's end, and the child's standard input. See
/// [`crate::parent`].
pub(crate) fn connection() -> io::Result<(UnixStream, Stdio)> {
    let (parent_end, child_end) = UnixStream::pair()?;
    Ok((parent_end, Stdio::from(OwnedFd::from(child_end))))
}

/// Describes how a process ended; the text follows the words "the process".
pub(crate) fn explain_status(status: ExitStatus, kills: Verdict) -> String {
    match (status.code(), status.signal()) {
        (_, Some(9)) => format!("was killed by SIGKILL{}", kills.explanation()),
        (_, Some(signal)) => format!("died of signal {signal} ({})", signal_name(signal)),
        (Some(code), None) => format!("exited with code {code}"),
        (None, None) => format!("ended ({status})"),
    }
}

/// Describes the signals that usually kill native code.
fn signal_name(signal: i32) -> &'static str {
    match signal {
        4 => "SIGILL, an instruction that this processor lacks",
        6 => "SIGABRT, a library gave up",
        7 => "SIGBUS, a memory or disk failure",
        8 => "SIGFPE, an arithmetic failure",
        11 => "SIGSEGV, a crash in native code",
        15 => "SIGTERM",
        _ => "see signal(7)",
    }
}
