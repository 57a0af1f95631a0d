//! Describes a difference between two servers: its kind, the numbers, and its usual meaning.

use serde::Serialize;

use crate::doctor::fit::{Convention, Fit, GRIPPER, Map};
use crate::doctor::search::Explanation;
use crate::doctor::server_pair::Side;
use crate::doctor::variant::{Topic, Variant};

/// Names of an action's seven components.
pub(crate) const COMPONENT_NAMES: [&str; 7] =
    ["x", "y", "z", "rotation x", "rotation y", "rotation z", "gripper"];

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    FrameOrientation,
    Cameras,
    Colours,
    StateDefinition,
    QuaternionSign,
    Seed,
    ChunkOffset,
    GripperConvention,
    UnNormalisation,
    Unexplained,
}

impl Kind {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::FrameOrientation => "frame orientation",
            Self::Cameras => "cameras",
            Self::Colours => "colour channels",
            Self::StateDefinition => "state definition",
            Self::QuaternionSign => "quaternion sign",
            Self::Seed => "seed",
            Self::ChunkOffset => "chunk offset",
            Self::GripperConvention => "gripper convention",
            Self::UnNormalisation => "un-normalisation",
            Self::Unexplained => "unexplained",
        }
    }

    /// Returns the usual meaning, with a hint on the code to compare.
    pub(crate) fn meaning(self) -> &'static str {
        match self {
            Self::FrameOrientation => {
                "One of the two gives its network frames in another orientation. Frames arrive \
                 with the bottom row first; most LIBERO checkpoints were trained on frames turned \
                 by 180°. Compare how both prepare a frame."
            }
            Self::Cameras => {
                "One of the two feeds the scene camera into the slot of the wrist camera. Compare \
                 which camera feeds which image slot."
            }
            Self::Colours => "One of the two exchanges red and blue. OpenCV reads and writes BGR.",
            Self::StateDefinition => {
                "One of the two interprets the robot's readings differently. Compare the state \
                 that its network was trained on, number by number."
            }
            Self::QuaternionSign => {
                "A quaternion and its negative are the same orientation, but give different \
                 axis-angles. LIBERO keeps the simulator's sign. Compare how both convert it."
            }
            Self::Seed => {
                "A seed reproduces a rollout only if all noise is computed from seed and query. \
                 Success rates stay comparable; single rollouts do not."
            }
            Self::ChunkOffset => {
                "One of the two leaves out the first actions of a chunk, or executes some twice. \
                 Compare the first action that both execute of a chunk."
            }
            Self::GripperConvention => {
                "The simulator opens at -1 and closes at 1. RLDS data have 1 for open and 0 for \
                 closed. Compare how both use the last number of an action."
            }
            Self::UnNormalisation => {
                "One of the two un-normalises with other statistics: of another data set, \
                 percentiles for means, or not at all. Compare the statistics that both load."
            }
            Self::Unexplained => {
                "Possible causes: other weights, another prompt, a crop, another size of frames, or \
                 several differences at once."
            }
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Difference {
    pub kind: Kind,
    /// Description of the observed difference. A and B are the servers.
    pub text: String,
}

impl Difference {
    pub(crate) fn new(kind: Kind, text: impl Into<String>) -> Self {
        let text = text.into();
        Self { kind, text }
    }
}

/// Largest difference between two servers' answers before any explanation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LargestDifference {
    pub(crate) value: f64,
    pub(crate) component: usize,
}

/// Returns the differences of an explanation, in the order of a policy's
/// pipeline.
pub(crate) fn explained(explanation: &Explanation, largest: LargestDifference) -> Vec<Difference> {
    let mut differences = of_observations(explanation);
    differences.extend(of_actions(&explanation.fit));
    with_sizes(differences, explanation, largest)
}

fn of_observations(explanation: &Explanation) -> Vec<Difference> {
    let changes = explanation.changes.iter();
    changes
        .map(|(side, variant)| Difference::new(kind(variant), describe_variant(*side, variant)))
        .collect()
}

/// Appends the largest differences without and with the explanation to each description.
fn with_sizes(
    mut differences: Vec<Difference>,
    explanation: &Explanation,
    largest: LargestDifference,
) -> Vec<Difference> {
    let remaining = explanation.fit.remaining.iter().copied().fold(0.0, f64::max);
    for difference in &mut differences {
        difference.text = format!(
            "{} Unchanged, their answers differ by up to {} ({}); with this change, by {}.",
            difference.text,
            size(largest.value),
            COMPONENT_NAMES[largest.component],
            size(remaining),
        );
    }
    differences
}

/// Formats a number for people: 0.250, or 3e-6.
pub(crate) fn size(number: f64) -> String {
    match number {
        0.0 => "0".to_owned(),
        small if small < 5e-4 => format!("{small:.0e}"),
        large => format!("{large:.3}"),
    }
}

/// Describes the changes to observations in an explanation that leaves too large a difference.
pub(crate) fn attempt(explanation: &Explanation) -> String {
    let changes = explanation.changes.iter();
    let changes: Vec<String> =
        changes.map(|(side, variant)| format!("{} is given {variant}", letter(*side))).collect();
    changes.join(", and ")
}

fn kind(variant: &Variant) -> Kind {
    match variant.topic() {
        Topic::Orientation => Kind::FrameOrientation,
        Topic::Cameras => Kind::Cameras,
        Topic::Colours => Kind::Colours,
        Topic::Sign => Kind::QuaternionSign,
        Topic::State => Kind::StateDefinition,
    }
}

fn letter(side: Side) -> &'static str {
    match side {
        Side::A => "A",
        Side::B => "B",
    }
}

fn describe_variant(side: Side, variant: &Variant) -> String {
    let (changed, other) = match side {
        Side::A => ("A", "B"),
        Side::B => ("B", "A"),
    };
    format!("{other} answers as {changed} does when {changed} is given {variant}.")
}

pub(crate) fn of_actions(fit: &Fit) -> Vec<Difference> {
    let mut differences = vec![];
    if fit.shift != 0 {
        let (earlier, later) = if fit.shift > 0 { ("A", "B") } else { ("B", "A") };
        let by = fit.shift.unsigned_abs();
        let text = format!(
            "{later}'s chunks begin {by} {} later: action k of {later} is action k + {by} of \
             {earlier}.",
            if by == 1 { "action" } else { "actions" },
        );
        differences.push(Difference::new(Kind::ChunkOffset, text));
    }
    let is_affine = |component: &usize| matches!(fit.maps[*component], Map::Affine { .. });
    if let Map::Gripper(convention) = fit.maps[GRIPPER] {
        let text = describe_convention(convention);
        differences.push(Difference::new(Kind::GripperConvention, text));
    }
    if (0..7).any(|component| is_affine(&component)) {
        let all = (0..7).filter(is_affine);
        let each = all.filter_map(|component| match fit.maps[component] {
            Map::Affine { scale, offset } => {
                Some(format!("{} = {}", COMPONENT_NAMES[component], scaled("A's", scale, offset)))
            }
            _ => None,
        });
        let text = format!(
            "B's actions are A's scaled and shifted: {}.",
            each.collect::<Vec<_>>().join(", ")
        );
        differences.push(Difference::new(Kind::UnNormalisation, text));
    }
    differences
}

fn scaled(name: &str, scale: f64, offset: f64) -> String {
    let sign = if offset < 0.0 { '-' } else { '+' };
    match offset.abs() < 5e-4 {
        true => format!("{name} × {scale:.3}"),
        false => format!("{name} × {scale:.3} {sign} {:.3}", offset.abs()),
    }
}

fn describe_convention(convention: Convention) -> &'static str {
    match convention {
        Convention::Inverted => "B's gripper is A's × -1: one opens where the other closes.",
        Convention::ZeroToOne => {
            "B's gripper lies in 0..1 where A's lies in -1..1: B = (A + 1) / 2."
        }
        Convention::OneToZero => {
            "B's gripper lies in 1..0 where A's lies in -1..1: B = (1 - A) / 2."
        }
        Convention::FromZeroToOne => {
            "A's gripper lies in 0..1 where B's lies in -1..1: B = 2 A - 1."
        }
        Convention::FromOneToZero => {
            "A's gripper lies in 1..0 where B's lies in -1..1: B = 1 - 2 A."
        }
        Convention::Sign => "B's gripper is the sign of A's: B rounds it to -1 or 1.",
    }
}
