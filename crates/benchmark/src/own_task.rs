//! Description of a task of LIBERO's family or of a suite file, part of every manifest row of the
//! task. A worker needs neither benchmark nor suite file: the row and the task's files suffice.

use serde::{Deserialize, Serialize};

use crate::variant_name::{MAX_CHANGE_BYTES, VariantName};

/// Highest number of a corruption of LIBERO-Plus.
const MAX_NOISE: u8 = 50;
/// Longest path of a task file in its folder, bytes.
const MAX_PATH_BYTES: usize = 255;

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
    /// Folder of the initial states; `None` for `folder`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub states_folder: Option<String>,
    /// Path of a BDDL file in the folder of `--sources` whose sentence, with its capital letters, is
    /// the prompt; `None` if the prompt is the row's instruction or that of `bddl`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sentence: Option<String>,
    pub start: Beginning,
    pub seed: u32,
    #[serde(default)]
    pub changes: Changes,
    /// Suite that is sent to the policy; empty if the rollout's id names it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub suite: String,
    /// Instruction that the row's instruction paraphrases; empty if it is the row's.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub instruction: String,
}

impl OwnTask {
    /// Checks a task that did not come from a suite file.
    pub(crate) fn check(&self) -> Result<(), InvalidField> {
        let required = [("folder", &self.folder), ("bddl", &self.bddl), ("states", &self.states)];
        let optional = [("states_folder", &self.states_folder), ("sentence", &self.sentence)];
        let optional =
            optional.into_iter().filter_map(|(field, path)| Some((field, path.as_ref()?)));
        for (field, path) in required.into_iter().chain(optional) {
            check_path(&format!("own.{field}"), path)?;
        }
        self.changes.check(&|field| format!("own.changes.{field}"))
    }
}

impl Changes {
    /// Checks the values; `path` returns the path of a field, for the error.
    pub(crate) fn check(&self, path: &dyn Fn(&str) -> String) -> Result<(), InvalidField> {
        let Changes { view, posture, noise, sha256 } = self;
        if let Some([horizontal, vertical, scale, pan, tilt]) = view {
            let angles = [horizontal, vertical, pan, tilt];
            if *scale == 0 || angles.into_iter().any(|angle| *angle >= 360) {
                let remedy = "write horizontal and vertical angle, distance, pan and tilt: angles \
                              of 0 to 359 degrees, and a distance above 0 per cent";
                return Err(invalid(&path("view"), &format!("{view:?}"), remedy));
            }
        }
        let is_angle = |angle: &f64| angle.abs() <= std::f64::consts::TAU;
        if let Some(posture) = posture
            && !posture.iter().all(is_angle)
        {
            let remedy = "write seven angles in rad, from -2π to 2π";
            return Err(invalid(&path("posture"), &format!("{posture:?}"), remedy));
        }
        if let Some(noise) = noise {
            let most = MAX_NOISE.into();
            check_range(&path("noise"), u32::from(*noise), 1, most)?;
        }
        let is_hex = |text: &String| {
            text.len() == 64 && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
        };
        if let Some(text) = sha256
            && !is_hex(text)
        {
            let remedy = "write the 64 digits that `cat BDDL STATES | sha256sum` prints for the \
                          task's two files";
            return Err(invalid(&path("sha256"), &quoted(text), remedy));
        }
        Ok(())
    }
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{field}` is {given}: {remedy}")]
pub struct InvalidField {
    pub field: String,
    pub given: String,
    pub remedy: String,
}

pub(crate) fn quoted(text: &str) -> String {
    format!("`{text}`")
}

pub(crate) fn invalid(field: &str, given: &str, remedy: &str) -> InvalidField {
    InvalidField { field: field.to_owned(), given: given.to_owned(), remedy: remedy.to_owned() }
}

/// Checks that a path stays in its folder, on every system, and is not too long.
pub(crate) fn check_path(field: &str, path: &str) -> Result<(), InvalidField> {
    let is_plain = |part: &str| !matches!(part, "" | "." | "..");
    let is_excluded = |letter: char| matches!(letter, '\\' | ':') || letter.is_control();
    if path.len() <= MAX_PATH_BYTES && path.split('/').all(is_plain) && !path.contains(is_excluded)
    {
        return Ok(());
    }
    Err(invalid(field, &quoted(path), "write a relative path with / and without . and .."))
}

pub(crate) fn check_range(
    field: &str,
    given: u32,
    least: u32,
    most: u32,
) -> Result<(), InvalidField> {
    match (least..=most).contains(&given) {
        true => Ok(()),
        false => {
            let remedy = format!("write {least} to {most}");
            Err(invalid(field, &given.to_string(), &remedy))
        }
    }
}

/// Checks the name of a benchmark, of one of its suites or of a simulator.
pub(crate) fn check_name(field: &str, name: &str) -> Result<(), InvalidField> {
    let remedy = format!(
        "write 1 to {MAX_CHANGE_BYTES} lower-case letters, digits and _, and another word than \
         `unperturbed`"
    );
    match VariantName::own(name) {
        Ok(_) => Ok(()),
        Err(_) => Err(invalid(field, &quoted(name), &remedy)),
    }
}
