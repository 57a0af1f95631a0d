//! States of a campaign, and the changes that an operator may make to them. States of single jobs
//! are in `lease`.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use crate::clock::UnixMillis;

/// Valid priorities of a campaign; the default is 0. Must match the store's CHECK constraint.
pub const PRIORITIES: RangeInclusive<i32> = -100..=100;

/// State of a campaign. Must match the store's CHECK constraints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
pub enum CampaignState {
    /// Jobs of the campaign are leased.
    Running {
        /// Instant at which the campaign was created or last resumed.
        since: UnixMillis,
    },
    /// Leasing is suspended; attempts in progress may still be committed.
    Paused { since: UnixMillis },
    /// Cancelled by an operator: nothing is leased again, and leases were revoked. Results are
    /// kept. Final.
    Cancelled { since: UnixMillis },
    /// Stopped because its rule was met: nothing is leased again, and leases were revoked. Results
    /// are kept. Final.
    Stopped { since: UnixMillis },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Change {
    /// Suspend leasing until the campaign is resumed.
    Pause,
    Resume,
    Cancel,
}

/// Error of a change to a campaign that is cancelled or stopped, which is final.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EndedIsFinal;

impl CampaignState {
    /// Returns the state after a change, which may be the same state.
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

    /// Returns true if jobs of the campaign may be leased.
    pub fn may_lease(self) -> bool {
        matches!(self, CampaignState::Running { .. })
    }

    pub fn is_over(self) -> bool {
        matches!(self, CampaignState::Cancelled { .. } | CampaignState::Stopped { .. })
    }

    pub fn since(self) -> UnixMillis {
        match self {
            CampaignState::Running { since }
            | CampaignState::Paused { since }
            | CampaignState::Cancelled { since }
            | CampaignState::Stopped { since } => since,
        }
    }

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
    fn a_stopped_campaign_rejects_every_change() {
        let stopped = CampaignState::Stopped { since: THEN };
        for change in [Change::Pause, Change::Resume, Change::Cancel] {
            assert_eq!(stopped.after(change, NOW), Err(EndedIsFinal));
        }
        assert!(!stopped.may_lease() && stopped.is_over());
    }

    #[test]
    fn repeating_the_current_state_keeps_its_instant() {
        let running = CampaignState::Running { since: THEN };
        assert_eq!(running.after(Change::Resume, NOW), Ok(running));
        let paused = CampaignState::Paused { since: NOW };
        assert_eq!(running.after(Change::Pause, NOW), Ok(paused));
        assert_eq!(paused.after(Change::Pause, UnixMillis(9)), Ok(paused));
    }

    #[test]
    fn states_round_trip_through_their_names() {
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
