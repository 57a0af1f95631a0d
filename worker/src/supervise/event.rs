//! Events of a worker.

use proto::coordinator::{ClaimResponse, HeartbeatResponse, RegisterResponse};
use rollout_types::AttemptId;
use tokio::task;
use tonic::Status;

use super::deliver::Answer;
use crate::message::SlotEvent;

/// End of a slot's process. Reads after its name.
#[derive(Debug)]
pub(crate) struct ProcessEnd {
    /// "was killed by signal 9", say.
    pub(crate) how: String,
    /// The last lines that it printed, which this worker has passed on already.
    pub(crate) last_words: Vec<String>,
}

impl ProcessEnd {
    /// For those who have not seen what it printed.
    pub(crate) fn with_last_words(&self) -> String {
        match self.last_words.is_empty() {
            true => self.how.clone(),
            false => format!(
                "{}; its last words: {}",
                self.how,
                self.last_words.join(" | ")
            ),
        }
    }
}

impl From<String> for ProcessEnd {
    fn from(how: String) -> Self {
        let last_words = vec![];
        Self { how, last_words }
    }
}

/// One life of one slot's process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ProcessKey {
    /// Number of the slot, from 0.
    pub(crate) slot: usize,
    /// Number of the process within the slot, from 1.
    pub(crate) life: u64,
}

/// Event of a worker.
#[derive(Debug)]
pub(crate) enum Event {
    /// Time has passed.
    Tick,
    /// The coordinator answered the worker's registration.
    Registered(Result<RegisterResponse, Status>),
    /// Leases are to be renewed.
    HeartbeatDue,
    /// The coordinator answered a heartbeat.
    Renewed(Result<HeartbeatResponse, Status>),
    /// The coordinator answered a slot's claim.
    Claimed {
        slot: usize,
        answer: Result<ClaimResponse, Status>,
    },
    /// The files of an attempt's task are there, or cannot be had. The error reads
    /// after "failed to …".
    Provided {
        slot: usize,
        attempt: AttemptId,
        outcome: Result<(), String>,
    },
    /// The coordinator knows how a slot's rollout ended.
    Delivered {
        slot: usize,
        /// The rollout that ended, and its campaign.
        label: String,
        answer: Answer,
    },
    /// A slot's process said something.
    Slot { key: ProcessKey, event: SlotEvent },
    /// A slot's process ended.
    Ended { key: ProcessKey, end: ProcessEnd },
    /// A task of this program panicked.
    Panicked { task: task::Id, error: String },
    /// A request to end: the first one drains, the second gives rollouts back.
    Shutdown,
}
