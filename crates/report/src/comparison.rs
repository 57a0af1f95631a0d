//! Comparison of two policies over the rollouts that both ran. Rollouts that were
//! simulated or perturbed differently are not paired, and the reason is reported.

use std::collections::BTreeSet;

use benchmark::{Directions, RolloutId};
use paired::{Bootstrap, Compared, MIN_TASKS, Obstacle, Record};
use serde::Serialize;

use crate::analysis::Analysis;
use crate::block::{self, push_wrapped};
use crate::document::push_warnings;
use crate::subject::{Origin, Setups, Subject};
use crate::warnings::{Property, look, mujoco, pack, renderer};

/// A completed comparison of two policies.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    pub a: Side,
    pub b: Side,
    /// Warnings about the comparison, to be read first.
    pub warnings: Vec<String>,
    /// Warnings about either policy, to be read first.
    pub notes: Vec<String>,
    #[serde(flatten)]
    pub statistics: paired::Comparison,
    pub bootstrap: Bootstrap,
    /// Smallest number of tasks that gives a bootstrap interval.
    pub min_tasks: usize,
}

/// One of the policies that are compared.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Side {
    /// Name of the policy, unique in this comparison.
    pub label: String,
    pub policy: String,
    pub origin: Origin,
}

/// Error: no rollouts of the two policies can be paired.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("compare {a} with {b}: {}", .reasons.join("; "))]
pub struct Unpairable {
    pub a: String,
    pub b: String,
    /// Reasons, each with a remedy.
    pub reasons: Vec<String>,
}

/// Properties of the measurement that both policies must share.
pub(crate) const SHARED: [(&str, Property); 4] =
    [("asset pack", pack), ("MuJoCo version", mujoco), ("renderer", renderer), ("look", look)];

impl Comparison {
    /// Compares two policies, A − B. `setups` are the known digests of their rollouts.
    pub fn of(analyses: [&Analysis; 2], setups: [&Setups; 2]) -> Result<Self, Unpairable> {
        let [a, b] = analyses;
        let sides = sides(a, b);
        let (mut reasons, mut warnings) = (Vec::new(), Vec::new());
        let subjects = [&a.subject, &b.subject];
        for (subject, side) in subjects.into_iter().zip(&sides) {
            if let Some(protocol) = &subject.protocol {
                reasons.push(format!(
                    "`{}` is a campaign of LIBERO's family or of a suite file, under {protocol}: \
                     compare it with another campaign of the same benchmark by `coordinator \
                     compare`",
                    side.label
                ));
            }
            warnings.extend(unknown(subject, side));
        }
        reasons.extend(
            SHARED.iter().filter_map(|property| property_difference(property, subjects, &sides)),
        );
        reasons.extend(different_realisation(subjects, &sides));
        warnings.extend(different_directions(subjects, &sides));
        let placebo_warning = different_placebo(subjects, &sides);
        let placebos_differ = placebo_warning.is_some();
        warnings.extend(placebo_warning);
        let notes = [a, b].into_iter().zip(&sides).flat_map(|(analysis, side)| {
            let notes = analysis.report.notes.iter();
            notes.map(move |note| format!("`{}`: {note}", side.label))
        });
        let notes = notes.collect();
        let [a, b] = sides;
        let unpairable = |reasons| Unpairable { a: a.label.clone(), b: b.label.clone(), reasons };
        if !reasons.is_empty() {
            return Err(unpairable(reasons));
        }
        let bootstrap = Bootstrap::default();
        let [compared_a, compared_b] = analyses.map(|analysis| Compared {
            records: analysis.counted(),
            progress: &analysis.subject.progress,
            directions: analysis.subject.directions,
            has_rows: !analysis.subject.setups.rollouts.is_empty(),
        });
        let statistics = paired::Comparison::of(compared_a, compared_b, &bootstrap, |record| {
            match placebos_differ && record.id.is_placebo() {
                true => Some(Obstacle::Perturbation),
                false => obstacle(record, setups),
            }
        });
        if statistics.shared() == 0 {
            let mut reasons = statistics.left_out();
            reasons.insert(
                0,
                "they have no rollout in common: give both campaigns the same tasks, axes, levels \
                 and configurations"
                    .to_owned(),
            );
            return Err(unpairable(reasons));
        }
        Ok(Self { a, b, warnings, notes, statistics, bootstrap, min_tasks: MIN_TASKS })
    }

    /// Returns `A − B` with the labels of the two policies.
    pub(crate) fn title(&self) -> String {
        format!("{} − {}", self.a.label, self.b.label)
    }

    /// Returns the meanings of the tables' columns as a Markdown table, for docs/REPORT.md.
    pub fn columns(&self) -> String {
        let blocks = self.blocks();
        let rows = block::legend(&blocks).into_iter();
        let rows = rows.map(|(column, meaning)| format!("| `{column}` | {meaning} |\n"));
        format!("| column | meaning |\n| --- | --- |\n{}", rows.collect::<String>())
    }

    /// Writes the comparison for a terminal of 80 columns.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for (letter, side) in [("A", &self.a), ("B", &self.b)] {
            push_wrapped(&mut text, &format!("{letter}  "), &side.description());
        }
        text.push('\n');
        push_warnings(&mut text, self.warnings.iter().chain(&self.notes));
        block::push_text(&mut text, &self.blocks());
        text
    }
}

impl Side {
    fn description(&self) -> String {
        match &self.origin {
            Origin::Campaign { name, endpoint, .. } => {
                format!("{} at {endpoint}, campaign {name}", self.policy)
            }
            Origin::File { name, .. } => format!("{}, results of {name}", self.policy),
        }
    }
}

/// Returns A and B; if their labels are equal, they are distinguished by origin, or by letter if
/// the origins are equal too.
fn sides(a: &Analysis, b: &Analysis) -> [Side; 2] {
    let is_ambiguous = a.label == b.label;
    let side = |analysis: &Analysis, letter: &str| {
        let subject = &analysis.subject;
        let label = match is_ambiguous {
            false => analysis.label.clone(),
            true if a.subject.origin_name() != b.subject.origin_name() => {
                format!("{} ({})", subject.policy, subject.origin_name())
            }
            true => format!("{} {letter}", analysis.label),
        };
        Side { label, policy: subject.policy.clone(), origin: subject.origin.clone() }
    };
    [side(a, "A"), side(b, "B")]
}

/// Names the properties in [`SHARED`] that are unknown for a subject, and the realisation mode if
/// it is unknown.
fn unknown(subject: &Subject, side: &Side) -> Option<String> {
    // Properties are recorded with results, so a campaign without results has none yet.
    let has_results = !subject.provenances.is_empty();
    let may_be_unknown = has_results || matches!(subject.origin, Origin::File { .. });
    let is_unknown =
        |(_, property): &&(&str, Property)| may_be_unknown && property(subject).is_empty();
    let unknown = SHARED.iter().filter(is_unknown).map(|(name, _)| *name);
    let mode = subject.realisation.is_none().then_some("realisation mode");
    let unknown: Vec<&str> = unknown.chain(mode).collect();
    (!unknown.is_empty()).then(|| {
        format!(
            "`{}`: {} not known; compare the policy only with policies that were measured in the \
             same way",
            side.label,
            unknown.join(", ")
        )
    })
}

/// Describes a property of which the two subjects' results have more than one value; `None` if all
/// results share one value, or if a subject has no known value.
pub(crate) fn property_difference(
    (name, property): &(&str, Property),
    subjects: [&Subject; 2],
    sides: &[Side; 2],
) -> Option<String> {
    let values = subjects.map(property);
    if values.iter().any(BTreeSet::is_empty) || values[0] == values[1] && values[0].len() == 1 {
        return None;
    }
    let descriptions = sides.iter().zip(values).map(|(side, values)| {
        let values: Vec<String> = values.into_iter().collect();
        format!("{} with {}", side.label, values.join(" and "))
    });
    let descriptions: Vec<String> = descriptions.collect();
    Some(format!(
        "they were measured with more than one {name} ({}): run both with the same {name}",
        descriptions.join(", ")
    ))
}

fn different_realisation([a, b]: [&Subject; 2], sides: &[Side; 2]) -> Option<String> {
    let (mode_a, mode_b) = (a.realisation?, b.realisation?);
    (mode_a != mode_b).then(|| {
        format!(
            "they were perturbed in different realisation modes ({}: {}, {}: {}): create both \
             campaigns with the same `--realisation`",
            sides[0].label,
            mode_a.name(),
            sides[1].label,
            mode_b.name()
        )
    })
}

/// Warns of campaigns whose designs assign directions differently.
fn different_directions([a, b]: [&Subject; 2], sides: &[Side; 2]) -> Option<String> {
    let words = |directions: Directions| match directions {
        Directions::Shared => "directions that all tasks share",
        Directions::Own => "directions of its own for every task",
    };
    (a.directions != b.directions).then(|| {
        format!(
            "the designs differ in their directions (`{}`: {}, `{}`: {}), so that perturbed \
             rollouts with the same id differ: intervals about new directions treat the \
             directions of paired rollouts as shared by all tasks; create both campaigns with \
             the same `--directions`, or set `\"directions\": \"own\"` in the `about.json` of \
             results whose tasks have directions of their own",
            sides[0].label,
            words(a.directions),
            sides[1].label,
            words(b.directions)
        )
    })
}

/// Warns of placebo levels of different radii, whose rollouts are not the same.
fn different_placebo([a, b]: [&Subject; 2], sides: &[Side; 2]) -> Option<String> {
    let (radius_a, radius_b) = (a.placebo_radius?, b.placebo_radius?);
    (radius_a != radius_b).then(|| {
        format!(
            "their placebo levels have different radii (`{}`: {radius_a}, `{}`: {radius_b}) and \
             are not compared; create both campaigns with the same `--placebo-radius`",
            sides[0].label, sides[1].label
        )
    })
}

/// Returns the reason why a rollout cannot be paired, according to the known digests.
fn obstacle(record: &Record, [a, b]: [&Setups; 2]) -> Option<Obstacle> {
    let differ = |a: Option<&String>, b: Option<&String>| a.zip(b).is_some_and(|(a, b)| a != b);
    let state = RolloutId::nominal(record.id.task(), record.init_id);
    if differ(a.scenes.get(&state), b.scenes.get(&state)) {
        return Some(Obstacle::Scene);
    }
    let id = &record.id;
    differ(a.rollouts.get(id), b.rollouts.get(id)).then_some(Obstacle::Perturbation)
}
