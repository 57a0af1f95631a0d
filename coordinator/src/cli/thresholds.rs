//! `coordinator thresholds`: perturbation radii at which a policy's success turns to failure.

use std::path::PathBuf;

use anyhow::anyhow;
use benchmark::{
    CampaignSpec, Condition, Level, MAX_RADII, Purpose, Record, Rollouts, TOLERANCES, Thresholds,
};
use clap::Args;
use paired::adaptive::radii::{Measurement, Ray};
use report::{Subject, ThresholdReport, figures};
use terminal::{number, number_from};

use super::command::{CommandError, Connection, usage};
use super::files::write_figures;
use super::json;
use super::search::{CreateFlags, NextRow, Search};

/// Printed below the long help.
const EXAMPLES: &str = "\
Examples:
  coordinator thresholds first               # the findings, or the rollouts needed
  coordinator thresholds first --create --axes camera,simultaneous
  coordinator thresholds first --figures figures";

#[derive(Args, Debug)]
#[command(after_long_help = EXAMPLES)]
pub(super) struct ThresholdsArguments {
    /// Campaign whose configurations are run at further radii once it is finished.
    campaign: String,
    /// Name of the campaign that runs the further radii. [default: CAMPAIGN-thresholds]
    #[arg(long)]
    name: Option<String>,
    /// Axes, each alone, and `simultaneous` for all axes at once. [default: all conditions of the
    /// campaign]
    #[arg(long, value_name = "AXES", value_delimiter = ',', requires = "CreateFlags",
        value_parser = condition)]
    axes: Vec<Condition>,
    /// Largest width of the bracket between success and failure, in units of radius. [default: 0.5]
    #[arg(long, value_name = "R", requires = "CreateFlags", value_parser = radius(TOLERANCES))]
    tolerance: Option<f64>,
    /// The largest radius that is run. [default: 16]
    #[arg(long, value_name = "R", requires = "CreateFlags", value_parser = radius(MAX_RADII))]
    max_radius: Option<f64>,
    /// Maximum number of rollouts, spent on configurations in random order; if omitted, every
    /// configuration is measured.
    #[arg(long, value_name = "N", requires = "CreateFlags",
        value_parser = number(1..=u32::MAX, "rollouts"))]
    budget: Option<u32>,
    /// Seed of the random order in which configurations are measured. [default: 0]
    #[arg(long, requires = "CreateFlags", value_parser = number_from(0_u64, ""))]
    seed: Option<u64>,
    #[command(flatten)]
    create: CreateFlags,
    /// Print JSON, as docs/JSON.md describes it.
    #[arg(long)]
    json: bool,
    /// Write the survival curves as SVG files into a folder.
    #[arg(long, value_name = "DIR")]
    figures: Option<PathBuf>,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn thresholds(arguments: ThresholdsArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let default_name = || format!("{}-thresholds", arguments.campaign);
    let name = arguments.name.clone().unwrap_or_else(default_name);
    let thresholds = arguments.thresholds();
    let search = Search {
        source: &arguments.campaign,
        name: &name,
        command: "thresholds",
        sought: "threshold",
        purpose: Purpose::Thresholds(thresholds.clone()),
        record: Some(Record::None),
        must_exist: arguments.json || arguments.figures.is_some(),
    };
    let prospect = |source: &Subject| {
        ThresholdReport::check_budget(source, &thresholds).map_err(usage)?;
        Ok(ThresholdReport::prospect(source, &thresholds))
    };
    let next = |subject: &Subject, source: &CampaignSpec| next(subject, source, &thresholds);
    let Some(subject) = search.run_or_propose(&client, arguments.create, prospect, next).await?
    else {
        return Ok(());
    };
    let no_findings =
        || anyhow!("show the thresholds of `{name}`: the campaign measures no thresholds");
    let findings = ThresholdReport::of(&subject).ok_or_else(no_findings)?;
    if let Some(folder) = &arguments.figures {
        write_figures(&figures::of_thresholds(&findings), folder)?;
    }
    json::print_or(arguments.json, &findings, || findings.text())
}

/// Returns the next rollouts: the configurations of the measured campaign at further radii.
fn next(
    measuring: &Subject,
    source: &CampaignSpec,
    thresholds: &Thresholds,
) -> anyhow::Result<Vec<NextRow>> {
    // The search of another campaign is refused at its creation.
    let Rollouts::Design(design) = &source.rollouts else {
        return Ok(Vec::new());
    };
    let source_records = measuring.derived.as_ref().map_or(&[][..], |derived| &derived.records);
    let plan = Measurement::of(source_records, &measuring.records, thresholds).plan().into_iter();
    // Only replicate 0 decides whether a configuration succeeds at a radius.
    let row = |(ray, level): (Ray, Level)| {
        Ok((design.row_at(ray.task, ray.condition, level, ray.config)?, vec![0]))
    };
    plan.map(row).collect()
}

impl ThresholdsArguments {
    fn thresholds(&self) -> Thresholds {
        let mut conditions = self.axes.clone();
        conditions.sort();
        conditions.dedup();
        Thresholds {
            campaign: self.campaign.clone(),
            conditions,
            tolerance: self.tolerance.unwrap_or(Thresholds::DEFAULT_TOLERANCE),
            max_radius: self.max_radius.unwrap_or(Thresholds::DEFAULT_MAX_RADIUS),
            budget: self.budget,
            seed: self.seed.unwrap_or_default(),
        }
    }
}

fn condition(text: &str) -> Result<Condition, &'static str> {
    match text.parse() {
        Ok(Condition::Nominal) | Err(_) => Err("write axes such as camera,robot, or simultaneous"),
        Ok(condition) => Ok(condition),
    }
}

fn radius([low, high]: [f64; 2]) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| match text.parse() {
        Ok(radius) if (low..=high).contains(&radius) => Ok(radius),
        _ => Err(format!("write a radius, {low} to {high}")),
    }
}
