//! Reasons why a policy server is out of service.

use std::fmt;

use crate::shorten::shorten;

/// Reason why a server is out of service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The connection failed.
    Unreachable(String),
    /// The settings are wrong, for example the address of another server.
    Misconfigured(String),
    /// The server rejected the gateway's credentials.
    TokenRejected(String),
    /// The server's description differs from its earlier description, or from that of the other
    /// replicas.
    DescriptionDiffers(String),
    /// The server did not answer in time.
    NoAnswer,
    /// Different tasks got the same error.
    RepeatedError(String),
    /// The server's process cannot recover from an error.
    Broken(String),
}

impl Cause {
    /// Returns the cause with its text shortened by [`shorten`], which bounds memory and log
    /// entries.
    pub fn shortened(self) -> Self {
        match self {
            Self::Unreachable(problem) => Self::Unreachable(shorten(&problem)),
            Self::Misconfigured(problem) => Self::Misconfigured(shorten(&problem)),
            Self::TokenRejected(error) => Self::TokenRejected(shorten(&error)),
            Self::DescriptionDiffers(difference) => Self::DescriptionDiffers(shorten(&difference)),
            Self::NoAnswer => Self::NoAnswer,
            Self::RepeatedError(error) => Self::RepeatedError(shorten(&error)),
            Self::Broken(error) => Self::Broken(shorten(&error)),
        }
    }

    /// Returns true if the server counts as recovered only after an answered query or, if it
    /// repeated an error, also after a different error.
    pub fn needs_query(&self) -> bool {
        matches!(self, Self::NoAnswer | Self::RepeatedError(_) | Self::Broken(_))
    }
}

impl fmt::Display for Cause {
    /// Writes the reason as a predicate, whose subject is the server's name.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreachable(problem) | Self::Misconfigured(problem) => {
                write!(f, "cannot be reached: {problem}")
            }
            Self::TokenRejected(error) => write!(f, "cannot be queried: {error}"),
            Self::DescriptionDiffers(difference) => f.write_str(difference),
            Self::NoAnswer => f.write_str("did not answer in time"),
            Self::RepeatedError(error) => write!(f, "gave different tasks the same error: {error}"),
            Self::Broken(error) => write!(
                f,
                "gave an error from which its process does not recover (restart it): {error}"
            ),
        }
    }
}
