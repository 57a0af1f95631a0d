//! One configuration: its nominal rollout, each axis alone, and all at once,
//! side by side.

use std::collections::BTreeMap;

use maud::{Markup, html};
use paired::{Matched, Outcome, Record, Records, Transition};
use protocol::{Axis, Condition, ManifestRow, RolloutId};
use queue::ids::{JobId, shortened};
use queue::read::{Campaign, FailureLine, ResultLine, RolloutLine, View};

use super::campaign::address;
use super::card::{self, Shown};
use super::layout::{Place, Sheet};
use super::problem::Problem;
use super::state::Page;
use super::trace::{self, Extent, Path};

/// The page.
pub(super) async fn sheet(
    page: &Page,
    name: &str,
    rollout: &str,
    query: &str,
) -> Result<Sheet, Problem> {
    let (campaign, mut view) = page.campaign(name).await?;
    let name = &campaign.name;
    let unknown = || Problem::Rollout {
        campaign: name.to_string(),
        rollout: shortened(rollout, 80).to_owned(),
    };
    let asked: RolloutId = rollout.parse().map_err(|_| unknown())?;
    let replicate = replicate(query)?;
    let replicates = view.replicates(campaign.id, &asked.to_string()).await?;
    if !replicates.contains(&replicate) {
        return Err(unknown());
    }
    let shown = rollouts(&mut view, &campaign, asked, replicate).await?;
    let Some(first) = shown.iter().find(|shown| shown.id == asked) else {
        return Err(unknown());
    };
    let neighbours = neighbours(&mut view, &campaign, asked).await?;
    let campaign = name.as_str();
    let extent = Extent::of(shown.iter().map(|shown| &shown.path));
    let nominal = shown
        .iter()
        .find(|shown| shown.id.condition() == Condition::Clean);
    let trace = |rollout: &Shown| {
        let is_other = |nominal: &&Shown| nominal.id != rollout.id;
        let under = nominal.filter(is_other).map(|nominal| &nominal.path);
        let drawn = !rollout.path.is_empty();
        extent
            .as_ref()
            .filter(|_| drawn)
            .map(|extent| trace::plot(&rollout.path, under, extent))
    };
    let main = html! {
        p.crumbs {
            a href="/" { "Campaigns" } " › "
            a href={ "/campaigns/" (campaign) } { (campaign) }
        }
        h1 { (heading(asked)) }
        p.instruction { "“" (first.row.id.task().instruction()) "”" }
        p {
            code { (asked.task()) } ", initial state " (first.row.init_id)
            @if let Some(said) = transition(&shown, replicate) { ". " strong { (said) } }
        }
        (ways(campaign, asked, replicate, &replicates, &neighbours))
        @if shown.iter().filter(|shown| shown.video_bytes().is_some()).count() > 1 {
            (card::video_controls())
        }
        div.rollouts {
            @for rollout in &shown {
                (card::card(campaign, rollout, replicate, trace(rollout)))
            }
        }
    };
    Ok(Sheet {
        title: format!("{asked} in {name}"),
        place: Place::Campaigns,
        main,
    })
}

/// The replicate that a query names; 0 where it names none.
pub(super) fn replicate(query: &str) -> Result<u32, Problem> {
    let mut pairs = form_urlencoded::parse(query.as_bytes());
    match pairs.find(|(name, _)| name == "replicate") {
        None => Ok(0),
        Some((_, value)) => value
            .parse()
            .map_err(|_| Problem::Query("A replicate is a number: ?replicate=1 is the second.")),
    }
}

/// The rollouts of a configuration that the campaign has, nominal first.
async fn rollouts(
    view: &mut View,
    campaign: &Campaign,
    asked: RolloutId,
    replicate: u32,
) -> Result<Vec<Shown>, Problem> {
    let mut ids = siblings(asked);
    let mut lines = view.rollouts(campaign.id, &ids, replicate).await?;
    let init_id = lines.iter().find_map(|line| Some(read(line).ok()?.init_id));
    if let (Some(init_id), Some(_)) = (init_id, asked.config()) {
        let nominal = RolloutId::clean(asked.task(), init_id).to_string();
        let of = std::slice::from_ref(&nominal);
        lines.extend(view.rollouts(campaign.id, of, replicate).await?);
        ids.insert(0, nominal);
    }
    let jobs: Vec<JobId> = lines.iter().map(|line| line.id).collect();
    let results = view.results(&jobs).await?.into_iter();
    let mut results: BTreeMap<JobId, ResultLine> = results.map(|it| (it.job_id, it)).collect();
    let mut failures: BTreeMap<JobId, Vec<FailureLine>> = BTreeMap::new();
    for failure in view.failures(&jobs).await? {
        failures.entry(failure.job_id).or_default().push(failure);
    }
    let paths = view.paths(&jobs).await?.into_iter();
    let mut paths: BTreeMap<JobId, Path> = paths
        .map(|(job, motion)| (job, trace::read(&motion)))
        .collect();
    lines.sort_by_key(|line| ids.iter().position(|id| *id == line.rollout_id));
    let shown = lines.into_iter().map(|line| {
        let row = read(&line)?;
        Ok(Shown {
            id: row.id,
            row,
            result: results.remove(&line.id),
            failures: failures.remove(&line.id).unwrap_or_default(),
            path: paths.remove(&line.id).unwrap_or_default(),
            line,
        })
    });
    shown.collect()
}

fn read(line: &RolloutLine) -> Result<ManifestRow, Problem> {
    serde_json::from_str(&line.manifest_row).map_err(|error| Problem::failed(&error))
}

/// The ids of what is compared with a rollout, itself among them, in the order
/// in which they are shown.
fn siblings(asked: RolloutId) -> Vec<String> {
    let Some(config) = asked.config() else {
        return vec![asked.to_string()];
    };
    let singles = Axis::ALL.into_iter().map(Condition::Single);
    let ids = singles
        .chain([Condition::Combination])
        .filter_map(|condition| {
            RolloutId::perturbed(asked.task(), condition, asked.level(), config).ok()
        });
    ids.map(|id| id.to_string()).collect()
}

/// The rollouts of the same task and condition, by level and configuration.
async fn neighbours(
    view: &mut View,
    campaign: &Campaign,
    asked: RolloutId,
) -> Result<Vec<RolloutId>, Problem> {
    let (suite, task) = (asked.task().suite().short_name(), asked.task().index());
    let prefix = format!("{suite}/t{task}/{}/", asked.condition());
    let ids = view.beginning(campaign.id, &prefix).await?;
    let mut ids: Vec<RolloutId> = ids.iter().filter_map(|id| id.parse().ok()).collect();
    ids.sort();
    Ok(ids)
}

/// Where one can go from here: other replicates, levels and configurations.
fn ways(
    campaign: &str,
    asked: RolloutId,
    replicate: u32,
    replicates: &[u32],
    neighbours: &[RolloutId],
) -> Markup {
    let here = |id: &&RolloutId| id.level() == asked.level();
    let row: Vec<&RolloutId> = neighbours.iter().filter(here).collect();
    let place = row.iter().position(|id| **id == asked);
    let before = place.and_then(|place| row.get(place.checked_sub(1)?));
    let after = place.and_then(|place| row.get(place + 1));
    let levels = neighbours.iter().filter(|id| id.number() == asked.number());
    let levels: Vec<&RolloutId> = levels.collect();
    let to = |id: RolloutId, replicate| address(campaign, id, replicate);
    html! {
        nav.ways aria-label="Other configurations" {
            @if let Some(id) = before { a rel="prev" href=(to(**id, replicate)) { "← " (number(**id)) } }
            @if let Some(id) = after { a rel="next" href=(to(**id, replicate)) { (number(**id)) " →" } }
            @if levels.len() > 1 {
                span {
                    "Level "
                    @for id in levels {
                        @let current = (*id == asked).then_some("true");
                        a href=(to(*id, replicate)) aria-current=[current] { (id.level()) } " "
                    }
                }
            }
            @if replicates.len() > 1 {
                span {
                    "Replicate "
                    @for k in replicates {
                        @let current = (*k == replicate).then_some("true");
                        a href=(to(asked, *k)) aria-current=[current] { (k) } " "
                    }
                }
            }
        }
    }
}

fn number(id: RolloutId) -> String {
    match id.config() {
        Some(config) => format!("configuration {config}"),
        None => format!("initial state {}", id.number()),
    }
}

fn heading(asked: RolloutId) -> String {
    let task = asked.task();
    let (suite, index) = (task.suite().name(), task.index());
    match asked.config() {
        Some(config) => {
            let level = asked.level();
            format!("{suite}, task {index}, configuration {config} at {level}")
        }
        None => {
            let state = asked.number();
            format!("{suite}, task {index}, nominal from initial state {state}")
        }
    }
}

/// What perturbing everything at once did, in words, once it is known.
fn transition(shown: &[Shown], replicate: u32) -> Option<&'static str> {
    let records: Vec<Record> = shown
        .iter()
        .map(|shown| Record {
            id: shown.id,
            init_id: shown.row.init_id,
            replicate,
            outcome: match &shown.result {
                Some(result) => Outcome::from(result.success),
                None => Outcome::Missing,
            },
        })
        .collect();
    let records = Records::new(&records).ok()?;
    let transition = records
        .configurations()
        .iter()
        .find_map(Matched::transition)?;
    Some(match transition {
        Transition::Emergent => "Emergent: every axis alone succeeds, all at once fail.",
        Transition::Compensated => "Compensated: an axis alone fails, all at once succeed.",
        Transition::StillSucceeds => "Every axis alone succeeds, and so do all at once.",
        Transition::StillFails => "An axis alone fails, and so do all at once.",
    })
}
