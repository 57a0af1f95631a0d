//! Interface between the gateway and the built-in policies.

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

/// Constructor of an episode's instance.
type Start = Box<dyn Fn(&ResetRequest) -> Box<dyn BuiltinPolicy> + Send + Sync>;

/// Instance of a built-in policy for one session.
///
/// Runs on a blocking thread, because an answer may take some milliseconds.
pub trait BuiltinPolicy: Send {
    /// Answers one observation. Called once per query index: the gateway answers retries itself.
    /// With a policy that declares itself stateful, queries come in the order 0, 1, 2, …. The error
    /// names the missing input or the fault of the scene.
    fn infer(&mut self, query_index: u32, observation: &Observation)
    -> Result<Vec<Action>, String>;
}
