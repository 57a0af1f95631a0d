//! The policies that run inside the gateway. Responsible for what they are and for
//! starting one per session; sessions themselves, retries and the checks of their
//! answers are the gateway's.

use std::{fmt, str::FromStr};

use thiserror::Error;

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
    /// Stands still: see [`noop`].
    Noop,
    /// Picks and places, by looking at the simulator's state: see [`expert`].
    Expert,
    /// Looks, reads and acts as it has learned: see [`student`].
    Student(Weights),
}

impl Builtin {
    /// Every built-in policy.
    pub const ALL: [Self; 5] = [
        Self::Noop,
        Self::Expert,
        Self::Student(Weights::Libero),
        Self::Student(Weights::Boxes),
        Self::Student(Weights::BoxesRandomised),
    ];

    /// The name after `builtin:`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Noop => "noop",
            Self::Expert => "expert",
            Self::Student(weights) => weights.name(),
        }
    }

    /// The policy itself.
    pub(crate) fn policy(self) -> Policy {
        match self {
            Self::Noop => Policy {
                described: noop::describe(),
                start: Box::new(|_| Box::new(noop::Noop)),
            },
            Self::Expert => Policy {
                described: expert::describe(),
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
            .ok_or_else(|| UnknownBuiltin {
                name: name.to_owned(),
            })
    }
}

/// A built-in policy that does not exist.
#[derive(Debug, Error)]
#[error("find the built-in policy {name:?}: there are {}", Builtin::ALL.map(Builtin::name).join(", "))]
pub struct UnknownBuiltin {
    /// The name asked for.
    pub name: String,
}
