//! Smallest detectable differences of a campaign, for `coordinator campaign create --dry-run`. The
//! power calculation is in `paired`.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Condition, Level, RolloutId, TaskRef};
use paired::Detectable;
use queue::expand::NewCampaign;
use serde::Serialize;
use terminal::{counted, wrapped};

/// Smallest detectable differences at one level, as printed by `--json`.
#[derive(Debug, Serialize)]
pub(super) struct Planned {
    level: Level,
    tasks: usize,
    configurations: usize,
    #[serde(flatten)]
    detectable: Detectable,
}

/// Plans the levels with simultaneous perturbation, except L0.
pub(super) fn plan(campaign: &NewCampaign) -> Vec<Planned> {
    let mut units: BTreeMap<Level, BTreeSet<(TaskRef, u16)>> = BTreeMap::new();
    let ids = campaign.jobs.iter().filter(|job| job.replicate == 0);
    for id in ids.filter_map(|job| job.rollout_id.parse::<RolloutId>().ok()) {
        if id.condition() == Condition::Simultaneous && !id.is_placebo() {
            units.entry(id.level()).or_default().insert((id.task(), id.number()));
        }
    }
    let planned = |(level, units): (Level, BTreeSet<(TaskRef, u16)>)| {
        let tasks = units.iter().map(|(task, _)| *task).collect::<BTreeSet<_>>().len();
        let configurations = units.len();
        Planned {
            level,
            tasks,
            configurations,
            detectable: Detectable::at(level, tasks, configurations),
        }
    };
    units.into_iter().map(planned).collect()
}

/// Formats the planning for a terminal; `None` if the campaign has no simultaneous perturbation.
pub(super) fn describe(planning: &[Planned]) -> Option<String> {
    let lines = planning.iter().map(|planned| {
        let Planned { level, tasks, configurations, detectable } = planned;
        let assumed = match detectable.assumed_level == *level {
            true => String::new(),
            false => format!(" (outcomes assumed as at {})", detectable.assumed_level),
        };
        let configurations = counted(*configurations as u64, "configuration");
        let size = format!("{configurations} of {}", counted(*tasks as u64, "task"));
        let points = |fraction| format!("{:.1} points", 100.0 * fraction);
        let difference = detectable.difference.map(|difference| {
            format!("a difference of two policies (A - B) of {}", points(difference))
        });
        let i = detectable.i.map(|i| format!("I at {} from 0", points(i)));
        let mut differences = [difference, i].into_iter().flatten().collect::<Vec<_>>().join(", ");
        if differences.is_empty() {
            differences = "none; more tasks make smaller differences detectable, and an interval \
                           needs at least 10 tasks"
                .to_owned();
        }
        wrapped("  ", 4, &format!("{level}{assumed}, {size}: {differences}"))
    });
    let lines: Vec<String> = lines.collect();
    (!lines.is_empty()).then(|| {
        let heading = "smallest differences that the campaign detects in new tasks with a power of \
                       80 % (two-sided test at 5 %), if its outcomes are like the student's \
                       published ones (examples/student):";
        format!("{}\n{}", wrapped("", 2, heading), lines.join("\n"))
    })
}
