//! The policies that run inside the gateway, by name. Responsible for what
//! they are and for starting one per session; sessions themselves, retries and
//! the checks of their answers are the gateway's.

use std::{fmt, str::FromStr};

use proto::policy::{DescribeResponse, Observation, ResetRequest};
use thiserror::Error;

pub mod expert;
pub mod noop;

/// One control step's action: end-effector translation (3) and rotation (3),
/// gripper (-1 open, 1 closed), each in -1..1.
pub type Action = [f32; 7];

/// A policy that runs inside the gateway. One instance per session.
///
/// It runs on the gateway's own threads, so an answer should take well under a
/// millisecond.
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

/// Which built-in policy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Builtin {
    /// Stands still: see [`noop`].
    Noop,
    /// Picks and places, by looking at the simulator's state: see [`expert`].
    Expert,
}

impl Builtin {
    /// Every built-in policy.
    pub const ALL: [Self; 2] = [Self::Noop, Self::Expert];

    /// The name after `builtin:`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Noop => "noop",
            Self::Expert => "expert",
        }
    }

    /// What the policy is and wants to see.
    pub fn describe(self) -> DescribeResponse {
        match self {
            Self::Noop => noop::describe(),
            Self::Expert => expert::describe(),
        }
    }

    /// Starts an episode.
    pub fn start(self, reset: &ResetRequest) -> Box<dyn BuiltinPolicy> {
        match self {
            Self::Noop => Box::new(noop::Noop),
            Self::Expert => Box::new(expert::Expert::new(reset)),
        }
    }
}

impl fmt::Display for Builtin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "builtin:{}", self.name())
    }
}

impl FromStr for Builtin {
    type Err = UnknownBuiltin;

    fn from_str(name: &str) -> Result<Self, UnknownBuiltin> {
        Self::ALL
            .into_iter()
            .find(|builtin| builtin.name() == name)
            .ok_or_else(|| UnknownBuiltin {
                name: name.to_owned(),
            })
    }
}

/// A built-in policy that does not exist.
#[derive(Debug, Error)]
#[error("find the built-in policy {name:?}: there are {}", Builtin::ALL.map(Builtin::name).join(" and "))]
pub struct UnknownBuiltin {
    /// The name asked for.
    pub name: String,
}
