//! Campaigns of policies whose true success probabilities are known, for tests and the example
//! `coverage`.

use std::collections::BTreeMap;

use benchmark::{Axis, Condition, Level, RolloutId, Suite, TaskRef};
use paired::{Cell, Estimate, Outcome, Record};
use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

pub(crate) mod two;

/// Number of configurations of every task, which is also the number of directions.
pub(crate) const CONFIGURATIONS: u16 = 10;
const AXES: usize = Axis::ALL.len();
/// Conditions at a level: each axis alone, and simultaneous.
const CONDITIONS: usize = AXES + 1;

/// Generator of random numbers.
pub(crate) struct Chance(ChaCha12Rng);

impl Chance {
    /// Creates a generator; equal seeds give equal numbers.
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha12Rng::seed_from_u64(seed))
    }

    /// Draws a number uniformly from 0 to 1.
    pub(crate) fn uniform(&mut self) -> f64 {
        f64::from(self.0.next_u32()) / f64::from(u32::MAX)
    }

    /// Draws a standard normal number by the method of Box and Muller.
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().max(1e-300).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

pub(crate) fn record(
    task: TaskRef,
    condition: Condition,
    level: Level,
    config: u16,
    success: bool,
) -> Record {
    let id = match condition {
        Condition::Nominal => RolloutId::nominal(task, config),
        _ => RolloutId::perturbed(task, condition, level, config).expect("a perturbed rollout"),
    };
    Record { id, init_id: config, replicate: 0, outcome: Outcome::from(success) }
}

/// Returns the conditions at a level: each axis alone, then simultaneous.
pub(crate) fn conditions() -> impl Iterator<Item = Condition> {
    let singles = Axis::ALL.into_iter().map(Condition::Single);
    singles.chain([Condition::Simultaneous])
}

#[derive(Clone, Copy)]
struct Probabilities {
    nominal: f64,
    /// Probabilities for the placebo's seven rollouts: that all six single axes succeed and the
    /// simultaneous one fails, and that some single axis fails and the simultaneous one succeeds.
    floor: [f64; 2],
    /// Success probability under each axis alone at L2, then under simultaneous perturbation.
    perturbed: [f64; CONDITIONS],
}

/// Sums over configurations, from which all true values follow: 1, nominal success, conjunction,
/// emergent, compensated, the two probabilities of the floor, then success under each condition.
type Sums = [f64; 7 + CONDITIONS];

impl Probabilities {
    fn sums(&self) -> Sums {
        let conjunction: f64 = self.perturbed[..AXES].iter().product();
        let simultaneous = self.perturbed[AXES];
        let [floor_e, floor_c] = self.floor;
        let mut sums = [0.0; 7 + CONDITIONS];
        sums[..7].copy_from_slice(&[
            1.0,
            self.nominal,
            conjunction,
            conjunction * (1.0 - simultaneous),
            (1.0 - conjunction) * simultaneous,
            floor_e,
            floor_c,
        ]);
        sums[7..].copy_from_slice(&self.perturbed);
        sums
    }
}

fn logistic(logit: f64) -> f64 {
    1.0 / (1.0 + (-logit).exp())
}

/// Returns `Probabilities::floor` for a probability of nominal success.
fn floor(nominal: f64) -> [f64; 2] {
    let all = nominal.powi(AXES as i32);
    [all * (1.0 - nominal), (1.0 - all) * nominal]
}

/// Returns points and weights that integrate smooth functions of a standard normal number: the
/// trapezoidal rule, whose error for such functions falls faster than any power of the step.
fn normal_points() -> impl Iterator<Item = (f64, f64)> {
    const STEP: f64 = 0.5;
    let weight = |z: f64| STEP * (-z * z / 2.0).exp() / std::f64::consts::TAU.sqrt();
    (-14..=14).map(move |step| (STEP * f64::from(step), weight(STEP * f64::from(step))))
}

/// Parameters shared by the tasks and directions of a population.
pub(crate) struct Population {
    /// Logit of nominal success in each suite.
    ease: [f64; 4],
    costs: [f64; CONDITIONS],
    /// Standard deviations on the logit: of tasks, of a condition in a task, and of a
    /// direction.
    deviations: [f64; 3],
}

/// Random effects of tasks, or of directions, by condition; the last is on nominal rollouts.
type Effects = Vec<[f64; CONDITIONS + 1]>;

impl Population {
    /// Returns a population with suites of unequal difficulty, axes of unequal cost, and an effect
    /// of the direction.
    pub(crate) const fn standard() -> Self {
        Self {
            ease: [2.8, 3.2, 2.4, 1.4],
            costs: [1.4, 0.9, 0.7, 0.2, 0.5, 0.1, 2.2],
            deviations: [0.7, 0.4, 0.5],
        }
    }

    /// Draws the effects of tasks on each condition at L2, then on nominal rollouts.
    pub(crate) fn tasks(&self, tasks: usize, chance: &mut Chance) -> Effects {
        let draw_task = |_| {
            let task_effect = self.deviations[0] * chance.normal();
            std::array::from_fn(|_| task_effect + self.deviations[1] * chance.normal())
        };
        (0..tasks).map(draw_task).collect()
    }

    /// Draws the effects of directions on each condition at L2; directions have no effect on
    /// nominal rollouts.
    pub(crate) fn directions(&self, directions: u16, chance: &mut Chance) -> Effects {
        let draw_direction = |_| {
            let mut effects = [0.0; CONDITIONS + 1];
            for effect in &mut effects[..CONDITIONS] {
                *effect = self.deviations[2] * chance.normal();
            }
            effects
        };
        (0..directions).map(draw_direction).collect()
    }

    fn probabilities(
        &self,
        suite: usize,
        task: &[f64; CONDITIONS + 1],
        direction: &[f64; CONDITIONS + 1],
    ) -> Probabilities {
        let ease = self.ease[suite];
        let nominal = logistic(ease + task[CONDITIONS]);
        Probabilities {
            nominal,
            floor: floor(nominal),
            perturbed: std::array::from_fn(|k| {
                logistic(ease - self.costs[k] + task[k] + direction[k])
            }),
        }
    }

    /// Returns the true values of all figures over tasks and directions. Tasks take the suites in
    /// turn: those of suite k are at positions k, k + suites, ….
    pub(crate) fn truth(
        &self,
        tasks: &Effects,
        suites: usize,
        directions: &Effects,
    ) -> BTreeMap<&'static str, f64> {
        let mut sums = [0.0; 7 + CONDITIONS];
        for (task_index, task) in tasks.iter().enumerate() {
            for direction in directions {
                let terms = self.probabilities(task_index % suites, task, direction).sums();
                sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
            }
        }
        figures(&sums)
    }

    /// Returns the exact true values over all tasks of the first suites, under the given directions
    /// or under all directions.
    ///
    /// Given the effect that a task has on all conditions, the outcomes under different conditions
    /// are independent, so that only integrals over one normal number are needed. An average over
    /// drawn tasks would add sampling error: for 2,000 tasks, one seventh of the standard error of
    /// a campaign of 40 tasks.
    pub(crate) fn truth_of_all_tasks(
        &self,
        suites: usize,
        directions: Option<&Effects>,
    ) -> BTreeMap<&'static str, f64> {
        let [task_deviation, condition_deviation, direction_deviation] = self.deviations;
        let no_effects: Effects = vec![[0.0; CONDITIONS + 1]];
        let spread = match directions {
            Some(_) => condition_deviation,
            None => condition_deviation.hypot(direction_deviation),
        };
        let expected = |logit: f64| -> f64 {
            let points = normal_points();
            points.map(|(z, w)| w * logistic(logit + spread * z)).sum()
        };
        let mut sums = [0.0; 7 + CONDITIONS];
        for ease in &self.ease[..suites] {
            for direction in directions.unwrap_or(&no_effects) {
                for (z_task, weight) in normal_points() {
                    let logit = ease + task_deviation * z_task;
                    let mut nominal = [0.0; 3];
                    for (z, w) in normal_points() {
                        let p = logistic(logit + condition_deviation * z);
                        let [e, c] = floor(p);
                        let values = [p, e, c];
                        nominal.iter_mut().zip(values).for_each(|(sum, p)| *sum += w * p);
                    }
                    let probabilities = Probabilities {
                        nominal: nominal[0],
                        floor: [nominal[1], nominal[2]],
                        perturbed: std::array::from_fn(|k| {
                            expected(logit - self.costs[k] + direction[k])
                        }),
                    };
                    let terms = probabilities.sums().map(|term| weight * term);
                    sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
                }
            }
        }
        figures(&sums)
    }

    /// Simulates a campaign over tasks and directions at L0 and L2, with nominal rollouts. Tasks
    /// take the suites in turn.
    pub(crate) fn campaign(
        &self,
        tasks: &Effects,
        suites: usize,
        directions: &Effects,
        chance: &mut Chance,
    ) -> Vec<Record> {
        let mut records = Vec::new();
        for (task_index, effects) in tasks.iter().enumerate() {
            let task = task(task_index, suites);
            for (config, direction) in (0..).zip(directions) {
                let p = self.probabilities(task_index % suites, effects, direction);
                let mut coin = |p: f64| chance.uniform() < p;
                records.push(record(task, Condition::Nominal, Level::L0, config, coin(p.nominal)));
                for (condition, p_perturbed) in conditions().zip(p.perturbed) {
                    records.push(record(task, condition, Level::L0, config, coin(p.nominal)));
                    records.push(record(task, condition, Level::L2, config, coin(p_perturbed)));
                }
            }
        }
        records
    }
}

/// Returns all figures, computed from summed terms.
fn figures(sums: &Sums) -> BTreeMap<&'static str, f64> {
    let [n, nominal, conjunction, e, c, floor_e, floor_c, ..] = sums.map(|sum| sum / sums[0]);
    let rate = |sum: &f64| sum / sums[0];
    let axes: Vec<f64> = sums[7..7 + AXES].iter().map(rate).collect();
    let s_sim = rate(&sums[7 + AXES]);
    let s_indep: f64 = axes.iter().product();
    let prediction = nominal * axes.iter().map(|axis| axis / nominal).product::<f64>();
    [
        ("S_indep", s_indep),
        ("S_conj", conjunction),
        ("S_sim", s_sim),
        ("D", conjunction - s_indep),
        ("I", s_sim - conjunction),
        ("R_e", e),
        ("R_c", c),
        ("R_d", e + c),
        ("b / S_conj", e / conjunction),
        ("c / (1 - S_conj)", c / (n - conjunction)),
        ("relative independence", prediction),
        ("S_sim - relative", s_sim - prediction),
        ("nominal, matched", nominal),
        ("loss, camera", nominal - axes[0]),
        ("loss, language", nominal - axes[5]),
        ("loss, simultaneous", nominal - s_sim),
        ("floor of R_d", floor_e + floor_c),
        ("R_e - floor", e - floor_e),
        ("R_c - floor", c - floor_c),
        ("R_d - floor", e + c - floor_e - floor_c),
        ("I - floor", c - e - floor_c + floor_e),
    ]
    .into()
}

pub(crate) fn task(task_index: usize, suites: usize) -> TaskRef {
    let suite = Suite::ALL[task_index % suites];
    let suite_tasks = TaskRef::all().filter(|task| task.suite() == suite);
    suite_tasks.into_iter().nth(task_index / suites).expect("ten tasks a suite")
}

/// Returns all figures of a cell that have an interval for each target, by the names of
/// [`Population::truth`].
pub(crate) fn estimates(cell: &Cell) -> BTreeMap<&'static str, Estimate> {
    let inference = cell.inference.as_ref().expect("a complete configuration");
    let paired = &inference.paired;
    let relative = inference.relative.as_ref().expect("nominal rollouts");
    let loss = |condition: Condition| &inference.losses[&condition];
    let single = |axis| loss(Condition::Single(axis));
    let excess = inference.excess.as_ref().expect("a placebo");
    let mut estimates: BTreeMap<&'static str, Estimate> = [
        ("S_indep", paired.s_indep),
        ("S_conj", paired.s_conj),
        ("S_sim", paired.s_sim),
        ("D", paired.d),
        ("I", paired.i),
        ("R_e", paired.r_e),
        ("R_c", paired.r_c),
        ("R_d", paired.r_d),
        ("relative independence", relative.prediction),
        ("S_sim - relative", relative.difference),
        ("nominal, matched", relative.nominal),
        ("loss, camera", single(Axis::Camera).loss),
        ("loss, language", single(Axis::Language).loss),
        ("loss, simultaneous", loss(Condition::Simultaneous).loss),
        ("floor of R_d", excess.floor.r_d),
        ("R_e - floor", excess.excess.r_e),
        ("R_c - floor", excess.excess.r_c),
        ("R_d - floor", excess.excess.r_d),
        ("I - floor", excess.excess.i),
    ]
    .into();
    let eligible = [
        ("b / S_conj", inference.eligible.emergent),
        ("c / (1 - S_conj)", inference.eligible.compensated),
    ];
    let eligible = eligible.into_iter();
    estimates.extend(eligible.filter_map(|(name, estimate)| Some((name, estimate?))));
    estimates
}

/// Planted effect of a policy whose rollouts also fail by chance.
#[derive(Clone, Copy)]
pub(crate) enum Planted {
    /// No effect: every rollout is a coin flip under every condition.
    Coins,
    /// The camera makes three of ten configurations fail, alone and simultaneously. One in seven of
    /// the other configurations fails only simultaneously, which is 10 % of all configurations.
    Interaction,
    /// The camera makes three directions of ten fail in half of the tasks, alone and
    /// simultaneously.
    Directions,
}

impl Planted {
    /// Returns the success probability of a rollout without a planted failure.
    const fn base_success(self) -> f64 {
        match self {
            Self::Coins => 0.95,
            Self::Interaction | Self::Directions => 0.98,
        }
    }

    /// Simulates a campaign of 40 tasks and ten configurations at L0 and L2, with nominal rollouts.
    pub(crate) fn campaign(self, chance: &mut Chance) -> Vec<Record> {
        let mut records = Vec::new();
        for task_index in 0..40 {
            let task = task(task_index, 4);
            let has_failing_directions = chance.uniform() < 0.5;
            for config in 0..CONFIGURATIONS {
                let [camera, simultaneous] = match self {
                    Self::Coins => [false; 2],
                    Self::Interaction => [chance.uniform() < 0.3, chance.uniform() < 1.0 / 7.0],
                    Self::Directions => [has_failing_directions && config < 3, false],
                };
                let mut coin = |fails: bool| !fails && chance.uniform() < self.base_success();
                records.push(record(task, Condition::Nominal, Level::L0, config, coin(false)));
                for condition in conditions() {
                    let fails = match condition {
                        Condition::Single(Axis::Camera) => camera,
                        Condition::Simultaneous => camera || simultaneous,
                        _ => false,
                    };
                    records.push(record(task, condition, Level::L0, config, coin(false)));
                    records.push(record(task, condition, Level::L2, config, coin(fails)));
                }
            }
        }
        records
    }
}
