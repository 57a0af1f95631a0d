//! The smallest differences that a campaign can show: part of `coordinator campaign create
//! --dry-run`. The arithmetic is `paired`'s.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::anyhow;
use libero_ctrl::{Condition, Level, RolloutId, TaskRef};
use paired::{Against, Assumed, Detectable, Planned};
use queue::expand::NewCampaign;
use serde::Serialize;
use terminal::{counted, wrapped};

use super::command::{CommandError, Connection, usage};

/// The assumed outcomes where none are named.
const STUDENT: &str = "the student's published ones (examples/student)";
/// The R_d of a placebo level that was not run: the student's (`examples/student_floor`), a fraction.
const ASSUMED_FLOOR: f64 = 0.115;

/// The smallest differences that a campaign can show, as `--json` has them.
#[derive(Debug, Serialize)]
pub(super) struct Planning {
    /// The outcomes that it is planned from.
    assumed_from: String,
    levels: Vec<PlannedLevel>,
}

/// Those of a level. Differences are fractions; none are found where they are absent.
#[derive(Debug, Serialize)]
struct PlannedLevel {
    level: Level,
    /// The level that the assumed outcomes are of.
    assumed_level: Level,
    tasks: u32,
    configurations: u32,
    new_tasks: Found,
    these_tasks: Found,
    /// R_d of the placebo level, as assumed; absent where the campaign has none, and R_d is
    /// compared with another policy's.
    floor: Option<f64>,
    floor_configurations: Option<u32>,
}

/// The smallest differences for one target of inference.
#[derive(Debug, Serialize)]
struct Found {
    difference: Option<f64>,
    i: Option<f64>,
    r_d: Option<f64>,
}

impl From<Detectable> for Found {
    fn from(found: Detectable) -> Self {
        Self {
            difference: found.difference,
            i: found.i,
            r_d: found.r_d,
        }
    }
}

impl Planning {
    /// Plans a campaign from the outcomes of `earlier`, a campaign or a folder of result rows.
    /// Without it, from the student's published ones.
    pub(super) async fn of(
        campaign: &NewCampaign,
        earlier: Option<&str>,
        connection: &Connection,
    ) -> Result<Planning, CommandError> {
        let (assumed_from, assumed) = match earlier {
            None => (STUDENT.to_owned(), Assumed::STUDENT.to_vec()),
            Some(earlier) => {
                let path = Path::new(earlier);
                let subject = match path.exists() {
                    true => report::import(path).map_err(usage)?,
                    false => connection.client()?.report(earlier).await?,
                };
                let assumed = Assumed::of(&subject.counted()).map_err(usage)?;
                if Assumed::nearest(&assumed, Level::L2).is_none() {
                    return Err(usage(anyhow!(
                        "plan from {earlier}: no configuration has an outcome under each axis \
                         and simultaneously; name a campaign or a folder with such outcomes"
                    )));
                }
                (format!("those of {earlier}"), assumed)
            }
        };
        Ok(Planning {
            levels: levels(campaign, &assumed),
            assumed_from,
        })
    }
}

fn levels(campaign: &NewCampaign, assumed: &[Assumed]) -> Vec<PlannedLevel> {
    let planned = configurations(campaign);
    let floor = planned.get(&Level::L0).copied();
    let known_floor = assumed.iter().find(|it| it.level == Level::L0);
    let perturbed = planned.iter().filter(|(level, _)| **level != Level::L0);
    let of_level = |(&level, &planned): (&Level, &Planned)| {
        let like = Assumed::nearest(assumed, level)?;
        let r_d = known_floor.map_or(ASSUMED_FLOOR, |it| it.r_d);
        let against = match floor {
            Some(planned) => Against::Floor { r_d, planned },
            None => Against::AnotherPolicy,
        };
        Some(PlannedLevel {
            level,
            assumed_level: like.level,
            tasks: planned.tasks,
            configurations: planned.count(),
            new_tasks: like.detectable(planned, against).into(),
            these_tasks: like.of_these_tasks().detectable(planned, against).into(),
            floor: floor.map(|_| r_d),
            floor_configurations: floor.map(|it| it.count()),
        })
    };
    perturbed.filter_map(of_level).collect()
}

/// The configurations of each level that run under several axes, each alone and at once.
fn configurations(campaign: &NewCampaign) -> BTreeMap<Level, Planned> {
    let mut units: BTreeMap<Level, BTreeSet<(TaskRef, u16)>> = BTreeMap::new();
    let ids = campaign.jobs.iter().filter(|job| job.replicate == 0);
    for id in ids.filter_map(|job| job.rollout_id.parse::<RolloutId>().ok()) {
        if id.condition() == Condition::Combination {
            units
                .entry(id.level())
                .or_default()
                .insert((id.task(), id.number()));
        }
    }
    let planned = |units: &BTreeSet<(TaskRef, u16)>| {
        let tasks: BTreeSet<TaskRef> = units.iter().map(|(task, _)| *task).collect();
        Planned {
            tasks: tasks.len() as u32,
            configs_per_task: units.len() as f64 / tasks.len() as f64,
        }
    };
    units
        .iter()
        .map(|(&level, units)| (level, planned(units)))
        .collect()
}

/// The same for a terminal; none of a campaign without simultaneous perturbation.
pub(super) fn in_words(planning: &Planning) -> Option<String> {
    if planning.levels.is_empty() {
        return None;
    }
    let mut lines = vec![wrapped(
        "",
        2,
        &format!(
            "smallest differences that it finds with a power of 80 % (two-sided test at 5 %), \
             if its outcomes are like {}:",
            planning.assumed_from
        ),
    )];
    lines.extend(
        planning
            .levels
            .iter()
            .map(|it| wrapped("  ", 4, &of_level(it))),
    );
    Some(lines.join("\n"))
}

fn of_level(of: &PlannedLevel) -> String {
    let level = match of.level == of.assumed_level {
        true => of.level.to_string(),
        false => format!("{} (assumed as at {})", of.level, of.assumed_level),
    };
    let configurations = counted(of.configurations.into(), "configuration");
    let tasks = counted(of.tasks.into(), "task");
    let Found { difference, i, r_d } = &of.new_tasks;
    if (difference, i, r_d) == (&None, &None, &None) {
        return format!(
            "{level}, {configurations} of {tasks}: none; more tasks show more, and fewer than 10 \
             have no interval"
        );
    }
    let against = match (of.floor, of.floor_configurations) {
        (Some(floor), Some(count)) => format!(
            "above a floor of {:.1} % over {}",
            100.0 * floor,
            counted(count.into(), "configuration")
        ),
        _ => "from another policy's".to_owned(),
    };
    let these = &of.these_tasks;
    format!(
        "{level}, {configurations} of {tasks}: for new tasks A - B {} points, I {} from 0, R_d {} \
         {against}; for these tasks only {}, {} and {}",
        points(*difference),
        points(*i),
        points(*r_d),
        points(these.difference),
        points(these.i),
        points(these.r_d)
    )
}

/// A difference in points.
fn points(fraction: Option<f64>) -> String {
    fraction.map_or("none".to_owned(), |it| format!("{:.1}", 100.0 * it))
}
