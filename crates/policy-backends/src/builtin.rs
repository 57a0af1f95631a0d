//! Policies that run inside the gateway. Lists them and starts an instance per session; the
//! gateway manages sessions and retries, and checks the answers.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use proto::policy::{DescribeResponse, Observation, ResetRequest};
use thiserror::Error;
use transport::Access;

use crate::backend::Backend;
use crate::spec::{Kind, OwnError, Specified};

pub(crate) mod backend;
pub mod expert;
pub mod noop;
pub mod student;

pub use builtin_policies::expert::Action;
pub use student::Weights;

pub(crate) const KIND: Kind =
    Kind::new::<Builtin>(&["builtin"], "builtin:NAME (noop, expert, student, student-boxes)");

pub(crate) struct Policy {
    pub(crate) described: DescribeResponse,
    pub(crate) start: Start,
}

type Start = Box<dyn Fn(&ResetRequest) -> Box<dyn BuiltinPolicy> + Send + Sync>;

/// Instance of a built-in policy for one session.
///
/// Runs on a blocking thread, because an answer may take some milliseconds.
pub trait BuiltinPolicy: Send {
    /// Answers one observation. Called once per query index: the gateway
    /// answers retries itself. With a policy that declares itself stateful,
    /// queries come in the order 0, 1, 2, ….
    ///
    /// # Errors
    /// If the observation lacks a requested input or shows a scene that the policy cannot handle;
    /// the text names the input or the fault of the scene.
    fn infer(&mut self, query_index: u32, observation: &Observation)
    -> Result<Vec<Action>, String>;
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Builtin {
    Noop,
    Expert,
    Student(Weights),
}

impl Builtin {
    pub const ALL: [Self; 4] =
        [Self::Noop, Self::Expert, Self::Student(Weights::Libero), Self::Student(Weights::Boxes)];

    pub fn name(self) -> &'static str {
        match self {
            Self::Noop => "noop",
            Self::Expert => "expert",
            Self::Student(weights) => weights.name(),
        }
    }

    pub(crate) fn policy(self) -> Policy {
        match self {
            Self::Noop => {
                Policy { described: noop::describe(), start: Box::new(|_| Box::new(noop::Noop)) }
            }
            Self::Expert => Policy {
                described: expert::describe(),
                start: Box::new(|_| Box::new(builtin_policies::expert::Expert::default())),
            },
            Self::Student(weights) => {
                let checkpoint = format!("{self} {}", env!("CARGO_PKG_VERSION"));
                student::shipped_policy(weights, checkpoint)
            }
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

    fn from_str(text: &str) -> Result<Self, UnknownBuiltin> {
        let name = text.strip_prefix("builtin:").unwrap_or(text);
        Self::ALL
            .into_iter()
            .find(|builtin| builtin.name() == name)
            .ok_or_else(|| UnknownBuiltin { name: name.to_owned() })
    }
}

impl Specified for Builtin {
    fn open(&self, _: &Access) -> Result<Arc<dyn Backend>, OwnError> {
        Ok(Arc::new(backend::BuiltinBackend::new(self.to_string(), self.policy())))
    }
}

#[derive(Debug, Error)]
#[error("find the built-in policy {name:?}: there are {}", Builtin::ALL.map(Builtin::name).join(", "))]
pub struct UnknownBuiltin {
    pub name: String,
}
