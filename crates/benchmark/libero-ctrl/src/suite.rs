//! The four LIBERO suites that the protocol evaluates, and their forty tasks in the
//! benchmark's own order. Scenes and goals are in the tasks' BDDL files.

use std::fmt;
use std::str::FromStr;

use crate::names::{UnknownName, serde_as_text};
use crate::tasks::TASK_NAMES;

pub const TASKS_PER_SUITE: u8 = 10;
pub const INIT_STATES_PER_TASK: u16 = 50;

/// A task suite of LIBERO.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Suite {
    /// `libero_spatial`: one object, ten places.
    Spatial,
    /// `libero_object`: ten objects, one place.
    Object,
    /// `libero_goal`: one scene, ten goals.
    Goal,
    /// `libero_10`, the paper's Long: ten two-stage tasks.
    Long,
    /// The tasks of a suite file, by their position in the file. This is no suite of LIBERO, so
    /// that neither [`Self::ALL`] nor the parser includes it.
    Own,
}

impl Suite {
    /// LIBERO's suites, in the reference's order.
    pub const ALL: [Self; 4] = [Self::Spatial, Self::Object, Self::Goal, Self::Long];

    /// Returns LIBERO's name: `libero_spatial`, …, `libero_10`; `own` for [`Self::Own`].
    pub const fn name(self) -> &'static str {
        match self {
            Self::Spatial => "libero_spatial",
            Self::Object => "libero_object",
            Self::Goal => "libero_goal",
            Self::Long => "libero_10",
            Self::Own => "own",
        }
    }

    /// Returns the name in rollout ids: `spatial`, `object`, `goal`, `long`, `own`.
    pub const fn short_name(self) -> &'static str {
        match self {
            Self::Spatial => "spatial",
            Self::Object => "object",
            Self::Goal => "goal",
            Self::Long => "long",
            Self::Own => "own",
        }
    }

    /// Returns the suite's tasks in the benchmark's order; none for [`Self::Own`], whose tasks only
    /// a suite file lists.
    pub fn tasks(self) -> impl Iterator<Item = TaskRef> {
        let count = match self {
            Self::Own => 0,
            _ => TASKS_PER_SUITE,
        };
        (0..count).map(move |index| TaskRef { suite: self, index })
    }

    /// Returns the position in [`Self::ALL`]; `None` for [`Self::Own`].
    pub(crate) const fn ordinal(self) -> Option<usize> {
        match self {
            Self::Own => None,
            suite => Some(suite as usize),
        }
    }
}

impl fmt::Display for Suite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Suite {
    type Err = UnknownName;

    /// Parses either name: `libero_10` and `long` are the same suite.
    fn from_str(text: &str) -> Result<Self, UnknownName> {
        Self::ALL
            .into_iter()
            .find(|suite| suite.name() == text || suite.short_name() == text)
            .ok_or_else(|| UnknownName::new("suite", text, &Self::ALL.map(Self::name)))
    }
}

serde_as_text!(Suite);

/// A task: a suite and an index in it. Displays as `libero_goal/3`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TaskRef {
    suite: Suite,
    index: u8,
}

impl TaskRef {
    pub fn new(suite: Suite, index: u32) -> Result<Self, UnknownName> {
        match u8::try_from(index) {
            Ok(index) if index < TASKS_PER_SUITE && suite != Suite::Own => {
                Ok(Self { suite, index })
            }
            _ => Err(unknown_task(&format!("{suite}/{index}"), suite.name())),
        }
    }

    /// Returns a task of a suite file, by its position in the file.
    pub const fn own(index: u8) -> Self {
        Self { suite: Suite::Own, index }
    }

    /// Returns the forty tasks by suite.
    pub fn all() -> impl Iterator<Item = Self> {
        Suite::ALL.into_iter().flat_map(Suite::tasks)
    }

    pub const fn suite(self) -> Suite {
        self.suite
    }

    /// Returns the index in the suite, 0 to 9, in the benchmark's order, or the position in a suite
    /// file.
    pub const fn index(self) -> u8 {
        self.index
    }

    /// Returns the stem of the task's files: `NAME.bddl`, `NAME.pruned_init`; empty for a task of a
    /// suite file.
    pub fn name(self) -> &'static str {
        let names = self.suite.ordinal().map(|suite| TASK_NAMES[suite]);
        names.map_or("", |names| names[usize::from(self.index)])
    }

    /// Returns the canonical instruction, which LIBERO derives from the file's name; empty for a
    /// task of a suite file.
    pub fn instruction(self) -> String {
        instruction_of_name(self.name())
    }
}

/// Returns the instruction that LIBERO derives from the name of a task's files: its words, without
/// the scene prefix of names such as those in `libero_10`.
pub(crate) fn instruction_of_name(name: &str) -> String {
    let words = match name.split_once("_SCENE") {
        Some((_, rest)) => rest.split_once('_').map_or(rest, |(_, words)| words),
        None => name,
    };
    words.replace('_', " ")
}

impl fmt::Display for TaskRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.suite, self.index)
    }
}

impl FromStr for TaskRef {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let (suite, index) = text.split_once('/').ok_or_else(|| unknown_task(text, "SUITE"))?;
        let suite: Suite = suite.parse()?;
        let index = index.parse().map_err(|_| unknown_task(text, suite.name()))?;
        Self::new(suite, index)
    }
}

serde_as_text!(TaskRef);

fn unknown_task(given: &str, suite: &str) -> UnknownName {
    let valid = format!("{suite}/0 to {suite}/9");
    UnknownName::new("task", given, &[&valid])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forty_tasks_are_parsed_from_their_text() {
        let tasks: Vec<TaskRef> = TaskRef::all().collect();
        assert_eq!(tasks.len(), 40);
        for task in tasks {
            assert_eq!(task.to_string().parse(), Ok(task));
        }
        assert_eq!("long/3".parse::<TaskRef>(), "libero_10/3".parse());
    }

    #[test]
    fn instruction_is_the_file_name_without_its_scene() {
        let instruction = |task: &str| task.parse::<TaskRef>().expect("a task").instruction();
        assert_eq!(instruction("goal/7"), "turn on the stove");
        assert_eq!(instruction("libero_10/2"), "turn on the stove and put the moka pot on it");
        assert_eq!(
            instruction("libero_10/5"),
            "pick up the book and place it in the back compartment of the caddy"
        );
    }

    #[test]
    fn the_error_for_an_unknown_name_lists_the_valid_ones() {
        let error = |task: &str| task.parse::<TaskRef>().expect_err("no task").to_string();
        assert_eq!(
            error("libero_goat/3"),
            "read suite `libero_goat`: valid are libero_spatial, libero_object, \
             libero_goal, libero_10"
        );
        assert_eq!(
            error("libero_goal/10"),
            "read task `libero_goal/10`: valid are libero_goal/0 to libero_goal/9"
        );
        assert_eq!(error("libero_goal"), "read task `libero_goal`: valid are SUITE/0 to SUITE/9");
    }
}
