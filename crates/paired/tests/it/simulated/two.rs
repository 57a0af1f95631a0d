//! Campaigns of two policies, A and B, whose true differences are known.

use benchmark::attempt::GoalProgress;
use benchmark::{Condition, Directions, Level};
use paired::{Bootstrap, Compared, Comparison, Progress, Record};

use super::{
    CONDITIONS, CONFIGURATIONS, Chance, Effects, Population, conditions, logistic, normal_points,
    record, task,
};

/// Rows of a comparison: the conditions at L2, then nominal.
const ROWS: usize = CONDITIONS + 1;
/// Control steps after which a rollout without success ends.
const BUDGET: f64 = 300.0;
/// Measures of one row: success, the goal's share, steps, and the probability of improvement.
pub(crate) const MEASURES: [&str; 4] = ["A - B", "goal", "steps", "A better"];

/// True values of A − B by measure and row; the last measure is the probability of improvement.
pub(crate) type Truth = [[f64; ROWS]; 4];

/// Returns the row of a condition in [`Truth`]; the last row for nominal rollouts.
pub(crate) fn row(condition: Condition) -> usize {
    let row = conditions().position(|other| other == condition);
    row.unwrap_or(CONDITIONS)
}

struct Policy {
    population: Population,
    /// Probability that a failed rollout satisfied one of the goal's two predicates.
    half_done: f64,
    /// Mean number of control steps of a success in a task of mean length.
    steps: f64,
}

impl Policy {
    fn logit(&self, suite: usize, row: usize) -> f64 {
        let costs = &self.population.costs;
        self.population.ease[suite] - costs.get(row).copied().unwrap_or_default()
    }

    /// Returns the means of success, the goal's share and steps, given the probability of success
    /// and the task's length.
    fn means(&self, success: f64, length: f64) -> [f64; 3] {
        [
            success,
            success + (1.0 - success) * self.half_done / 2.0,
            success * self.steps * length + (1.0 - success) * BUDGET,
        ]
    }

    /// Runs a rollout; returns its success, steps and progress.
    fn rollout(&self, success: f64, length: f64, chance: &mut Chance) -> (bool, u32, GoalProgress) {
        let succeeds = chance.uniform() < success;
        let at_most = if succeeds { 2 } else { u32::from(chance.uniform() < self.half_done) };
        let steps = match succeeds {
            // Random rounding preserves the mean.
            true => {
                self.steps * length * (0.8 + 0.4 * chance.uniform()) + chance.uniform().min(0.999)
            }
            false => BUDGET,
        };
        let goal = GoalProgress { predicates: 2, at_end: at_most, at_most };
        (succeeds, steps as u32, goal)
    }
}

/// Effects of tasks or directions on both policies.
pub(crate) struct PairedEffects {
    /// Effects on A and on B.
    effects: [Effects; 2],
    /// Relative lengths of tasks, with mean 1; empty for directions.
    lengths: Vec<f64>,
}

/// Two policies with correlated task difficulty and different costs of the axes.
pub(crate) struct TwoPolicies([Policy; 2]);

impl TwoPolicies {
    /// Returns two policies that differ in the difficulty of suites, the costs of axes, and
    /// progress.
    pub(crate) const fn standard() -> Self {
        let first = Policy { population: Population::standard(), half_done: 0.5, steps: 120.0 };
        let second = Policy {
            population: Population {
                ease: [2.4, 3.3, 2.0, 1.5],
                costs: [0.6, 1.2, 0.7, 0.1, 0.9, 0.1, 1.4],
                deviations: Population::standard().deviations,
            },
            half_done: 0.3,
            steps: 140.0,
        };
        Self([first, second])
    }

    fn deviations(&self) -> [f64; 3] {
        self.0[0].population.deviations
    }

    /// Draws tasks. The effect of a task on all conditions is common to both policies; the effects
    /// of a task on single conditions are separate.
    pub(crate) fn tasks(&self, tasks: usize, chance: &mut Chance) -> PairedEffects {
        let [task_deviation, condition_deviation, _] = self.deviations();
        let task_effects = (0..tasks).map(|_| task_deviation * chance.normal());
        let task_effects: Vec<f64> = task_effects.collect();
        let mut effects = || -> Effects {
            let condition_effects = |task_effect: &f64| {
                std::array::from_fn(|_| task_effect + condition_deviation * chance.normal())
            };
            task_effects.iter().map(condition_effects).collect()
        };
        PairedEffects {
            effects: [effects(), effects()],
            lengths: (0..tasks).map(|_| 0.5 + chance.uniform()).collect(),
        }
    }

    /// Draws directions. Half of the variance of their effects is common to both policies.
    pub(crate) fn directions(&self, chance: &mut Chance) -> PairedEffects {
        let drawn = [(); 3].map(|()| self.0[0].population.directions(CONFIGURATIONS, chance));
        let [common, first, second] = drawn;
        let sum = |separate: Effects| -> Effects {
            let each = common.iter().zip(separate);
            let sum = each.map(|(common, separate)| {
                std::array::from_fn(|row| (common[row] + separate[row]) * 0.5_f64.sqrt())
            });
            sum.collect()
        };
        PairedEffects { effects: [sum(first), sum(second)], lengths: Vec::new() }
    }

    /// Returns A − B over tasks and directions. Tasks take the suites in turn: those of suite k are
    /// at positions k, k + suites, …. The probability of improvement, which is about new tasks, is
    /// NaN.
    pub(crate) fn truth(
        &self,
        tasks: &PairedEffects,
        suites: usize,
        directions: &PairedEffects,
    ) -> Truth {
        let mut truth = [[0.0; ROWS]; 4];
        truth[3] = [f64::NAN; ROWS];
        for (sign, index) in [(1.0, 0), (-1.0, 1)] {
            let policy = &self.0[index];
            for (task_index, (effects, length)) in
                tasks.effects[index].iter().zip(&tasks.lengths).enumerate()
            {
                for row in 0..ROWS {
                    let logit = policy.logit(task_index % suites, row) + effects[row];
                    let directions = directions.effects[index].iter();
                    let each = directions.map(|direction| logistic(logit + direction[row]));
                    let success = each.sum::<f64>() / f64::from(CONFIGURATIONS);
                    for (truth, mean) in truth.iter_mut().zip(policy.means(success, *length)) {
                        truth[row] += sign * mean / tasks.lengths.len() as f64;
                    }
                }
            }
        }
        truth
    }

    /// Returns the exact A − B over all tasks of the first suites, under the given directions or
    /// under all directions. The probability of improvement, which has no interval about new
    /// directions, is NaN under all directions.
    pub(crate) fn truth_of_all_tasks(
        &self,
        suites: usize,
        directions: Option<&PairedEffects>,
    ) -> Truth {
        let [task_deviation, condition_deviation, direction_deviation] = self.deviations();
        let no_effects: Effects = vec![[0.0; ROWS]];
        let mut truth = [[0.0; ROWS]; 4];
        for (sign, index) in [(1.0, 0), (-1.0, 1)] {
            let policy = &self.0[index];
            let known_effects = directions.map(|directions| &directions.effects[index]);
            let directions = known_effects.unwrap_or(&no_effects);
            for row in 0..ROWS {
                // Nominal rollouts have no direction.
                let direction_spread = match known_effects {
                    None if row < CONDITIONS => direction_deviation,
                    _ => 0.0,
                };
                let spread = task_deviation.hypot(condition_deviation).hypot(direction_spread);
                let mut success = 0.0;
                for suite in 0..suites {
                    for direction in directions {
                        let logit = policy.logit(suite, row) + direction[row];
                        success += normal_points()
                            .map(|(z, weight)| weight * logistic(logit + spread * z))
                            .sum::<f64>();
                    }
                }
                success /= (suites * directions.len()) as f64;
                for (truth, mean) in truth.iter_mut().zip(policy.means(success, 1.0)) {
                    truth[row] += sign * mean;
                }
            }
        }
        truth[3] = match directions {
            Some(directions) => self.improvement(suites, directions),
            None => [f64::NAN; ROWS],
        };
        truth
    }

    /// Returns the probability that, in a random task, A succeeds in more configurations than B;
    /// ties count half.
    ///
    /// Given the directions and the effect that a task has on all conditions, the outcomes of the
    /// policies are independent.
    fn improvement(&self, suites: usize, directions: &PairedEffects) -> [f64; ROWS] {
        let [task_deviation, condition_deviation, _] = self.deviations();
        let mut improvement = [0.0; ROWS];
        for suite in 0..suites {
            for (row, improvement) in improvement.iter_mut().enumerate() {
                for (z_task, weight) in normal_points() {
                    let [a, b] = [0, 1].map(|index| {
                        let logit = self.0[index].logit(suite, row) + task_deviation * z_task;
                        let mut counts = [0.0; CONFIGURATIONS as usize + 1];
                        for (z, weight) in normal_points() {
                            let logit = logit + condition_deviation * z;
                            let each = directions.effects[index].iter();
                            let probabilities =
                                successes(each.map(|effects| logistic(logit + effects[row])));
                            let terms = counts.iter_mut().zip(probabilities);
                            terms.for_each(|(count, p)| *count += weight * p);
                        }
                        counts
                    });
                    let mut below = 0.0;
                    for (a, b) in a.iter().zip(b) {
                        *improvement += weight * a * (below + b / 2.0) / suites as f64;
                        below += b;
                    }
                }
            }
        }
        improvement
    }

    /// Simulates a campaign of each policy at L2, with nominal rollouts, and compares them. Tasks
    /// take the suites in turn.
    pub(crate) fn compare(
        &self,
        tasks: &PairedEffects,
        suites: usize,
        directions: &PairedEffects,
        chance: &mut Chance,
    ) -> Comparison {
        let [a, b] = [0, 1].map(|index| self.campaign(index, tasks, suites, directions, chance));
        let [a, b] = [&a, &b].map(|(records, progress)| Compared {
            records,
            progress,
            directions: Directions::Shared,
            has_rows: false,
        });
        Comparison::of(a, b, &Bootstrap::default(), |_| None)
    }

    fn campaign(
        &self,
        index: usize,
        tasks: &PairedEffects,
        suites: usize,
        directions: &PairedEffects,
        chance: &mut Chance,
    ) -> (Vec<Record>, Vec<Progress>) {
        let policy = &self.0[index];
        let (mut records, mut progress) = (Vec::new(), Vec::new());
        for (task_index, effects) in tasks.effects[index].iter().enumerate() {
            for (config, direction) in (0..).zip(&directions.effects[index]) {
                let conditions = conditions().chain([Condition::Nominal]);
                for (row, condition) in conditions.enumerate() {
                    let logit =
                        policy.logit(task_index % suites, row) + effects[row] + direction[row];
                    let (success, steps, goal) =
                        policy.rollout(logistic(logit), tasks.lengths[task_index], chance);
                    let task = task(task_index, suites);
                    let record = record(task, condition, Level::L2, config, success);
                    records.push(record);
                    progress.push(Progress {
                        id: record.id,
                        replicate: 0,
                        steps: Some(steps),
                        goal: Some(goal),
                    });
                }
            }
        }
        (records, progress)
    }
}

/// Returns the probability of each number of successes of independent rollouts.
fn successes(probabilities: impl Iterator<Item = f64>) -> [f64; CONFIGURATIONS as usize + 1] {
    let mut counts = [0.0; CONFIGURATIONS as usize + 1];
    counts[0] = 1.0;
    for p in probabilities {
        for count in (1..counts.len()).rev() {
            counts[count] = counts[count] * (1.0 - p) + counts[count - 1] * p;
        }
        counts[0] *= 1.0 - p;
    }
    counts
}
