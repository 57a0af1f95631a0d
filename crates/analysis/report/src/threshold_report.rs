//! Report of a campaign that measures another campaign's thresholds, as text for a terminal
//! and as JSON. `adaptive::radii` defines thresholds and chooses the radii to run.

use std::collections::BTreeMap;
use std::fmt::Write;

use adaptive::radii::{Curve, Measurement, Ray, Threshold};
use adaptive::{Decision, Outcomes};
use libero_ctrl::{CONTROL_HZ, Condition, JsonError, Level, STEPS_PER_RADIUS, TaskRef, Thresholds};
use paired::{Bootstrap, Outcome, Record, push_wrapped};
use serde::Serialize;

use crate::subject::{Prospect, Subject, agree, pluralise};
use crate::words;

/// Width of the column of condition names, in characters.
const NAMES: usize = 14;

/// Measured thresholds of a campaign.
#[derive(Clone, Debug, Serialize)]
pub struct ThresholdReport {
    /// The campaign whose thresholds are measured.
    pub campaign: String,
    /// The campaign that runs further radii.
    pub measured_by: String,
    pub policy: String,
    /// Largest width of a finished bracket, in units of radius.
    pub tolerance: f64,
    /// The largest radius that is run.
    pub max_radius: f64,
    /// True if nothing remains to be run.
    pub complete: bool,
    /// Number of thresholds searched for: one per configuration and condition.
    #[serde(rename = "looked_for")]
    pub searched: u64,
    /// Number of thresholds whose search is finished.
    pub found: u64,
    /// Number of thresholds not searched for because the budget does not suffice.
    pub beyond_budget: u64,
    /// Rollouts of the measuring campaign, finished or waiting.
    pub rollouts: u64,
    /// Number of these rollouts without an outcome yet.
    pub waiting: u64,
    /// Curves of configurations that still succeed at each radius, by condition.
    pub curves: Vec<Curve>,
    /// Each threshold that is searched for.
    pub thresholds: Vec<Measured>,
}

/// The threshold of one configuration under one condition.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Condition: the perturbed axes.
    pub condition: Condition,
    pub task: TaskRef,
    /// The configuration's number.
    pub config: u16,
    /// Kind of the threshold, as far as known.
    pub threshold: Kind,
    /// Largest radius below `fails_at` at which the configuration succeeds, 0 for the nominal
    /// rollout; without a failure, the largest successful radius.
    pub succeeds_at: Option<f64>,
    /// Smallest radius at which the configuration fails, 0 for the nominal rollout.
    pub fails_at: Option<f64>,
    /// Radii above `fails_at` at which the configuration succeeds again, so that success is
    /// not monotone.
    pub recovers_at: Vec<f64>,
    /// True if the search for this threshold is finished.
    pub is_found: bool,
    /// Outcome at every requested radius in ascending order, the nominal rollout first.
    pub outcomes: Vec<AtRadius>,
}

/// Kind of a threshold, as far as known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    NominalFails,
    /// The nominal rollout has no outcome.
    NominalUnknown,
    /// The threshold is between two radii.
    Between,
    /// The threshold is beyond the largest radius.
    Beyond,
    /// No failure so far, and the largest radius has no outcome.
    Open,
}

impl Kind {
    /// Name in JSON and tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::NominalFails => "nominal_fails",
            Self::NominalUnknown => "nominal_unknown",
            Self::Between => "between",
            Self::Beyond => "beyond",
            Self::Open => "open",
        }
    }
}

/// Outcome of the rollout at a radius.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AtRadius {
    pub radius: f64,
    pub outcome: Outcome,
}

/// Error: the budget is too small to measure one configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "measure thresholds with a budget of {budget}: one configuration may take {most} rollouts; \
     raise the budget to {most} or more"
)]
pub struct BudgetTooSmall {
    pub budget: u32,
    /// Largest number of rollouts that a configuration may take.
    pub most: u32,
}

impl ThresholdReport {
    /// Checks that the budget suffices for at least one configuration of the campaign.
    ///
    /// # Errors
    /// If the budget is smaller than the number of rollouts that one configuration may take.
    pub fn check_budget(campaign: &Subject, thresholds: &Thresholds) -> Result<(), BudgetTooSmall> {
        let measurement = Measurement::of(&campaign.counted(), &[], thresholds);
        let is_empty = measurement.rays().next().is_none() && measurement.ray_count() > 0;
        match thresholds.budget {
            Some(budget) if is_empty => {
                Err(BudgetTooSmall { budget, most: measurement.most_rollouts_per_configuration() })
            }
            _ => Ok(()),
        }
    }

    /// Returns the number of thresholds to measure and the upper bound of the rollouts that the
    /// measurement takes.
    pub fn prospect(campaign: &Subject, thresholds: &Thresholds) -> Prospect {
        let measurement = Measurement::of(&campaign.counted(), &[], thresholds);
        let mut prospect = Prospect {
            subjects: measurement.rays().count() as u64,
            most_rollouts: BTreeMap::new(),
        };
        for (task, most) in measurement.most_rollouts() {
            *prospect.most_rollouts.entry(task.suite()).or_default() += u64::from(most);
        }
        prospect
    }

    /// Combines the outcomes of the campaign `measuring` with those of the campaign whose
    /// thresholds it measures; `None` if `measuring` measures no thresholds.
    pub fn of(measuring: &Subject) -> Option<Self> {
        let (thresholds, records) = measuring.measures()?;
        let measurement = Measurement::of(records, &measuring.records, thresholds);
        let is_settled = |record: &Record| record.outcome != Outcome::Missing;
        let waiting = measuring.records.iter().filter(|record| !is_settled(record)).count();
        let rays = measurement.rays();
        let measured: Vec<Measured> =
            rays.map(|(ray, outcomes)| Measured::new(&measurement, ray, outcomes)).collect();
        Some(Self {
            campaign: thresholds.campaign.clone(),
            measured_by: measuring.origin_name().to_owned(),
            policy: measuring.policy.clone(),
            tolerance: thresholds.tolerance,
            max_radius: thresholds.max_radius,
            complete: records.iter().all(is_settled)
                && waiting == 0
                && measurement.plan().is_empty(),
            searched: measured.len() as u64,
            found: measured.iter().filter(|measured| measured.is_found).count() as u64,
            beyond_budget: (measurement.ray_count() - measured.len()) as u64,
            rollouts: measuring.records.len() as u64,
            waiting: waiting as u64,
            curves: measurement.curves(&Bootstrap::default()),
            thresholds: measured,
        })
    }

    /// Writes the measurement as JSON, several lines.
    ///
    /// # Errors
    /// If serialisation fails, which is a defect.
    pub fn json(&self) -> Result<String, JsonError> {
        Ok(serde_json::to_string_pretty(self)?)
    }

    /// Writes the measurement as text for a terminal of 80 columns.
    pub fn text(&self) -> String {
        let mut text = String::new();
        push_wrapped(&mut text, "", &format!("{} {}", self.measured_by, self.describe_progress()));
        let curves: Vec<&Curve> = self.curves.iter().filter(|curve| curve.n > 0).collect();
        if !curves.is_empty() {
            push_survival(&mut text, &curves);
            push_half_success(&mut text, &curves);
        }
        let not_monotone = self.thresholds.iter();
        let not_monotone: Vec<&Measured> =
            not_monotone.filter(|measured| !measured.recovers_at.is_empty()).collect();
        if !not_monotone.is_empty() {
            text.push_str("\nnot monotone: configurations that succeed again beyond a failure\n");
        }
        for measured in not_monotone {
            push_not_monotone(&mut text, measured);
        }
        text
    }

    /// Returns the progress of the measurement: a sentence without subject and full stop.
    pub(crate) fn describe_progress(&self) -> String {
        let mut words = format!(
            "measures thresholds of {}: {} of {} found in {}",
            self.campaign,
            self.found,
            self.searched,
            pluralise(self.rollouts, "rollout")
        );
        if self.waiting > 0 {
            let have = agree(self.waiting, "has", "have");
            let _ = write!(words, ", of which {} {have} no outcome yet", self.waiting);
        }
        if self.beyond_budget > 0 {
            let _ =
                write!(words, "; the budget leaves {} out", pluralise(self.beyond_budget, "other"));
        }
        words
    }
}

impl Measured {
    fn new(measurement: &Measurement, ray: Ray, outcomes: &Outcomes<Level>) -> Self {
        let finding = measurement.finding(ray, outcomes);
        let (threshold, succeeds_at, fails_at) = match finding.threshold {
            Threshold::NominalFails => (Kind::NominalFails, None, Some(Level::L0)),
            Threshold::NominalUnknown => (Kind::NominalUnknown, None, None),
            Threshold::Between { succeeds_at, fails_at } => {
                (Kind::Between, Some(succeeds_at), Some(fails_at))
            }
            Threshold::Beyond => (Kind::Beyond, largest_success(outcomes), None),
            Threshold::Open { succeeds_at } => (Kind::Open, Some(succeeds_at), None),
        };
        let nominal = [(Level::L0, outcomes.nominal())].into_iter();
        let points = nominal.chain(outcomes.perturbed());
        Self {
            condition: ray.condition,
            task: ray.task,
            config: ray.config,
            threshold,
            succeeds_at: succeeds_at.map(Level::radius),
            fails_at: fails_at.map(Level::radius),
            recovers_at: finding.recovers_at.into_iter().map(Level::radius).collect(),
            is_found: measurement.decision(ray, outcomes) == Decision::Done,
            outcomes: points
                .map(|(level, outcome)| AtRadius { radius: level.radius(), outcome })
                .collect(),
        }
    }

    /// Lists the radii that succeed or, if `success` is false, those that fail.
    pub(crate) fn radii(&self, success: bool) -> String {
        let points = self.outcomes.iter();
        let points = points.filter(|point| point.outcome.success() == Some(success));
        let radii: Vec<String> = points.map(|point| point.radius.to_string()).collect();
        radii.join(", ")
    }
}

/// Returns the largest successful radius; [`Level::L0`] if no perturbed rollout succeeds.
fn largest_success(outcomes: &Outcomes<Level>) -> Option<Level> {
    let succeeds = outcomes.perturbed().filter(|(_, outcome)| *outcome == Outcome::Success);
    Some(succeeds.map(|(level, _)| level).max().unwrap_or(Level::L0))
}

/// Appends the survival table: a row per condition, a column per radius of the grid.
fn push_survival(text: &mut String, curves: &[&Curve]) {
    text.push_str("\nconfigurations that still succeed, %, by radius\n");
    // Conditions that perturb the language axis have a shorter grid.
    let longest = curves.iter().max_by(|a, b| a.largest_radius.total_cmp(&b.largest_radius));
    let grid = longest.map(|curve| curve.grid.as_slice()).unwrap_or_default();
    let radii: Vec<f64> = [0.0].into_iter().chain(grid.iter().copied()).collect();
    let _ = write!(text, "{:NAMES$}{:>6}", "", "n");
    for radius in &radii {
        let level = Level::of_radius(*radius).filter(|level| level.is_named());
        let name = match level {
            Some(level) => level.to_string(),
            None => radius.to_string(),
        };
        let _ = write!(text, "{name:>6}");
    }
    text.push('\n');
    for curve in curves {
        words::push_name(text, curve.condition.label(), NAMES);
        let _ = write!(text, "{:>6}", curve.n);
        for radius in &radii {
            let share = match curve.at(*radius) {
                Some(point) => words::percent(point.survival),
                None => "-".to_owned(),
            };
            let _ = write!(text, "{share:>6}");
        }
        text.push('\n');
    }
}

/// Appends the table of median radii: a row per condition with the radius at which half of the
/// configurations still succeed, its interval, and the numbers of configurations that fail
/// nominally, succeed at the largest radius, or succeed again beyond a failure.
fn push_half_success(text: &mut String, curves: &[&Curve]) {
    text.push_str("\nradius at which half of the configurations still succeed\n");
    let _ = writeln!(
        text,
        "{:NAMES$}{:>8}  {:<14}{:>14}{:>8}{:>14}",
        "", "radius", "95 %", "nominal fails", "beyond", "not monotone"
    );
    for curve in curves {
        words::push_name(text, curve.condition.label(), NAMES);
        let _ = writeln!(
            text,
            "{:>8}  {:<14}{:>14}{:>8}{:>14}",
            words::half_success(curve),
            words::half_success_interval(&curve.half_success),
            curve.nominal_fails,
            curve.beyond,
            curve.not_monotone
        );
    }
    let left_out: u64 = curves.iter().map(|curve| curve.left_out).sum();
    if left_out > 0 {
        let words = format!(
            "{} {} in no figure, because outcomes are missing or in quarantine",
            pluralise(left_out, "threshold"),
            agree(left_out, "is", "are")
        );
        push_wrapped(text, "", &words);
    }
    let latency = curves.iter().find(|curve| curve.condition.sets_execution());
    if let Some(words) = latency.map(|curve| tolerated_delay(curve)) {
        push_wrapped(text, "", &words);
    }
    if curves.iter().any(|curve| !curve.is_bisected) {
        let words = "where language is perturbed, there are wordings at L1, L2 and L3 and at no \
                     radius between or beyond";
        push_wrapped(text, "", words);
    }
}

/// Describes the delay up to which half of the configurations succeed, in whole control steps.
pub(crate) fn tolerated_delay(curve: &Curve) -> String {
    let delay = |radius: f64| {
        let steps = (radius * STEPS_PER_RADIUS).floor();
        let milliseconds = steps * 1000.0 / f64::from(CONTROL_HZ);
        let steps = pluralise(steps as u64, "control step");
        format!("{steps}, {milliseconds} ms")
    };
    match curve.half_success.radius {
        Some(radius) => format!(
            "latency: half of the configurations succeed with a delay of {}; a radius of 2 is one \
             step",
            delay(radius)
        ),
        None if curve.beyond * 2 > curve.n => format!(
            "latency: more than half of the configurations succeed with a delay of {}, the longest \
             that was run",
            delay(curve.largest_radius)
        ),
        None => "latency: fewer than half of the configurations succeed without a delay, or the \
                 share that succeeds with a delay is not known"
            .to_owned(),
    }
}

fn push_not_monotone(text: &mut String, measured: &Measured) {
    let Measured { condition, task, config, .. } = measured;
    let [succeeds, fails] = [true, false].map(|success| measured.radii(success));
    let words = format!("succeeds at {succeeds}; fails at {fails}");
    push_wrapped(text, "  ", &format!("{task} {} c{config:02}: {words}", condition.label()));
}
