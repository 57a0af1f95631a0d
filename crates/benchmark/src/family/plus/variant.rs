//! Variants: their names, and the benchmark's files for each name.

use std::fmt;
use std::str::FromStr;

use crate::{Suite, TaskRef, UnknownName};

use super::camera::View;
use super::start::ROBOTS;

/// Number of picture corruptions: five kinds of ten severities.
const CORRUPTIONS: u8 = 50;
const SENTENCES: u8 = 50;

/// Dimension of robustness, by which LIBERO-Plus groups its variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Dimension {
    /// Textures of table, floor and walls.
    Background,
    /// Posture of the arm at the reset.
    Robot,
    /// Pose of `agentview`.
    Camera,
    Language,
    /// Corruption of `agentview`'s pictures.
    Noise,
    /// Positions of the objects, and additional objects.
    Layout,
    Light,
}

impl Dimension {
    /// All dimensions, in the order of the benchmark's table.
    pub const ALL: [Self; 7] = [
        Self::Background,
        Self::Robot,
        Self::Camera,
        Self::Language,
        Self::Noise,
        Self::Layout,
        Self::Light,
    ];

    /// Returns the name on the command line: `background`, `robot`, …
    pub const fn name(self) -> &'static str {
        match self {
            Self::Background => "background",
            Self::Robot => "robot",
            Self::Camera => "camera",
            Self::Language => "language",
            Self::Noise => "noise",
            Self::Layout => "layout",
            Self::Light => "light",
        }
    }

    /// Returns the name that the benchmark uses, as in `task_classification.json`.
    pub const fn category(self) -> &'static str {
        match self {
            Self::Background => "Background Textures",
            Self::Robot => "Robot Initial States",
            Self::Camera => "Camera Viewpoints",
            Self::Language => "Language Instructions",
            Self::Noise => "Sensor Noise",
            Self::Layout => "Objects Layout",
            Self::Light => "Light Conditions",
        }
    }
}

impl fmt::Display for Dimension {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Dimension {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        Self::ALL
            .into_iter()
            .find(|dimension| dimension.name() == text || dimension.category() == text)
            .ok_or_else(|| UnknownName {
                kind: "dimension",
                given: text.to_owned(),
                valid: Self::ALL.map(Self::name).join(", "),
            })
    }
}

/// Change that a variant makes. Numbers are those in the variant's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Change {
    Camera(View),
    /// Posture at the reset, one of 500.
    Robot(u16),
    /// Picture corruption, one of 50.
    Noise(u8),
    Language(u8),
    Light(u8),
    /// Texture of the table, or of the floor in scenes without a table.
    Table(u8),
    /// Textures of table and background, or of floor and wall.
    TableAndBackground(u8),
    /// Additional objects: a sixth of the number, rounded up.
    Added(u8),
    Level {
        /// Size of the displacement, 1 to 5.
        level: u8,
        sample: u8,
    },
}

impl Change {
    pub const fn dimension(self) -> Dimension {
        match self {
            Self::Camera(_) => Dimension::Camera,
            Self::Robot(_) => Dimension::Robot,
            Self::Noise(_) => Dimension::Noise,
            Self::Language(_) => Dimension::Language,
            Self::Light(_) => Dimension::Light,
            Self::Table(_) | Self::TableAndBackground(_) => Dimension::Background,
            Self::Added(_) | Self::Level { .. } => Dimension::Layout,
        }
    }

    /// Returns the change as written in rollout ids: the part of the variant's name that describes
    /// the change, such as `noise_30`, `view_0_0_181_0_0` or `level5_sample2`.
    pub fn label(self) -> String {
        match self {
            Self::Camera(view) => format!("view_{view}"),
            Self::Robot(robot) => format!("initstate_{robot}"),
            Self::Noise(noise) => format!("noise_{noise}"),
            Self::Language(sentence) => format!("language_{sentence}"),
            Self::Light(number) => format!("light_{number}"),
            Self::Table(number) => format!("table_{number}"),
            Self::TableAndBackground(number) => format!("tb_{number}"),
            Self::Added(number) => format!("add_{number}"),
            Self::Level { level, sample } => format!("level{level}_sample{sample}"),
        }
    }

    pub fn of_label(label: &str) -> Option<Self> {
        let byte = |text: &str| u8::try_from(number(text)?).ok();
        let (kind, rest) = label.split_once('_')?;
        let change = match kind {
            "view" => {
                let numbers = rest.split('_').map(number).collect::<Option<Vec<u16>>>();
                Self::Camera(View::from_numbers(&numbers?)?)
            }
            "initstate" => Self::Robot(number(rest)?),
            "noise" => Self::Noise(byte(rest)?),
            "language" => Self::Language(byte(rest)?),
            "light" => Self::Light(byte(rest)?),
            "table" => Self::Table(byte(rest)?),
            "tb" => Self::TableAndBackground(byte(rest)?),
            "add" => Self::Added(byte(rest)?),
            _ => return level(label),
        };
        change.is_in_range().then_some(change)
    }

    /// Parses the part of a name after the task and an underscore.
    fn parse(suffix: &str, suite: Suite) -> Option<Self> {
        let numbers = |text: &str| text.split('_').map(number).collect::<Option<Vec<u16>>>();
        let byte = |text: &str| u8::try_from(number(text)?).ok();
        let (kind, rest) = suffix.split_once('_')?;
        let change = match kind {
            "table" => Self::Table(byte(rest)?),
            "tb" => Self::TableAndBackground(byte(rest)?),
            "light" => Self::Light(byte(rest)?),
            "add" => Self::Added(byte(rest)?),
            "moved" if suite == Suite::Goal => return level(rest),
            "language" => {
                let (sentence, view) = rest.split_once('_')?;
                (view == "view_0_0_100_0_0_initstate_0").then_some(())?;
                Self::Language(byte(sentence)?)
            }
            "view" => {
                let (view, rest) = rest.split_once("_initstate_")?;
                let view = View::from_numbers(&numbers(view)?)?;
                let (robot, noise) = match rest.split_once("_noise_") {
                    Some((robot, noise)) => (number(robot)?, byte(noise)?),
                    None => (number(rest)?, 0),
                };
                match (view.is_nominal(), robot, noise) {
                    (_, 0, 0) => Self::Camera(view),
                    (true, _, 0) => Self::Robot(robot),
                    (true, 0, _) => Self::Noise(noise),
                    _ => return None,
                }
            }
            _ if suite != Suite::Goal => return level(suffix),
            _ => return None,
        };
        change.is_in_range().then_some(change)
    }

    fn is_in_range(self) -> bool {
        match self {
            Self::Camera(_) => true,
            Self::Robot(robot) => (1..=ROBOTS).contains(&robot),
            Self::Noise(noise) => (1..=CORRUPTIONS).contains(&noise),
            Self::Language(sentence) => (1..=SENTENCES).contains(&sentence),
            Self::Light(number)
            | Self::Table(number)
            | Self::TableAndBackground(number)
            | Self::Added(number) => number > 0,
            Self::Level { level, sample } => (1..=5).contains(&level) && sample > 0,
        }
    }
}

/// Parses a number in a name: digits without a leading zero.
pub(super) fn number(text: &str) -> Option<u16> {
    let is_number = text.bytes().all(|byte| byte.is_ascii_digit());
    let is_canonical = is_number && (text == "0" || !text.starts_with('0'));
    is_canonical.then(|| text.parse().ok()).flatten()
}

/// Parses `levelL_sampleS`.
fn level(text: &str) -> Option<Change> {
    let (level, sample) = text.strip_prefix("level")?.split_once("_sample")?;
    let byte = |text: &str| u8::try_from(number(text)?).ok();
    let (level, sample) = (byte(level)?, byte(sample)?);
    let change = Change::Level { level, sample };
    change.is_in_range().then_some(change)
}

/// A variant of a task. Displays as the name that LIBERO-Plus gives it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Variant {
    pub task: TaskRef,
    pub change: Change,
}

impl Variant {
    /// Returns the stem of the BDDL file in the folder of the suite. Camera, robot and noise
    /// variants use LIBERO's BDDL file.
    pub fn bddl_stem(&self) -> String {
        match self.change {
            Change::Camera(_) | Change::Robot(_) | Change::Noise(_) => self.task.name().to_owned(),
            Change::Language(sentence) => format!("{}_language_{sentence}", self.task.name()),
            _ => self.to_string(),
        }
    }

    /// Returns the path of the file of initial states, relative to `init_files`.
    pub fn states_file(&self) -> String {
        let suite = self.task.suite();
        match self.has_one_state() {
            true => format!("libero_newobj/{suite}/{self}.pruned_init"),
            false => format!("{suite}/{}.pruned_init", self.task.name()),
        }
    }

    /// Returns true if the file of initial states holds a single state as a vector. All other
    /// variants use LIBERO's files of fifty states.
    pub fn has_one_state(&self) -> bool {
        matches!(self.change, Change::Added(_) | Change::Level { .. })
    }

    /// Returns the view of `agentview`. The pose of every variant is computed and therefore
    /// rounded.
    pub fn view(&self) -> View {
        match self.change {
            Change::Camera(view) => view,
            _ => View::NOMINAL,
        }
    }

    pub fn dimension(&self) -> Dimension {
        self.change.dimension()
    }

    /// `None` for LIBERO's posture.
    pub fn robot(&self) -> Option<u16> {
        match self.change {
            Change::Robot(robot) => Some(robot),
            _ => None,
        }
    }

    pub fn corruption(&self) -> Option<u8> {
        match self.change {
            Change::Noise(noise) => Some(noise),
            _ => None,
        }
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.task.name())?;
        let nominal = View::NOMINAL;
        match self.change {
            Change::Camera(view) => write!(f, "_view_{view}_initstate_0"),
            Change::Robot(robot) => write!(f, "_view_{nominal}_initstate_{robot}"),
            Change::Noise(noise) => write!(f, "_view_{nominal}_initstate_0_noise_{noise}"),
            Change::Language(sentence) => {
                write!(f, "_language_{sentence}_view_{nominal}_initstate_0")
            }
            Change::Light(number) => write!(f, "_light_{number}"),
            Change::Table(number) => write!(f, "_table_{number}"),
            Change::TableAndBackground(number) => write!(f, "_tb_{number}"),
            Change::Added(number) => write!(f, "_add_{number}"),
            Change::Level { level, sample } => {
                let infix = match self.task.suite() {
                    Suite::Goal => "_moved",
                    _ => "",
                };
                write!(f, "{infix}_level{level}_sample{sample}")
            }
        }
    }
}

impl FromStr for Variant {
    type Err = UnknownVariant;

    /// Parses a name. A name without a suffix, which would be an unperturbed task, is an
    /// error; LIBERO-Plus cannot load it either.
    fn from_str(name: &str) -> Result<Self, UnknownVariant> {
        if name.is_empty() {
            return Err(UnknownVariant::Empty);
        }
        let task = TaskRef::all()
            .filter(|task| name.starts_with(task.name()))
            .max_by_key(|task| task.name().len())
            .ok_or_else(|| UnknownVariant::Task(name.to_owned()))?;
        let suffix = &name[task.name().len()..];
        if suffix.is_empty() {
            return Err(UnknownVariant::Unchanged(name.to_owned()));
        }
        let change = suffix
            .strip_prefix('_')
            .and_then(|suffix| Change::parse(suffix, task.suite()))
            .ok_or_else(|| UnknownVariant::Suffix {
                name: name.to_owned(),
                suffix: suffix.to_owned(),
            })?;
        Ok(Self { task, change })
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum UnknownVariant {
    #[error("read a variant: its name is empty; give a name of LIBERO-Plus' task map")]
    Empty,
    #[error(
        "read variant `{0}`: it begins with none of LIBERO's forty tasks; give a name of \
         LIBERO-Plus' task map"
    )]
    Task(String),
    #[error(
        "read variant `{0}`: it is a task of LIBERO, without a change; append one, such as _light_1"
    )]
    Unchanged(String),
    #[error(
        "read variant `{name}`: it ends in `{suffix}`, which is not a change; valid are, \
         with numbers for the capital letters, _view_H_V_S_R_T_initstate_N, …_noise_K, \
         _language_L_view_0_0_100_0_0_initstate_0, _light_G, _table_T, _tb_T, _add_A, \
         _levelL_sampleS, and _moved_levelL_sampleS in libero_goal"
    )]
    Suffix { name: String, suffix: String },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_names_and_names_without_a_change_are_refused() {
        let read = |name: &str| name.parse::<Variant>().unwrap_err();
        assert_eq!(read(""), UnknownVariant::Empty);
        let task = "turn_on_the_stove";
        assert_eq!(read(task), UnknownVariant::Unchanged(task.to_owned()));
        assert!(matches!(read("turn_on_the_stove_"), UnknownVariant::Suffix { .. }));
    }
}
