//! Description of a suite file's task, part of every manifest row of the task. A worker needs no
//! suite file: the row and the task's files suffice.

use serde::{Deserialize, Serialize};

/// State of the environment at the start of a rollout, before the settling steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Beginning {
    /// The initial state, set after a reset; the controllers keep the state of the reset.
    InitialState,
    /// A reset without setting an initial state.
    Reset,
}

impl Beginning {
    pub const fn name(self) -> &'static str {
        match self {
            Self::InitialState => "initial-state",
            Self::Reset => "reset",
        }
    }
}

/// Settings of a task that differ from LIBERO's.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Changes {
    /// Camera pose as LIBERO-Plus' five numbers: horizontal and vertical angle, distance in per
    /// cent of LIBERO's, pan and tilt; angles in degrees. `None` for LIBERO's pose.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view: Option<[u16; 5]>,
    /// Angles of the arm's joints at the reset, rad; `None` for LIBERO's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub posture: Option<[f64; 7]>,
    /// Number of a corruption of LIBERO-Plus, 1 to 50; `None` for unchanged pictures.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<u8>,
    /// SHA-256 of the BDDL file followed by the states, hex; `None` if the contents of the files
    /// are not checked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sha256: Option<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnTask {
    /// Folder of the task files, relative to the folder of a worker's option `--sources`.
    pub folder: String,
    /// Path of the BDDL file, relative to `folder`.
    pub bddl: String,
    /// Path of the initial states, relative to `folder`.
    pub states: String,
    pub start: Beginning,
    pub seed: u32,
    #[serde(default)]
    pub changes: Changes,
}

impl OwnTask {
    pub(crate) fn path_outside(&self) -> Option<&str> {
        let mut paths = [&self.folder, &self.bddl, &self.states].into_iter();
        paths.find(|path| !stays_inside(path)).map(String::as_str)
    }
}

/// Longest path of a task file in its folder, bytes.
const MAX_PATH_BYTES: usize = 255;

/// Returns true if a path stays in its folder, on every system, and has at most
/// [`MAX_PATH_BYTES`] bytes.
pub(crate) fn stays_inside(path: &str) -> bool {
    let is_plain = |part: &str| !matches!(part, "" | "." | "..");
    let is_excluded = |letter: char| matches!(letter, '\\' | ':') || letter.is_control();
    path.len() <= MAX_PATH_BYTES && path.split('/').all(is_plain) && !path.contains(is_excluded)
}
