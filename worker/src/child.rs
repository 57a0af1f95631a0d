//! Child processes as their parent sees them: how they are started and
//! connected, and what their ends mean.

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
    /// The program: this one, as a rule.
    pub program: PathBuf,
    /// Arguments of the program.
    pub arguments: Vec<OsString>,
}

/// A connection with a child: this side of it, and what the child is to have as
/// its standard input. See [`crate::parent`].
pub(crate) fn connection() -> io::Result<(UnixStream, Stdio)> {
    let (ours, theirs) = UnixStream::pair()?;
    Ok((ours, Stdio::from(OwnedFd::from(theirs))))
}

/// Reads after "the process".
pub(crate) fn explain_status(status: ExitStatus, kills: Verdict) -> String {
    match (status.code(), status.signal()) {
        (_, Some(9)) => format!("was killed by SIGKILL{}", kills.in_words()),
        (_, Some(signal)) => format!("died of signal {signal} ({})", signal_name(signal)),
        (Some(code), None) => format!("exited with code {code}"),
        (None, None) => format!("ended ({status})"),
    }
}

/// The signals that native code dies of.
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
