//! Failpoints: places where tests can kill the process, before and after the commit of every
//! writing transaction, and where they can let a background task panic. Compiled only with debug
//! assertions; otherwise [`Failpoints`] is empty.

#[cfg(debug_assertions)]
use std::sync::atomic::{AtomicU32, Ordering};

/// Step of an operation that a writing transaction carries out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Step {
    /// Leases are restarted with their full duration when the coordinator starts.
    Start,
    /// A worker registers or signs off.
    Register,
    Claim,
    Heartbeat,
    /// An outcome is stored, or refused.
    Commit,
    /// An attempt ends without an outcome.
    Release,
    /// Expired leases are ended.
    Sweep,
    Artifact,
    CreateCampaign,
    /// Rows are added to a campaign.
    AppendRows,
    ImportCampaign,
    /// A campaign is paused, resumed, cancelled or altered.
    ChangeCampaign,
    DeleteCampaign,
    /// The removal of a deleted campaign's files is recorded as complete.
    FinishRemoval,
    /// An operator puts jobs into quarantine or takes them out.
    Quarantine,
    /// A campaign ends early.
    Stop,
}

/// Environment variable that names the failpoint, a [`Side`] and a [`Step`]: `Before:Commit` or
/// `After:Commit`, or `After:Commit:n` for the n-th time that it is reached.
pub const FAILPOINT_VARIABLE: &str = "COORDINATOR_DIE_AT";

/// Environment variable that names a background task, such as `the sweep`, that is to panic when it
/// starts.
pub const PANIC_VARIABLE: &str = "COORDINATOR_PANIC_IN";

/// Panics if [`PANIC_VARIABLE`] names this task.
#[cfg(debug_assertions)]
pub(crate) fn panic_in(task: &str) {
    let named = std::env::var(PANIC_VARIABLE);
    assert!(named.as_deref() != Ok(task), "failpoint: {task} ends here");
}

#[cfg(not(debug_assertions))]
pub(crate) fn panic_in(_: &str) {}

/// The failpoint of this process, if it has one.
#[derive(Debug, Default)]
pub(crate) struct Failpoints {
    #[cfg(debug_assertions)]
    armed: Option<(String, AtomicU32)>,
}

/// Side of a transaction's commit on which a failpoint lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Everything is written but not committed.
    Before,
    /// The transaction is committed but no answer was sent.
    After,
}

impl Step {
    pub const ALL: [Step; 16] = [
        Step::Start,
        Step::Register,
        Step::Claim,
        Step::Heartbeat,
        Step::Commit,
        Step::Release,
        Step::Sweep,
        Step::Artifact,
        Step::CreateCampaign,
        Step::AppendRows,
        Step::ImportCampaign,
        Step::ChangeCampaign,
        Step::DeleteCampaign,
        Step::FinishRemoval,
        Step::Quarantine,
        Step::Stop,
    ];
}

#[cfg(not(debug_assertions))]
impl Failpoints {
    pub(crate) fn from_environment() -> Failpoints {
        Failpoints::default()
    }

    pub(crate) fn reach(&self, _: Side, _: Step) {}
}

#[cfg(debug_assertions)]
impl Failpoints {
    pub(crate) fn from_environment() -> Failpoints {
        let armed = std::env::var(FAILPOINT_VARIABLE).ok().map(|text| {
            let (point, countdown) = match text.rsplit_once(':') {
                Some((point, times)) if times.parse::<u32>().is_ok() => {
                    (point.to_owned(), times.parse().unwrap_or(1))
                }
                _ => (text, 1),
            };
            (point, AtomicU32::new(countdown))
        });
        Failpoints { armed }
    }

    /// Kills the process like `kill -9` if the environment names this failpoint.
    pub(crate) fn reach(&self, side: Side, step: Step) {
        let Some((point, countdown)) = &self.armed else {
            return;
        };
        let is_here = *point == format!("{side:?}:{step:?}");
        if is_here && countdown.fetch_sub(1, Ordering::SeqCst) == 1 {
            eprintln!("failpoint {point}: this process ends here");
            std::process::abort();
        }
    }
}
