//! Paths of BDDL files as LIBERO-Plus' environments read them: the file's name can encode the
//! camera's view, the arm's posture and the corruption of the pictures; such a file need not exist.

use crate::family::corruption::Corruption;

use super::camera::View;
use super::start::ROBOTS;
use super::variant::number;

/// Marks of a path that encodes changes; the environments look for them in the whole path.
const VIEW: &str = "_view_";
const ROBOT: &str = "_initstate_";
const NOISE: &str = "_noise_";

/// A BDDL file and the changes that a path encodes. A path may encode several changes at once, but
/// every variant of the benchmark has only one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BddlPath {
    pub file: String,
    /// View of `agentview`. A path without changes has the nominal view, whose pose is rounded.
    pub view: View,
    /// Number of the posture at resets; `None` for LIBERO's.
    pub robot: Option<u16>,
    /// Corruption of `agentview`'s pictures.
    pub corruption: Option<Corruption>,
}

impl BddlPath {
    pub fn parse(path: &str) -> Result<Self, InvalidBddlPath> {
        if !(path.contains(VIEW) && path.contains(ROBOT)) {
            return Ok(Self {
                file: path.to_owned(),
                view: View::NOMINAL,
                robot: None,
                corruption: None,
            });
        }
        let invalid = |problem| InvalidBddlPath { path: path.to_owned(), problem };
        let (stem, changes) = parts(path, VIEW).ok_or_else(|| invalid(Problem::Repeated))?;
        if !changes.contains(ROBOT) {
            return Err(invalid(Problem::Order));
        }
        let (view, rest) = parts(changes, ROBOT).ok_or_else(|| invalid(Problem::Repeated))?;
        let rest = rest.split('.').next().unwrap_or(rest);
        let (robot, noise) = match rest.contains(NOISE) {
            true => parts(rest, NOISE).ok_or_else(|| invalid(Problem::Repeated))?,
            false => (rest, "0"),
        };
        let numbers = view.split('_').map(number).collect::<Option<Vec<u16>>>();
        let view = numbers.and_then(|numbers| View::from_numbers(&numbers));
        let robot = number(robot).filter(|robot| *robot <= ROBOTS);
        let corruption = match number(noise) {
            Some(0) => Some(None),
            Some(noise) => u8::try_from(noise).ok().and_then(Corruption::new).map(Some),
            None => None,
        };
        Ok(Self {
            file: format!("{stem}.bddl"),
            view: view.ok_or_else(|| invalid(Problem::View))?,
            robot: Some(robot.ok_or_else(|| invalid(Problem::Robot))?).filter(|robot| *robot > 0),
            corruption: corruption.ok_or_else(|| invalid(Problem::Noise))?,
        })
    }
}

/// Splits a text at a mark that occurs once; `None` if it occurs more often or never.
fn parts<'a>(text: &'a str, mark: &str) -> Option<(&'a str, &'a str)> {
    let (before, after) = text.split_once(mark)?;
    (!after.contains(mark)).then_some((before, after))
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "read the changes in the path {path}: {}; the path ends in \
     _view_H_V_S_R_T_initstate_N.bddl or _view_H_V_S_R_T_initstate_N_noise_K.bddl, with five \
     numbers for the view, the number N of the posture and the number K of the corruption",
    problem.words()
)]
pub struct InvalidBddlPath {
    path: String,
    problem: Problem,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Problem {
    Repeated,
    Order,
    View,
    Robot,
    Noise,
}

impl Problem {
    const fn words(self) -> &'static str {
        match self {
            Self::Repeated => {
                "_view_, _initstate_ or _noise_ occurs twice in it; folders must not have these \
                 words in their names"
            }
            Self::Order => {
                "_initstate_ occurs before _view_ in it and not after; folders must not have these \
                 words in their names"
            }
            Self::View => {
                "its view is not five numbers, four angles of 0 to 359 degrees and, in third \
                 place, a distance in per cent"
            }
            Self::Robot => "the number of its posture is not 0 to 500",
            Self::Noise => "the number of its corruption is not 0 to 50",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::family::plus::inventory;

    #[test]
    fn paths_of_all_variants_encode_their_changes() {
        for entry in inventory() {
            let variant = entry.variant;
            let suite = variant.task.suite();
            let path =
                BddlPath::parse(&format!("/plus/{suite}/{variant}.bddl")).expect("a variant");
            let file = format!("/plus/{suite}/{}.bddl", variant.bddl_stem());
            assert_eq!(path.file, file);
            assert_eq!(path.view, variant.view());
            assert_eq!(path.robot, variant.robot());
            let corruption = variant.corruption().and_then(Corruption::new);
            assert_eq!(path.corruption, corruption);
        }
    }

    #[test]
    fn a_path_may_encode_several_changes_or_none() {
        let all =
            BddlPath::parse("a/b_view_1_15_110_2_358_initstate_19_noise_50.bddl").expect("valid");
        assert_eq!(all.file, "a/b.bddl");
        assert_eq!(all.view.to_string(), "1_15_110_2_358");
        assert_eq!(all.robot, Some(19));
        assert_eq!(all.corruption, Corruption::new(50));
        let none = BddlPath::parse("a_initstate_b/c.bddl").expect("valid");
        assert_eq!((none.file.as_str(), none.robot), ("a_initstate_b/c.bddl", None));
        assert!(none.view.is_nominal());
    }

    #[test]
    fn invalid_changes_are_refused() {
        for (path, words) in [
            ("a_view_b/c_view_0_0_100_0_0_initstate_0.bddl", "twice"),
            ("c_view_0_0_100_0_0_initstate_0_initstate_1.bddl", "twice"),
            ("c_initstate_0_view_0_0_100_0_0.bddl", "_initstate_ occurs before _view_"),
            ("c_view_0_0_100_0_initstate_0.bddl", "its view"),
            ("c_view_0_0_0_0_0_initstate_0.bddl", "its view"),
            ("c_view_0_0_100_0_0_initstate_501.bddl", "0 to 500"),
            ("c_view_0_0_100_0_0_initstate_0_noise_51.bddl", "0 to 50"),
            ("c_view_0_0_100_0_0_initstate_0_noise_x.bddl", "0 to 50"),
        ] {
            let error = BddlPath::parse(path).expect_err(path).to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
