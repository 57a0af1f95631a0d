//! States of a campaign, and the changes that an operator may make to them. Not responsible for
//! the states of single jobs (`lease`).

use std::ops::RangeInclusive;

use serde::Deserialize;

use crate::clock::UnixMillis;

/// The priorities that a campaign may have; 0 where nothing is said. The store's
/// CHECK constraint says the same.
pub const PRIORITIES: RangeInclusive<i32> = -100..=100;

/// State of a campaign, as its operator set it. The store's CHECK constraints say the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
pub enum CampaignState {
    /// Its jobs are leased.
    Running {
        /// Since it was created or last resumed.
        since: UnixMillis,
    },
    /// Nothing is leased; what was leased before may still be committed.
    Paused {
        /// Since when.
        since: UnixMillis,
    },
    /// Nothing is leased ever again, and leases were taken back. Its results
    /// stay. Final.
    Cancelled {
        /// Since when.
        since: UnixMillis,
    },
    /// Its rule was met: nothing is leased ever again, and leases were taken back.
    /// Its results stay. Final.
    Stopped {
        /// Since when.
        since: UnixMillis,
    },
}

/// A change that an operator asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Change {
    /// Lease nothing more until it is resumed.
    Pause,
    /// Go on.
    Resume,
    /// End it.
    Cancel,
}

/// A campaign that is cancelled or stopped was to become something else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EndedIsFinal;

impl CampaignState {
    /// The state after a change; the same state if it is there already.
    ///
    /// # Errors
    /// When the campaign is cancelled or stopped: that is final.
    pub fn after(self, change: Change, now: UnixMillis) -> Result<Self, EndedIsFinal> {
        match (self, change) {
            (CampaignState::Running { .. }, Change::Resume)
            | (CampaignState::Paused { .. }, Change::Pause)
            | (CampaignState::Cancelled { .. }, Change::Cancel) => Ok(self),
            (CampaignState::Cancelled { .. } | CampaignState::Stopped { .. }, _) => {
                Err(EndedIsFinal)
            }
            (_, Change::Resume) => Ok(CampaignState::Running { since: now }),
            (_, Change::Pause) => Ok(CampaignState::Paused { since: now }),
            (_, Change::Cancel) => Ok(CampaignState::Cancelled { since: now }),
        }
    }

    /// Whether its jobs may be leased.
    pub fn may_lease(self) -> bool {
        matches!(self, CampaignState::Running { .. })
    }

    /// Whether nothing more of it is ever leased.
    pub fn is_over(self) -> bool {
        matches!(
            self,
            CampaignState::Cancelled { .. } | CampaignState::Stopped { .. }
        )
    }

    /// Since when it is in this state.
    pub fn since(self) -> UnixMillis {
        match self {
            CampaignState::Running { since }
            | CampaignState::Paused { since }
            | CampaignState::Cancelled { since }
            | CampaignState::Stopped { since } => since,
        }
    }

    /// Its name in the store and to people.
    pub fn name(self) -> &'static str {
        match self {
            CampaignState::Running { .. } => "running",
            CampaignState::Paused { .. } => "paused",
            CampaignState::Cancelled { .. } => "cancelled",
            CampaignState::Stopped { .. } => "stopped",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const THEN: UnixMillis = UnixMillis(1);
    const NOW: UnixMillis = UnixMillis(2);

    #[test]
    fn a_cancelled_campaign_is_neither_paused_nor_resumed() {
        let cancelled = CampaignState::Cancelled { since: THEN };
        for change in [Change::Pause, Change::Resume] {
            assert_eq!(cancelled.after(change, NOW), Err(EndedIsFinal));
        }
        assert_eq!(cancelled.after(Change::Cancel, NOW), Ok(cancelled));
        assert!(!cancelled.may_lease());
    }

    #[test]
    fn a_stopped_campaign_stays_so_whatever_is_asked_for() {
        let stopped = CampaignState::Stopped { since: THEN };
        for change in [Change::Pause, Change::Resume, Change::Cancel] {
            assert_eq!(stopped.after(change, NOW), Err(EndedIsFinal));
        }
        assert!(!stopped.may_lease() && stopped.is_over());
    }

    #[test]
    fn what_is_so_already_keeps_its_instant() {
        let running = CampaignState::Running { since: THEN };
        assert_eq!(running.after(Change::Resume, NOW), Ok(running));
        let paused = CampaignState::Paused { since: NOW };
        assert_eq!(running.after(Change::Pause, NOW), Ok(paused));
        assert_eq!(paused.after(Change::Pause, UnixMillis(9)), Ok(paused));
    }

    #[test]
    fn states_read_back_under_their_names() {
        for state in [
            CampaignState::Running { since: THEN },
            CampaignState::Paused { since: THEN },
            CampaignState::Cancelled { since: THEN },
            CampaignState::Stopped { since: THEN },
        ] {
            let text = format!(r#"{{"is": "{}", "since": 1}}"#, state.name());
            let read: CampaignState = serde_json::from_str(&text).expect("a state");
            assert_eq!(read, state);
        }
    }
}
