//! The policies that run inside the gateway, by name. Responsible for what
//! they are and for starting one per session; sessions themselves, retries and
//! the checks of their answers are the gateway's.

use std::{fmt, str::FromStr};

use proto::policy::{DescribeResponse, ResetRequest};
use thiserror::Error;

pub mod expert;
pub(crate) mod instance;
pub mod noop;

pub use instance::{Action, BuiltinPolicy};

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
