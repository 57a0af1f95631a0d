//! Comparison of two policies, A and B, rollout by rollout: pairs the rollouts and computes
//! the difference under every condition at every level.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Axis, Condition, Directions, Level, RolloutId};
use serde::{Deserialize, Serialize};

use crate::bootstrap::Bootstrap;
use crate::difference::{Difference, DifferenceBounds, Pair};
use crate::outcomes::{Outcome, Record};
use crate::progress::{Progress, ProgressDifference, ProgressPair};

/// Reason why a rollout with the same id for both policies is not compared: its setup
/// differs between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Obstacle {
    /// The rollouts start from different initial states of the task.
    InitialState,
    /// The digests of the scene or the initial state differ.
    Scene,
    /// Perturbation, instruction or step budget differ.
    Perturbation,
    /// *Simultaneous* perturbs different axes.
    Axes,
}

impl Obstacle {
    /// Describes the difference: `another scene`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::InitialState => "another initial state",
            Self::Scene => "another scene",
            Self::Perturbation => "another perturbation, instruction or step budget",
            Self::Axes => "simultaneous perturbation of other axes",
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Compared<'a> {
    /// Rollouts of the policy, with or without an outcome.
    pub records: &'a [Record],
    /// Progress of the rollouts with an outcome, as far as known.
    pub progress: &'a [Progress],
    /// Assignment of directions to configurations in the policy's campaign.
    pub directions: Directions,
    /// True if the caller knows the rows that were run, so that it compares the perturbed axes.
    pub has_rows: bool,
}

/// Records without progress, of a campaign whose tasks share their directions.
impl<'a> From<&'a [Record]> for Compared<'a> {
    fn from(records: &'a [Record]) -> Self {
        Self { records, progress: &[], directions: Directions::Shared, has_rows: false }
    }
}

/// Result of comparing two policies.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Cells by level (nominal first) and condition.
    pub cells: Vec<ComparedCell>,
    /// Assignment of directions that the intervals assume: `Own` if both campaigns have it,
    /// otherwise `Shared`, which makes no interval narrower.
    pub directions: Directions,
    pub only_in_a: u64,
    pub only_in_b: u64,
    /// Rollouts that both policies have but that cannot be paired, by reason.
    pub unpaired: BTreeMap<Obstacle, Vec<RolloutId>>,
}

/// One condition at one level, with the rollouts of all replicates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ComparedCell {
    /// The level; L0 for nominal rollouts.
    pub level: Level,
    pub condition: Condition,
    /// Rollouts that can be paired.
    pub shared: u64,
    /// Rollouts that are missing for A or for B; excluded from all figures.
    pub missing: u64,
    /// Rollouts missing for neither policy and quarantined for at least one; excluded from
    /// the rates, included in `bounds`.
    pub quarantined: u64,
    /// Difference over the rollouts with an outcome for both policies; absent if there are none.
    pub difference: Option<Difference>,
    /// A − B in each replicate; empty if there is only one.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub by_replicate: BTreeMap<u32, f64>,
    /// Differences in partial progress; absent if no rollout has an outcome and known progress for
    /// both policies.
    pub progress: Option<ProgressDifference>,
    /// Worst and best case; absent if `quarantined` is 0.
    pub bounds: Option<DifferenceBounds>,
}

/// Largest number of unpaired rollouts that are named per reason; further ones are only counted.
const MAX_NAMED: usize = 3;

type Key = (u32, RolloutId);

/// The rollouts of one cell, the progress of those with an outcome and progress for both policies,
/// and A − B of each rollout by replicate.
type Cell = (Vec<Pair>, Vec<ProgressPair>, BTreeMap<u32, Vec<i8>>);

impl Comparison {
    /// Compares the records of A and B. Initial states and the axes of *simultaneous* are
    /// checked here; `obstacle` is called for every common rollout that passes these checks,
    /// and checks properties that are not in the records.
    ///
    /// Replicates are paired by number. If a rollout is recorded twice, only its last record
    /// is used; [`Records`](crate::Records) rejects such input.
    pub fn of<'a>(
        a: impl Into<Compared<'a>>,
        b: impl Into<Compared<'a>>,
        bootstrap: &Bootstrap,
        obstacle: impl Fn(&Record) -> Option<Obstacle>,
    ) -> Self {
        let policies: [Compared<'a>; 2] = [a.into(), b.into()];
        let [records_a, records_b] = policies.map(|policy| {
            let by_key =
                policy.records.iter().map(|record| ((record.replicate, record.id), record));
            by_key.collect::<BTreeMap<Key, &Record>>()
        });
        let progress = policies.map(|policy| {
            let by_key = policy
                .progress
                .iter()
                .map(|progress| ((progress.replicate, progress.id), progress));
            by_key.collect::<BTreeMap<Key, &Progress>>()
        });
        let axes = policies.map(|policy| axes(policy.records));
        let has_rows = policies.iter().all(|policy| policy.has_rows);
        let mut comparison = Self {
            directions: match policies.map(|policy| policy.directions) {
                [Directions::Own, Directions::Own] => Directions::Own,
                _ => Directions::Shared,
            },
            ..Self::default()
        };
        let mut cells: BTreeMap<(Level, Condition), Cell> = BTreeMap::new();
        for (key, record) in &records_a {
            let Some(record_b) = records_b.get(key) else {
                comparison.only_in_a += 1;
                continue;
            };
            let id = record.id;
            // Without rollouts under single axes, records do not tell which axes are combined, but
            // rows do.
            let combined = axes.each_ref().map(|axes| axes.get(&id.level()));
            let is_told = combined.iter().all(Option::is_some) || !has_rows;
            let reason = if id.condition() == Condition::Simultaneous
                && is_told
                && combined[0] != combined[1]
            {
                Some(Obstacle::Axes)
            } else if record.init_id != record_b.init_id {
                Some(Obstacle::InitialState)
            } else {
                obstacle(record)
            };
            if let Some(obstacle) = reason {
                comparison.unpaired.entry(obstacle).or_default().push(id);
                continue;
            }
            let cell = (id.level(), id.condition());
            let (pairs, progress_pairs, by_replicate) = cells.entry(cell).or_default();
            let pair = Pair {
                task: id.task(),
                number: id.config().unwrap_or(record.init_id),
                a: record.outcome,
                b: record_b.outcome,
            };
            let outcomes = pair.a.success().zip(pair.b.success());
            if let Some((a, b)) = outcomes {
                let differences = by_replicate.entry(record.replicate).or_default();
                differences.push(i8::from(a) - i8::from(b));
            }
            if let [Some(a), Some(b)] = progress.each_ref().map(|by_key| by_key.get(key))
                && outcomes.is_some()
            {
                progress_pairs.push(ProgressPair {
                    task: pair.task,
                    number: pair.number,
                    progress: [**a, **b],
                });
            }
            pairs.push(pair);
        }
        let is_only_in_b = |key: &&Key| !records_a.contains_key(key);
        comparison.only_in_b = records_b.keys().filter(is_only_in_b).count() as u64;
        let (mut keys, mut sets, mut progress_pairs) = (Vec::new(), Vec::new(), Vec::new());
        for ((level, condition), (pairs, progress, by_replicate)) in cells {
            let mean =
                |of: &Vec<i8>| of.iter().copied().map(f64::from).sum::<f64>() / of.len() as f64;
            let means = by_replicate.iter().filter(|_| by_replicate.len() > 1);
            let means: BTreeMap<u32, f64> = means.map(|(k, of)| (*k, mean(of))).collect();
            keys.push((level, condition, means));
            sets.push(pairs);
            progress_pairs.push(progress);
        }
        // Initial states, which take the place of directions in nominal rollouts, have the
        // same numbers in all tasks.
        let directions = keys.iter().map(|(_, condition, _)| match condition {
            Condition::Nominal => Directions::Shared,
            _ => comparison.directions,
        });
        let directions: Vec<Directions> = directions.collect();
        let differences = Difference::of_sets(&sets, &directions, bootstrap);
        let progress = ProgressDifference::of_each(&progress_pairs, &directions);
        let cells = keys.into_iter().zip(&sets).zip(differences).zip(progress);
        comparison.cells = cells
            .map(|((((level, condition, by_replicate), pairs), difference), progress)| {
                let missing = pairs.iter().filter(|pair| has_either(pair, Outcome::Missing));
                let missing = missing.count() as u64;
                let n = difference.as_ref().map_or(0, |difference| difference.n);
                let shared = pairs.len() as u64;
                ComparedCell {
                    level,
                    condition,
                    shared,
                    missing,
                    quarantined: shared - missing - n,
                    difference,
                    by_replicate,
                    progress,
                    bounds: DifferenceBounds::of(pairs),
                }
            })
            .collect();
        comparison
    }

    pub fn compared(&self) -> u64 {
        let cells = self.cells.iter().filter_map(|cell| cell.difference.as_ref());
        cells.map(|difference| difference.n).sum()
    }

    /// Returns lines about the rollouts that are in no cell: for each obstacle, the number of
    /// rollouts and the names of some; then the numbers of rollouts that only one policy has.
    pub fn left_out(&self) -> Vec<String> {
        let reasons = self.unpaired.iter();
        let mut lines: Vec<String> = reasons
            .map(|(obstacle, ids)| {
                let named = ids[..ids.len().min(MAX_NAMED)].iter();
                let named: Vec<String> = named.map(ToString::to_string).collect();
                let more = match ids.len().saturating_sub(MAX_NAMED) {
                    0 => String::new(),
                    more => format!(" and {more} more"),
                };
                let rollouts = counted(ids.len() as u64);
                let named = named.join(", ");
                format!(
                    "{rollouts} that both policies have cannot be paired ({}): {named}{more}",
                    obstacle.name()
                )
            })
            .collect();
        match (self.only_in_a, self.only_in_b) {
            (0, 0) => {}
            (a, b) => lines.push(format!(
                "left out: {} that only A has, {} that only B has",
                counted(a),
                counted(b)
            )),
        }
        lines
    }

    /// Returns the number of rollouts that can be paired, with or without outcomes.
    pub fn shared(&self) -> u64 {
        self.cells.iter().map(|cell| cell.shared).sum()
    }
}

impl ComparedCell {
    /// Returns `nominal` or a name such as `L2 camera`.
    pub fn name(&self) -> String {
        match self.condition {
            Condition::Nominal => self.condition.name().to_owned(),
            condition => format!("{} {}", self.level, condition.name()),
        }
    }
}

fn counted(rollouts: u64) -> String {
    match rollouts {
        1 => "1 rollout".to_owned(),
        many => format!("{many} rollouts"),
    }
}

fn has_either(pair: &Pair, outcome: Outcome) -> bool {
    pair.a == outcome || pair.b == outcome
}

/// Returns the axes that are perturbed alone at each level, which are also the axes that
/// *simultaneous* perturbs.
fn axes(records: &[Record]) -> BTreeMap<Level, BTreeSet<Axis>> {
    let mut axes: BTreeMap<Level, BTreeSet<Axis>> = BTreeMap::new();
    for record in records {
        if let Condition::Single(axis) = record.id.condition()
            && axis.def().is_combined
        {
            axes.entry(record.id.level()).or_default().insert(axis);
        }
    }
    axes
}
