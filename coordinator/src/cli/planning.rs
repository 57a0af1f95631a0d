//! Smallest detectable differences of a campaign, for `coordinator campaign create --dry-run`. The
//! power calculation is in `paired`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::anyhow;
use libero_ctrl::{Condition, Level, RolloutId, TaskRef};
use paired::{Against, Assumed, Detectable, Planned};
use queue::expand::NewCampaign;
use serde::Serialize;
use terminal::{counted, wrapped};

use super::command::{CommandError, Connection, usage};

/// Description of the outcomes assumed without `--planning-from`.
const STUDENT: &str = "the student's published outcomes (examples/student)";

/// Smallest detectable differences of a campaign, as printed by `--json`.
#[derive(Debug, Serialize)]
pub(super) struct Planning {
    /// Description of the outcomes on which the planning is based.
    assumed_from: String,
    levels: Vec<PlannedLevel>,
}

/// Smallest detectable differences at one level, as fractions. An absent value means that no
/// difference is detectable.
#[derive(Debug, Serialize)]
struct PlannedLevel {
    level: Level,
    /// Level at which the assumed outcomes were measured.
    assumed_level: Level,
    tasks: u32,
    configurations: u32,
    new_tasks: DetectableDifferences,
    these_tasks: DetectableDifferences,
    /// Assumed R_d of the placebo level; `None` if the campaign has no placebo level, in which case
    /// R_d is compared with that of another policy.
    floor: Option<f64>,
    floor_configurations: Option<u32>,
}

/// Smallest detectable differences for one target of inference: new tasks, or the campaign's own
/// tasks.
#[derive(Debug, Serialize)]
struct DetectableDifferences {
    difference: Option<f64>,
    i: Option<f64>,
    r_d: Option<f64>,
}

impl From<Detectable> for DetectableDifferences {
    fn from(detectable: Detectable) -> Self {
        Self { difference: detectable.difference, i: detectable.i, r_d: detectable.r_d }
    }
}

impl Planning {
    /// Plans a campaign from the outcomes of `planning_from`, a campaign or a folder of result
    /// rows; `None` stands for the student's published outcomes.
    pub(super) async fn compute(
        campaign: &NewCampaign,
        planning_from: Option<&str>,
        connection: &Connection,
    ) -> Result<Planning, CommandError> {
        let (assumed_from, assumed) = match planning_from {
            None => (STUDENT.to_owned(), Assumed::STUDENT.to_vec()),
            Some(name) => {
                let path = Path::new(name);
                let subject = match path.exists() {
                    true => report::import(path).map_err(usage)?,
                    false => connection.client()?.report(name).await?,
                };
                let assumed = Assumed::of(&subject.counted()).map_err(usage)?;
                if Assumed::nearest(&assumed, Level::L2).is_none() {
                    return Err(usage(anyhow!(
                        "plan from {name}: no configuration has an outcome under each axis \
                         alone and under all axes simultaneously; name a campaign or a folder \
                         with such outcomes"
                    )));
                }
                (format!("the outcomes of {name}"), assumed)
            }
        };
        Ok(Planning { levels: levels(campaign, &assumed), assumed_from })
    }
}

fn levels(campaign: &NewCampaign, assumed: &[Assumed]) -> Vec<PlannedLevel> {
    let planned = configurations(campaign);
    let floor = planned.get(&Level::L0).copied();
    let placebo =
        |levels: &[Assumed]| levels.iter().find(|level| level.level == Level::L0).copied();
    let assumed_floor = placebo(assumed).or_else(|| placebo(&Assumed::STUDENT));
    let perturbed = planned.iter().filter(|(level, _)| **level != Level::L0);
    let plan_level = |(&level, &planned): (&Level, &Planned)| {
        let nearest = Assumed::nearest(assumed, level)?;
        let r_d = assumed_floor?.r_d;
        let against = match floor {
            Some(planned) => Against::Floor { r_d, planned },
            None => Against::AnotherPolicy,
        };
        Some(PlannedLevel {
            level,
            assumed_level: nearest.level,
            tasks: planned.tasks,
            configurations: planned.count(),
            new_tasks: nearest.detectable(planned, against).into(),
            these_tasks: nearest.of_these_tasks().detectable(planned, against).into(),
            floor: floor.map(|_| r_d),
            floor_configurations: floor.map(|planned| planned.count()),
        })
    };
    perturbed.filter_map(plan_level).collect()
}

/// Counts, for each level, the tasks and configurations that run under simultaneous perturbation.
fn configurations(campaign: &NewCampaign) -> BTreeMap<Level, Planned> {
    let mut units: BTreeMap<Level, BTreeSet<(TaskRef, u16)>> = BTreeMap::new();
    let ids = campaign.jobs.iter().filter(|job| job.replicate == 0);
    for id in ids.filter_map(|job| job.rollout_id.parse::<RolloutId>().ok()) {
        if id.condition() == Condition::Combination {
            units.entry(id.level()).or_default().insert((id.task(), id.number()));
        }
    }
    let planned = |units: &BTreeSet<(TaskRef, u16)>| {
        let tasks: BTreeSet<TaskRef> = units.iter().map(|(task, _)| *task).collect();
        Planned {
            tasks: tasks.len() as u32,
            configs_per_task: units.len() as f64 / tasks.len() as f64,
        }
    };
    units.iter().map(|(&level, units)| (level, planned(units))).collect()
}

/// Formats the planning for a terminal; `None` if the campaign has no simultaneous perturbation.
pub(super) fn describe(planning: &Planning) -> Option<String> {
    if planning.levels.is_empty() {
        return None;
    }
    let mut lines = vec![wrapped(
        "",
        2,
        &format!(
            "smallest differences that the campaign detects with a power of 80 % (two-sided test \
             at 5 %), if its outcomes are like {}:",
            planning.assumed_from
        ),
    )];
    lines.extend(planning.levels.iter().map(|level| wrapped("  ", 4, &describe_level(level))));
    Some(lines.join("\n"))
}

fn describe_level(planned: &PlannedLevel) -> String {
    let level = match planned.level == planned.assumed_level {
        true => planned.level.to_string(),
        false => format!("{} (outcomes assumed as at {})", planned.level, planned.assumed_level),
    };
    let configurations = counted(planned.configurations.into(), "configuration");
    let tasks = counted(planned.tasks.into(), "task");
    let DetectableDifferences { difference, i, r_d } = &planned.new_tasks;
    if (difference, i, r_d) == (&None, &None, &None) {
        return format!(
            "{level}, {configurations} of {tasks}: none; more tasks make smaller differences \
             detectable, and an interval needs at least 10 tasks"
        );
    }
    let against = match (planned.floor, planned.floor_configurations) {
        (Some(floor), Some(count)) => format!(
            "above a floor of {:.1} % over {}",
            100.0 * floor,
            counted(count.into(), "configuration")
        ),
        _ => "from another policy's".to_owned(),
    };
    let own_tasks = &planned.these_tasks;
    format!(
        "{level}, {configurations} of {tasks}: for new tasks, a difference of two policies (A - B) \
         of {} points, I at {} points from 0, and R_d at {} points {against}; for the campaign's \
         own tasks only, {}, {} and {} points",
        points(*difference),
        points(*i),
        points(*r_d),
        points(own_tasks.difference),
        points(own_tasks.i),
        points(own_tasks.r_d)
    )
}

/// Formats a fraction in percentage points.
fn points(fraction: Option<f64>) -> String {
    fraction.map_or("none".to_owned(), |fraction| format!("{:.1}", 100.0 * fraction))
}
