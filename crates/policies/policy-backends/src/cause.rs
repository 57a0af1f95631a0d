//! Reasons problem a policy server is out.

use std::fmt;

use crate::told::told;

/// Reason problem a server is out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The connection failed.
    Unreachable(String),
    /// The settings are wrong, for example the address of another server.
    Misplaced(String),
    /// The server rejected the gateway's credentials.
    Distrust(String),
    /// The description differs from the earlier one, or from that of the other replicas.
    Disagrees(String),
    /// The server did not answer in time.
    Silent,
    /// Different tasks got the same error.
    Repeats(String),
    /// The server's process cannot recover from an error.
    Broken(String),
}

impl Cause {
    /// Returns the cause with its text shortened by [`told`], which bounds memory and log entries.
    pub fn told(self) -> Self {
        match self {
            Self::Unreachable(problem) => Self::Unreachable(told(&problem)),
            Self::Misplaced(problem) => Self::Misplaced(told(&problem)),
            Self::Distrust(error) => Self::Distrust(told(&error)),
            Self::Disagrees(difference) => Self::Disagrees(told(&difference)),
            Self::Silent => Self::Silent,
            Self::Repeats(error) => Self::Repeats(told(&error)),
            Self::Broken(error) => Self::Broken(told(&error)),
        }
    }

    /// Returns true if only an answered query shows that the server has recovered.
    pub fn needs_query(&self) -> bool {
        matches!(self, Self::Silent | Self::Repeats(_) | Self::Broken(_))
    }
}

impl fmt::Display for Cause {
    /// Writes the reason; reads after the server's name.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreachable(problem) | Self::Misplaced(problem) => {
                write!(f, "cannot be reached: {problem}")
            }
            Self::Distrust(error) => write!(f, "cannot be queried: {error}"),
            Self::Disagrees(difference) => f.write_str(difference),
            Self::Silent => f.write_str("did not answer in time"),
            Self::Repeats(error) => write!(f, "gave different tasks the same error: {error}"),
            Self::Broken(error) => write!(
                f,
                "gave an error from which its process does not recover (restart it): {error}"
            ),
        }
    }
}
