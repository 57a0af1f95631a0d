//! Interface between the gateway and every built-in policy.

use proto::policy::{DescribeResponse, Observation, ResetRequest};

/// One control step's action: end-effector translation (3) and rotation (3),
/// gripper (-1 open, 1 closed), each in -1..1.
pub type Action = [f32; 7];

/// A policy that runs inside the gateway.
pub(crate) struct Policy {
    /// Description of the policy and of its inputs.
    pub(crate) described: DescribeResponse,
    pub(crate) start: Start,
}

/// Starts an episode.
type Start = Box<dyn Fn(&ResetRequest) -> Box<dyn BuiltinPolicy> + Send + Sync>;

/// One session of it.
///
/// It runs aside from the gateway's own threads: an answer may take some
/// milliseconds.
pub trait BuiltinPolicy: Send {
    /// Answers one observation. Called once per query index: the gateway
    /// answers retries itself. With a policy that declares itself stateful,
    /// queries come in the order 0, 1, 2, ….
    ///
    /// # Errors
    /// In words, when the observation lacks what the policy asked for or shows
    /// a scene that it cannot read.
    fn infer(&mut self, query_index: u32, observation: &Observation)
    -> Result<Vec<Action>, String>;
}
