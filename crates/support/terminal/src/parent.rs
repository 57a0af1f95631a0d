//! Programs that one program starts and that must not outlive it.

use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

/// The process id of the program that started this one and that it must not outlive.
pub const PARENT_VARIABLE: &str = "ROLLOUT_PARENT";

/// Has the kernel kill this process when its parent ends, if [`PARENT_VARIABLE`] names
/// the parent. Every program may be killed at any time without losing what it answered
/// for, and a parent that ends well has ended it before.
pub fn end_with_parent() {
    let named = std::env::var(PARENT_VARIABLE).ok();
    let named = named.and_then(|pid| Pid::from_raw(pid.parse().ok()?));
    // Processes further down inherit the variable, and have other parents.
    if named.is_some() && named == getppid() {
        // Without it, the process only lives on when its parent is killed.
        let _ = set_parent_process_death_signal(Some(Signal::KILL));
    }
}
