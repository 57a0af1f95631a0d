//! Policies that run inside the gateway. Lists them and starts an instance per session; the
//! gateway manages sessions and retries, and checks the answers.

use std::{fmt, str::FromStr};

use thiserror::Error;

pub(crate) mod backend;
pub mod expert;
pub(crate) mod instance;
pub mod noop;
pub mod student;

pub(crate) use instance::Policy;

pub use instance::{Action, BuiltinPolicy};
pub use student::Weights;

/// Built-in policy by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Builtin {
    /// Does nothing: see [`noop`].
    Noop,
    /// Scripted pick-and-place from the simulator's state: see [`expert`].
    Expert,
    /// The expert, with frames of both cameras in its observations, which it ignores: for recordings.
    ExpertWithFrames,
    /// Learned policy with cameras and instruction: see [`student`].
    Student(Weights),
}

impl Builtin {
    /// Every built-in policy.
    pub const ALL: [Self; 5] = [
        Self::Noop,
        Self::Expert,
        Self::ExpertWithFrames,
        Self::Student(Weights::Libero),
        Self::Student(Weights::Boxes),
    ];

    /// Returns the name after `builtin:`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Noop => "noop",
            Self::Expert => "expert",
            Self::ExpertWithFrames => "expert-with-frames",
            Self::Student(weights) => weights.name(),
        }
    }

    /// Returns the policy's description and constructor.
    pub(crate) fn policy(self) -> Policy {
        match self {
            Self::Noop => {
                Policy { described: noop::describe(), start: Box::new(|_| Box::new(noop::Noop)) }
            }
            Self::Expert | Self::ExpertWithFrames => Policy {
                described: match self {
                    Self::ExpertWithFrames => expert::describe_with_frames(),
                    _ => expert::describe(),
                },
                start: Box::new(|_| Box::new(::expert::Expert::default())),
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

    fn from_str(name: &str) -> Result<Self, UnknownBuiltin> {
        Self::ALL
            .into_iter()
            .find(|builtin| builtin.name() == name)
            .ok_or_else(|| UnknownBuiltin { name: name.to_owned() })
    }
}

/// The built-in policy does not exist.
#[derive(Debug, Error)]
#[error("find the built-in policy {name:?}: there are {}", Builtin::ALL.map(Builtin::name).join(", "))]
pub struct UnknownBuiltin {
    pub name: String,
}
