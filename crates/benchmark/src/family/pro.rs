//! LIBERO-PRO: the tasks of LIBERO's four suites under four kinds of change, with fifty
//! initial states each. Its sixteen suites use LIBERO's file names.

use std::fmt;
use std::str::FromStr;

use crate::{Suite, UnknownName};

/// Number of initial states of a task.
pub const STATES: u16 = 50;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// A different sentence, in the BDDL file.
    Language,
    /// Objects with different colours and sizes.
    Object,
    /// Objects with swapped positions.
    Position,
    /// A different goal.
    Task,
}

impl Kind {
    pub const ALL: [Self; 4] = [Self::Language, Self::Object, Self::Position, Self::Task];

    /// Returns the ending of the suite's name, also used in rollout ids.
    pub(crate) const fn ending(self) -> &'static str {
        match self {
            Self::Language => "lan",
            Self::Object => "object",
            Self::Position => "swap",
            Self::Task => "task",
        }
    }
}

/// Displays as LIBERO-PRO's name, such as `libero_goal_swap`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ProSuite {
    pub suite: Suite,
    pub kind: Kind,
}

impl ProSuite {
    pub fn all() -> impl Iterator<Item = Self> {
        let changed = |suite| Kind::ALL.into_iter().map(move |kind| Self { suite, kind });
        Suite::ALL.into_iter().flat_map(changed)
    }
}

impl fmt::Display for ProSuite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}_{}", self.suite, self.kind.ending())
    }
}

impl FromStr for ProSuite {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        Self::all().find(|suite| suite.to_string() == text).ok_or_else(|| UnknownName {
            kind: "suite of LIBERO-PRO",
            given: text.to_owned(),
            valid: "libero_spatial, libero_object, libero_goal or libero_10, followed by _lan, \
                        _object, _swap or _task"
                .to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_suites_are_parsed_from_their_names() {
        let suites: Vec<ProSuite> = ProSuite::all().collect();
        assert_eq!(suites.len(), 16);
        for suite in suites {
            assert_eq!(suite.to_string().parse(), Ok(suite));
        }
        // The files of `env` suites are not published.
        let error = "libero_goal_env".parse::<ProSuite>().unwrap_err();
        assert!(error.to_string().contains("_swap"), "{error}");
    }
}
