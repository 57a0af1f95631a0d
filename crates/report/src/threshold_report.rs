//! Report of a campaign that measures another campaign's thresholds, as blocks of a report
//! and as JSON. `paired::adaptive::radii` defines thresholds and chooses the radii to run.

use std::collections::BTreeMap;
use std::fmt::Write;

use benchmark::{CONTROL_HZ, Condition, Level, STEPS_PER_RADIUS, TaskRef, Thresholds};
use paired::adaptive::radii::{Curve, Measurement, Ray, Threshold};
use paired::adaptive::{Decision, Outcomes};
use paired::{Bootstrap, Outcome, Record};
use serde::Serialize;

use crate::block::{self, Block, Rows, Section, Table, cell, or_dash};
use crate::figures;
use crate::page::figure;
use crate::subject::{Prospect, Subject, agree, pluralise};
use crate::words;

const FIGURE: &str = "Share of configurations that still succeed, by radius of the perturbation: a configuration \
     counts up to a radius if it succeeds nominally and at every radius that was run, up to and \
     including this one. L1, L2 and L3 are the paper's levels. A configuration fails somewhere \
     between two radii that were run: the dashed lines are the smallest and the largest possible \
     share. The diamond marks the radius at which half of all configurations still succeed; the \
     whisker is the 95 % interval of this radius.";

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
    pub condition: Condition,
    pub task: TaskRef,
    pub config: u16,
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

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    NominalFails,
    NominalUnknown,
    Between,
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
        let mut prospect =
            Prospect { sought: measurement.rays().count() as u64, most_rollouts: BTreeMap::new() };
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

    /// Writes the measurement as text for a terminal of 80 columns.
    pub fn text(&self) -> String {
        block::text(&self.section().blocks)
    }

    /// Returns the section of a report.
    pub(crate) fn section(&self) -> Section<'_> {
        let curves: Vec<&Curve> = self.curves.iter().filter(|curve| curve.n > 0).collect();
        let figure = || figure(FIGURE, figures::of_thresholds(self));
        let summary = format!("{} {}.", self.measured_by, self.describe_progress());
        let mut blocks = vec![
            Block::Paragraph(summary),
            Block::Html(Box::new(figure)),
            Block::Folded(survival(&curves)),
            Block::Table(half_success(&curves)),
        ];
        let latency = curves.iter().find(|curve| curve.condition.sets_execution());
        blocks.extend(latency.map(|curve| Block::Paragraph(tolerated_delay(curve))));
        if curves.iter().any(|curve| !curve.is_bisected) {
            let words = "Where language is perturbed, there are wordings at L1, L2 and L3 and at \
                         no radius between or beyond.";
            blocks.push(Block::Paragraph(words.to_owned()));
        }
        let recovered = self.thresholds.iter().filter(|of| !of.recovers_at.is_empty());
        let name = "Not monotone: configurations that succeed again beyond a failure";
        let recovered = Rows::new(name, recovered)
            .key("task", |of| cell(of.task))
            .key("condition", |of| cell(of.condition.name()))
            .key("configuration", |of| cell(format!("c{:02}", of.config)))
            .words("succeeds at", |of| cell(of.radii(true)))
            .words("fails at", |of| cell(of.radii(false)));
        blocks.push(Block::Table(recovered.table()));
        Section { title: "Thresholds".to_owned(), blocks }
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

/// Share of configurations that still succeed, by condition and radius of the grid.
fn survival(curves: &[&Curve]) -> Table {
    // Conditions that perturb the language axis have a shorter grid.
    let longest = curves.iter().max_by(|a, b| a.largest_radius.total_cmp(&b.largest_radius));
    let grid = longest.map(|curve| curve.grid.as_slice()).unwrap_or_default();
    let mut rows = Rows::new("Configurations that still succeed, %, by radius", curves)
        .key("condition", |curve| cell(curve.condition.name()))
        .column("n", "", "", |curve| cell(curve.n));
    for radius in [0.0].into_iter().chain(grid.iter().copied()) {
        let level = Level::of_radius(radius).filter(|level| level.is_named());
        let name = level.map_or_else(|| radius.to_string(), |level| level.to_string());
        rows = rows.column(name, "", "", |curve| {
            or_dash(curve.at(radius).map(|point| words::percent(point.survival)))
        });
    }
    rows.table()
}

/// The radius at which half of the configurations still succeed, by condition.
fn half_success(curves: &[&Curve]) -> Table {
    let left_out: u64 = curves.iter().map(|curve| curve.left_out).sum();
    Rows::new("Radius at which half of the configurations still succeed", curves)
        .key("condition", |curve| cell(curve.condition.name()))
        .column("n", "", "", |curve| cell(curve.n))
        .column("radius", "", "", |curve| cell(words::half_success(curve)))
        .column("95 %", "", "", |curve| cell(words::half_success_interval(&curve.half_success)))
        .column("nominal fails", "", "", |curve| cell(curve.nominal_fails))
        .column("beyond", "", "succeed at the largest radius", |curve| cell(curve.beyond))
        .column("not monotone", "", "", |curve| cell(curve.not_monotone))
        .when(left_out > 0, |rows| {
            let note = "thresholds in no figure, because outcomes are missing or in quarantine";
            rows.column("left out", "", note, |curve| cell(curve.left_out))
        })
        .table()
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
            "Latency: half of the configurations succeed with a delay of {}; a radius of 2 is one \
             step.",
            delay(radius)
        ),
        None if curve.beyond * 2 > curve.n => format!(
            "Latency: more than half of the configurations succeed with a delay of {}, the longest \
             that was run.",
            delay(curve.largest_radius)
        ),
        None => "Latency: fewer than half of the configurations succeed without a delay, or the \
                 share that succeeds with a delay is not known."
            .to_owned(),
    }
}
