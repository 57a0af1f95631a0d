//! Child programs that must not outlive their parent.

use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

/// Variable with the process id of the parent that this program must not outlive.
pub const PARENT_VARIABLE: &str = "ROLLOUT_PARENT";

/// Makes the kernel kill this process when its parent dies, if [`PARENT_VARIABLE`] names the
/// parent. Killing is safe, since every program may be killed at any time without losing confirmed
/// data; a parent that exits normally stops its children first.
pub fn end_with_parent() {
    let parent = std::env::var(PARENT_VARIABLE).ok();
    let parent = parent.and_then(|pid| Pid::from_raw(pid.parse().ok()?));
    // Descendants further down inherit the variable but have other parents.
    if parent.is_some() && parent == getppid() {
        // A failure only means that this process survives a killed parent.
        let _ = set_parent_process_death_signal(Some(Signal::KILL));
    }
}
