//! Page of one configuration: its rollouts under all conditions side by side.

use std::collections::BTreeMap;

use benchmark::attempt::Motion;
use benchmark::{Axis, AxisSet, Condition, ManifestRow, RolloutId};
use maud::{Markup, html};
use paired::{Matched, Outcome, Record, Records, Transition};
use queue::ids::{JobId, shortened};
use queue::read::{Campaign, FailureLine, ResultLine, RolloutLine, View};

use super::campaign::address;
use super::card::{self, ShownRollout};
use super::layout::{Sheet, Tab, crumbs};
use super::problem::Problem;
use super::state::Page;
use super::subsets;
use super::trace::{self, Extent};

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
    let requested: RolloutId = rollout.parse().map_err(|_| unknown())?;
    let replicate = replicate(query)?;
    let replicates = view.replicates(campaign.id, &requested.to_string()).await?;
    if !replicates.contains(&replicate) {
        return Err(unknown());
    }
    let shown = rollouts(&mut view, &campaign, requested, replicate).await?;
    let Some(requested_rollout) = shown.iter().find(|shown| shown.id == requested) else {
        return Err(unknown());
    };
    let neighbours = neighbours(&mut view, &campaign, requested).await?;
    let subsets = subsets::section(&mut view, &campaign, requested).await?;
    let filmed = shown.iter().filter(|shown| shown.video_bytes().is_some());
    let videos = filmed.count() + subsets.films;
    let campaign = name.as_str();
    let extent = Extent::from_paths(shown.iter().map(|shown| &shown.path));
    let is_nominal = |shown: &&ShownRollout| shown.id.condition() == Condition::Nominal;
    let nominal = shown.iter().find(is_nominal);
    let trace = |rollout: &ShownRollout| {
        let is_other = |nominal: &&ShownRollout| nominal.id != rollout.id;
        let nominal_path = nominal.filter(is_other).map(|nominal| &nominal.path);
        let extent = extent.as_ref().filter(|_| !rollout.path.is_empty())?;
        Some(trace::plot(&rollout.path, nominal_path, extent))
    };
    let main = html! {
        (crumbs(campaign))
        h1 { (heading(requested)) }
        p.instruction { "“" (requested_rollout.row.id.task().instruction()) "”" }
        p {
            code { (requested.task()) } ", initial state " (requested_rollout.row.init_id)
            @if let Some(effect) = transition(&shown, replicate) { ". " strong { (effect) } }
        }
        (navigation_links(campaign, requested, replicate, &replicates, &neighbours))
        @if videos > 1 { (card::video_controls()) }
        (subsets.markup)
        @if !subsets.is_empty() { h2 { "Each rollout" } }
        div.rollouts {
            @for rollout in &shown {
                (card::card(campaign, rollout, replicate, trace(rollout)))
            }
        }
    };
    let title = format!("{requested} in {name}");
    Ok(Sheet::new(Tab::Campaigns, title, main))
}

/// Parses the `replicate` parameter of a query; 0 if absent.
pub(super) fn replicate(query: &str) -> Result<u32, Problem> {
    let mut pairs = form_urlencoded::parse(query.as_bytes());
    match pairs.find(|(name, _)| name == "replicate") {
        None => Ok(0),
        Some((_, value)) => value
            .parse()
            .map_err(|_| Problem::Query("A replicate is a number: ?replicate=1 is the second.")),
    }
}

/// Reads the campaign's rollouts of a configuration, nominal first.
async fn rollouts(
    view: &mut View,
    campaign: &Campaign,
    requested: RolloutId,
    replicate: u32,
) -> Result<Vec<ShownRollout>, Problem> {
    let mut ids = siblings(requested);
    let mut lines = view.rollouts(campaign.id, &ids, replicate).await?;
    let init_id = lines.iter().find_map(|line| Some(read(line).ok()?.init_id));
    if let (Some(init_id), Some(_)) = (init_id, requested.config()) {
        let nominal = RolloutId::nominal(requested.task(), init_id).to_string();
        let nominal_ids = std::slice::from_ref(&nominal);
        lines.extend(view.rollouts(campaign.id, nominal_ids, replicate).await?);
        ids.insert(0, nominal);
    }
    let jobs: Vec<JobId> = lines.iter().map(|line| line.id).collect();
    let results = view.results(&jobs).await?.into_iter();
    let mut results: BTreeMap<JobId, ResultLine> =
        results.map(|result| (result.job_id, result)).collect();
    let mut failures: BTreeMap<JobId, Vec<FailureLine>> = BTreeMap::new();
    for failure in view.failures(&jobs).await? {
        failures.entry(failure.job_id).or_default().push(failure);
    }
    let mut motions: BTreeMap<JobId, Motion> = view.paths(&jobs).await?.into_iter().collect();
    lines.sort_by_key(|line| ids.iter().position(|id| *id == line.rollout_id));
    let shown = lines.into_iter().map(|line| {
        let row = read(&line)?;
        Ok(ShownRollout {
            id: row.id,
            row,
            result: results.remove(&line.id),
            failures: failures.remove(&line.id).unwrap_or_default(),
            path: trace::read(&motions.remove(&line.id).unwrap_or_default()),
            line,
        })
    });
    shown.collect()
}

fn read(line: &RolloutLine) -> Result<ManifestRow, Problem> {
    serde_json::from_str(&line.manifest_row).map_err(|error| Problem::failed(&error))
}

/// Returns the ids of a configuration's perturbed rollouts under all conditions, `requested`
/// included, in display order; `requested` alone if it is nominal.
fn siblings(requested: RolloutId) -> Vec<String> {
    let Some(config) = requested.config() else {
        return vec![requested.to_string()];
    };
    // The simultaneous rollout comes first, beside the nominal one, since the two are usually
    // compared.
    let subset_conditions = AxisSet::ALL.subsets().into_iter().map(Condition::of);
    let conditions = [Condition::Simultaneous].into_iter().chain(subset_conditions);
    let others = Axis::every().filter(|axis| !axis.def().is_combined);
    let conditions = conditions.chain(others.map(Condition::Single));
    let id =
        |condition| RolloutId::perturbed(requested.task(), condition, requested.level(), config);
    let ids = conditions.filter_map(|condition| id(condition).ok());
    ids.map(|id| id.to_string()).collect()
}

/// Returns the ids of the campaign's rollouts of the task and condition of `requested`, sorted.
async fn neighbours(
    view: &mut View,
    campaign: &Campaign,
    requested: RolloutId,
) -> Result<Vec<RolloutId>, Problem> {
    let (suite, task) = (requested.task().suite().short_name(), requested.task().index());
    let prefix = format!("{suite}/t{task}/{}/", requested.condition());
    let ids = view.rollout_ids_with_prefix(campaign.id, &prefix).await?;
    let mut ids: Vec<RolloutId> = ids.iter().filter_map(|id| id.parse().ok()).collect();
    ids.sort();
    Ok(ids)
}

/// Renders links to other replicates, levels and configurations.
fn navigation_links(
    campaign: &str,
    requested: RolloutId,
    replicate: u32,
    replicates: &[u32],
    neighbours: &[RolloutId],
) -> Markup {
    let is_same_level = |id: &&RolloutId| id.level() == requested.level();
    let same_level: Vec<&RolloutId> = neighbours.iter().filter(is_same_level).collect();
    let index = same_level.iter().position(|id| **id == requested);
    let previous = index.and_then(|index| same_level.get(index.checked_sub(1)?));
    let next = index.and_then(|index| same_level.get(index + 1));
    let levels = neighbours.iter().filter(|id| id.number() == requested.number());
    let link = |id: RolloutId, replicate| address(campaign, id, replicate);
    let levels = levels.map(|id| (id.level().to_string(), link(*id, replicate)));
    let replicates =
        replicates.iter().map(|replicate| (replicate.to_string(), link(requested, *replicate)));
    let current = link(requested, replicate);
    html! {
        nav.ways aria-label="Other configurations" {
            @if let Some(id) = previous { a rel="prev" href=(link(**id, replicate)) { "← " (configuration_name(**id)) } }
            @if let Some(id) = next { a rel="next" href=(link(**id, replicate)) { (configuration_name(**id)) " →" } }
            (link_list("Level ", levels.collect(), &current))
            (link_list("Replicate ", replicates.collect(), &current))
        }
    }
}

/// Renders links, given as name and address; nothing if there is only one link.
fn link_list(label: &str, links: Vec<(String, String)>, current_address: &str) -> Markup {
    html! {
        @if links.len() > 1 {
            span {
                (label)
                @for (name, address) in links {
                    @let current = (address == current_address).then_some("true");
                    a href=(address) aria-current=[current] { (name) } " "
                }
            }
        }
    }
}

fn configuration_name(id: RolloutId) -> String {
    match id.config() {
        Some(config) => format!("configuration {config}"),
        None => format!("initial state {}", id.number()),
    }
}

fn heading(requested: RolloutId) -> String {
    let task = requested.task();
    let place_in_design = match requested.config() {
        Some(config) if requested.is_placebo() => {
            format!("configuration {config} at L0, the placebo level")
        }
        Some(config) => format!("configuration {config} at {}", requested.level()),
        None => match requested.variant() {
            Some(variant) if variant.benchmark().is_none() => {
                format!("from initial state {}", requested.number())
            }
            Some(variant) => format!("{variant} from initial state {}", requested.number()),
            None => format!("nominal from initial state {}", requested.number()),
        },
    };
    format!("{}, task {}, {place_in_design}", requested.suite_name(), task.index())
}

/// Describes the effect of simultaneous perturbation; `None` unless the outcomes under each axis
/// alone and under all axes are known.
fn transition(shown: &[ShownRollout], replicate: u32) -> Option<&'static str> {
    let records: Vec<Record> = shown
        .iter()
        .map(|shown| Record {
            id: shown.id,
            init_id: shown.row.init_id,
            replicate,
            outcome: match &shown.result {
                Some(result) => Outcome::from(result.outcome.success),
                None => Outcome::Missing,
            },
        })
        .collect();
    let records = Records::new(&records).ok()?;
    let mut configurations = records.configurations().iter();
    Some(match configurations.find_map(Matched::transition)? {
        Transition::Emergent => "Emergent: every axis alone succeeds, simultaneous fails.",
        Transition::Compensated => "Compensated: an axis alone fails, simultaneous succeeds.",
        Transition::StillSucceeds => "Every axis alone succeeds, and so does simultaneous.",
        Transition::StillFails => "An axis alone fails, and so does simultaneous.",
    })
}
