//! Events of the supervisor's loop.

use benchmark::attempt::AttemptId;
use proto::coordinator::{ClaimResponse, HeartbeatResponse, RegisterResponse};
use tokio::task;
use tonic::Status;

use super::deliver::Answer;
use crate::assets::ProvideError;
use crate::message::SlotEvent;

/// End of a slot's process.
#[derive(Debug)]
pub(crate) struct ProcessEnd {
    /// Description of the end, such as "exited with code 1"; it follows the words "the process".
    pub(crate) description: String,
    /// The last lines of the process's standard error, which the worker has relayed already.
    pub(crate) last_lines: Vec<String>,
}

impl ProcessEnd {
    /// Describes the end with the last lines, for readers who do not see the worker's log.
    pub(crate) fn with_last_lines(&self) -> String {
        match self.last_lines.is_empty() {
            true => self.description.clone(),
            false => {
                format!("{}; its last output: {}", self.description, self.last_lines.join(" | "))
            }
        }
    }
}

impl From<String> for ProcessEnd {
    fn from(description: String) -> Self {
        let last_lines = vec![];
        Self { description, last_lines }
    }
}

/// Identifies one process of a slot, which may have several in succession.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ProcessKey {
    /// Number of the slot, from 0.
    pub(crate) slot: usize,
    /// Number of the process within the slot, from 1.
    pub(crate) number: u64,
}

/// Event that the supervisor's loop handles.
#[derive(Debug)]
pub(crate) enum Event {
    /// The interval between checks for timeouts has passed.
    Tick,
    /// The coordinator answered the worker's registration.
    Registered(Result<RegisterResponse, Status>),
    /// The interval between heartbeats has passed.
    HeartbeatDue,
    Renewed(Result<HeartbeatResponse, Status>),
    Claimed {
        slot: usize,
        answer: Result<ClaimResponse, Status>,
    },
    /// The files of an attempt's task were fetched or could not be fetched.
    Provided {
        slot: usize,
        attempt: AttemptId,
        outcome: Result<(), ProvideError>,
    },
    /// The coordinator answered the report of a slot's rollout.
    Delivered {
        slot: usize,
        /// Campaign and rollout, for messages.
        label: String,
        answer: Answer,
    },
    Slot {
        key: ProcessKey,
        event: SlotEvent,
    },
    Ended {
        key: ProcessKey,
        end: ProcessEnd,
    },
    Panicked {
        task: task::Id,
        error: String,
    },
    /// Shutdown was requested. After the first request the worker drains; after the second it gives
    /// its rollouts back.
    Shutdown,
}
