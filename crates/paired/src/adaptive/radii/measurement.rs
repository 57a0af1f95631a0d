//! The rays of a campaign, from its records and those of the campaign that runs further
//! radii, and the allocation of a budget of rollouts to the rays.

use std::collections::{BTreeMap, BTreeSet};

use crate::{Bootstrap, Outcome, Record};
use benchmark::{AxisSet, Condition, Level, RolloutId, TaskRef, Thresholds};

use super::curve::Curve;
use super::next::next;
use super::ray::Ray;
use super::search::Search;
use super::threshold::Finding;
use crate::adaptive::decision::Decision;
use crate::adaptive::outcomes::Outcomes;
use crate::adaptive::source::{decisive, rank};

type Configuration = (TaskRef, u16);

/// Outcomes, searches and sample of a campaign whose thresholds are measured.
#[derive(Clone, Debug)]
pub struct Measurement {
    thresholds: Thresholds,
    rays: BTreeMap<Ray, Outcomes<Level>>,
    searches: BTreeMap<Condition, Search>,
    /// Upper bound of the number of further rollouts of each configuration.
    costs: BTreeMap<Configuration, u32>,
    sample: BTreeSet<Configuration>,
}

impl Measurement {
    /// Combines the records of the measured campaign, `source`, with those of the campaign
    /// that runs further radii, `further`.
    pub fn of(source: &[Record], further: &[Record], thresholds: &Thresholds) -> Self {
        let source = decisive(source, false);
        let nominal = source.iter().filter(|record| record.id.condition() == Condition::Nominal);
        let nominal: BTreeMap<RolloutId, Outcome> =
            nominal.map(|record| (record.id, record.outcome)).collect();
        let is_measured = |condition: Condition| {
            let conditions = &thresholds.conditions;
            let is_named = conditions.is_empty() || conditions.contains(&condition);
            is_named && condition != Condition::Nominal
        };
        let mut axes = AxisSet::EMPTY;
        let mut rays: BTreeMap<Ray, Outcomes<Level>> = BTreeMap::new();
        for record in &source {
            let condition = record.id.condition();
            axes = axes.union(single_axis(condition));
            if is_measured(condition) {
                let nominal_id = RolloutId::nominal(record.id.task(), record.init_id);
                let nominal = nominal.get(&nominal_id).copied().unwrap_or_default();
                let outcomes = rays.entry(ray(record.id));
                let outcomes = outcomes.or_insert_with(|| Outcomes::from_nominal(nominal));
                outcomes.record_source(record.id.level(), record.outcome);
            }
        }
        let conditions: BTreeSet<Condition> = rays.keys().map(|ray| ray.condition).collect();
        let search = |condition| (condition, Search::of(thresholds, condition, axes));
        let searches: BTreeMap<Condition, Search> = conditions.into_iter().map(search).collect();
        let mut costs: BTreeMap<Configuration, u32> = BTreeMap::new();
        for (ray, outcomes) in &rays {
            let is_supplied = |level| outcomes.at(level).is_some();
            let most_rollouts = searches[&ray.condition].most_rollouts(is_supplied);
            *costs.entry((ray.task, ray.config)).or_default() += most_rollouts;
        }
        for record in further {
            if let Some(outcomes) = rays.get_mut(&ray(record.id)) {
                outcomes.record(record.id.level(), record.outcome);
            }
        }
        Self {
            thresholds: thresholds.clone(),
            sample: sample(&costs, thresholds),
            costs,
            rays,
            searches,
        }
    }

    /// Returns the rays of the sampled configurations with the outcomes along them, in the order
    /// of condition, task and configuration.
    pub fn rays(&self) -> impl Iterator<Item = (Ray, &Outcomes<Level>)> {
        let rays = self.rays.iter();
        let measured = rays.filter(|(ray, _)| self.sample.contains(&(ray.task, ray.config)));
        measured.map(|(&ray, outcomes)| (ray, outcomes))
    }

    /// Returns the number of rays, whether or not their configurations are sampled.
    pub fn ray_count(&self) -> usize {
        self.rays.len()
    }

    pub fn searches(&self) -> impl Iterator<Item = (Condition, &Search)> {
        self.searches.iter().map(|(&condition, search)| (condition, search))
    }

    /// Returns the upper bound of the number of further rollouts of any single configuration.
    pub fn most_rollouts_per_configuration(&self) -> u32 {
        self.costs.values().copied().max().unwrap_or_default()
    }

    /// Returns the upper bound of the number of further rollouts of each sampled configuration.
    pub fn most_rollouts(&self) -> impl Iterator<Item = (TaskRef, u32)> {
        let sampled =
            self.costs.iter().filter(|(configuration, _)| self.sample.contains(configuration));
        sampled.map(|((task, _), most)| (*task, *most))
    }

    /// Returns a ray's threshold, as far as known.
    pub fn finding(&self, ray: Ray, outcomes: &Outcomes<Level>) -> Finding {
        Finding::new(outcomes, &self.searches[&ray.condition])
    }

    pub fn decision(&self, ray: Ray, outcomes: &Outcomes<Level>) -> Decision<Level> {
        next(outcomes, &self.searches[&ray.condition])
    }

    /// Returns the rollouts to run next, in order; empty if every threshold is found, all
    /// needed rollouts are requested, or the budget is used up.
    pub fn plan(&self) -> Vec<(Ray, Level)> {
        let requested: u32 = self.rays.values().map(Outcomes::requested).sum();
        let budget_left = self.thresholds.budget.unwrap_or(u32::MAX).saturating_sub(requested);
        let requests = self.rays().flat_map(|(ray, outcomes)| {
            let levels = match self.decision(ray, outcomes) {
                Decision::Run(levels) => levels,
                Decision::Wait | Decision::Done => Vec::new(),
            };
            levels.into_iter().map(move |level| (ray, level))
        });
        let mut requests: Vec<(Ray, Level)> = requests.collect();
        // Sorted by the number of the configuration first, so that early results cover all tasks.
        requests.sort_by_key(|(ray, level)| (ray.config, ray.task, ray.condition, *level));
        // The sample fits the budget. Requests are removed only if quarantined rollouts were
        // retried after their brackets had been halved without their outcomes.
        requests.truncate(budget_left as usize);
        requests
    }

    /// Returns the curves of configurations that still succeed at each radius, by condition.
    pub fn curves(&self, bootstrap: &Bootstrap) -> Vec<Curve> {
        let curve = |(condition, search): (Condition, &Search)| {
            let rays = self.rays().filter(|(ray, _)| ray.condition == condition);
            let findings: Vec<(TaskRef, Finding)> =
                rays.map(|(ray, outcomes)| (ray.task, self.finding(ray, outcomes))).collect();
            Curve::new(condition, search, &findings, bootstrap)
        };
        self.searches().map(curve).collect()
    }
}

fn ray(id: RolloutId) -> Ray {
    Ray { condition: id.condition(), task: id.task(), config: id.number() }
}

fn single_axis(condition: Condition) -> AxisSet {
    match condition {
        Condition::Single(axis) => AxisSet::of(axis),
        _ => AxisSet::EMPTY,
    }
}

/// Selects the configurations to measure: all of them, or as many as the budget covers in the
/// worst case.
///
/// The choice depends on the seed and the campaign's rows but on no outcome, so that it is a random
/// sample. Each round takes one configuration of every task, so that a small sample has many tasks.
/// A configuration is taken with all its conditions, so that these are compared over the same
/// configurations.
fn sample(
    costs: &BTreeMap<Configuration, u32>,
    thresholds: &Thresholds,
) -> BTreeSet<Configuration> {
    let Some(budget) = thresholds.budget else {
        return costs.keys().copied().collect();
    };
    let mut by_task: BTreeMap<TaskRef, Vec<(u64, u16)>> = BTreeMap::new();
    for &(task, config) in costs.keys() {
        let configs = by_task.entry(task).or_default();
        let name = RolloutId::perturbed(task, Condition::Simultaneous, Level::L1, config);
        let name = name.expect("simultaneous at L1 is perturbed");
        configs.push((rank(&name, thresholds.seed), config));
    }
    let mut order = Vec::new();
    for (task, mut configs) in by_task {
        configs.sort_unstable();
        let configs = configs.into_iter().enumerate();
        order.extend(configs.map(|(round, (rank, config))| (round, rank, (task, config))));
    }
    order.sort_unstable();
    let mut budget_left = budget;
    let affordable = order.into_iter().map_while(|(_, _, configuration)| {
        budget_left = budget_left.checked_sub(costs[&configuration])?;
        Some(configuration)
    });
    affordable.collect()
}
