//! Confidence sequences about new tasks: about the population that the campaign's tasks were
//! drawn from, under the campaign's directions.
//!
//! # Estimand
//! The mean of a task is the mean of a measure over its configurations. The tasks of suite h are
//! independent draws from one population, and μ_h is the expectation of their means. An interval
//! is about the average of μ_h over the suites.
//!
//! # Proof of validity at all looks
//! Each round has one task of every suite. For numbers s (a bet) and c (a centre) that
//! depend on earlier rounds alone, and a task's mean x,
//! (1 + s·(x − c)) / (1 + s·(μ_h − c)) has the expectation 1, so that the product over all
//! tasks is a nonnegative martingale. −log of the denominators is convex in μ_h, so that by
//! Jensen's inequality the product is at least its value with the average m in place of every
//! μ_h, as s and c are the same for all tasks of a round. By Ville's inequality, the
//! probability that the average of this lower bound over two bets ever reaches 1/α at the true m
//! is at most α. There are no further assumptions about the tasks. Rounds that lack a suite are
//! ignored.
//!
//! # Sample size
//! A task's mean may have any value in the range. However many tasks have been observed, new
//! tasks that fail in all of their configurations remain possible, so that 40 tasks exclude I = 0
//! only if |I| is at least about 0.15. The command
//! `cargo run --release -p paired --example new_tasks` prints error rates and savings.
//!
//! # Sources
//! I. Waudby-Smith and A. Ramdas, Estimating means of bounded random variables by betting,
//! JRSS B 86 (2024), 1–27; D. Snyder et al., Is your imitation learning policy better than
//! mine? (STEP), arXiv 2503.10966.

use std::collections::{BTreeMap, BTreeSet};

use libero_ctrl::{Measure, TaskRef};

use crate::outcomes::Transition;
use crate::sequential::look::{Look, RateInterval};
use crate::sequential::measures::values;
use crate::sequential::order::{Drawn, Order, Unit};

/// Size of the two bets, on large and on small values, as a share of the largest bet that cannot
/// lose all capital. It is close to 1 because the optimal bet on a difference that few tasks can
/// show exceeds that limit.
const SIZE: f64 = 0.9;

/// Weight of the prior of the centre: a number of virtual tasks with the middle value of the
/// range.
const PRIOR_TASKS: f64 = 1.0;

/// Number of candidates for a mean per unit of its range.
const CANDIDATES: i64 = 2000;

/// Confidence sequences of some measures about new tasks. The intervals hold simultaneously, at all
/// looks, with a probability of at least 1 − α.
#[derive(Clone, Debug)]
pub(crate) struct NewTasks {
    /// Number of suites, which equals the number of tasks in a counted round.
    suites: usize,
    /// Number of configurations of each task.
    sizes: BTreeMap<TaskRef, usize>,
    units: usize,
    /// Number of configurations in the rounds that have every suite, which come first.
    counted: usize,
    used: usize,
    /// Number of complete configurations of the current task.
    completed_in_task: usize,
    /// Number of complete tasks of the current round.
    completed_in_round: usize,
    means: BTreeMap<Measure, Mean>,
}

/// The confidence sequence of one mean.
#[derive(Clone, Debug)]
struct Mean {
    alpha: f64,
    /// Least and greatest value of a configuration.
    range: [i64; 2],
    /// Least and greatest sum over the current task.
    task: [i64; 2],
    /// Least and greatest mean of each task of the current round.
    round: Vec<[f64; 2]>,
    /// Sum of the midpoints of all earlier means, and their number.
    earlier: [f64; 2],
    bets: [Bet; 2],
    /// Least and greatest candidate that is not ruled out, in units of 1/[`CANDIDATES`].
    kept: [i64; 2],
}

/// A bet on large or on small values.
#[derive(Clone, Debug)]
struct Bet {
    /// Relative size; negative for the bet on small values.
    size: f64,
    /// Log of the product of the numerators.
    gains: f64,
    /// Minus the log of the product of the denominators, by candidate.
    costs: Vec<f64>,
}

impl NewTasks {
    /// Creates the sequences before the first configuration of an order of whole tasks.
    pub(crate) fn new(order: &Order<Unit>, measures: BTreeSet<Measure>, alpha: f64) -> Self {
        let mut sizes: BTreeMap<TaskRef, usize> = BTreeMap::new();
        for (task, _) in order.units() {
            *sizes.entry(*task).or_default() += 1;
        }
        let alpha = alpha / measures.len() as f64;
        let suites = order.sizes().len();
        let has_all_suites = |round: &&Vec<Drawn<Unit>>| {
            let strata: BTreeSet<usize> = round.iter().map(|drawn| drawn.stratum).collect();
            strata.len() == suites
        };
        let complete = order.rounds().iter().take_while(has_all_suites);
        Self {
            counted: complete.map(Vec::len).sum(),
            suites,
            units: order.units().count(),
            sizes,
            used: 0,
            completed_in_task: 0,
            completed_in_round: 0,
            means: measures
                .into_iter()
                .map(|measure| (measure, Mean::new(measure, alpha)))
                .collect(),
        }
    }

    /// Adds the next configuration of the order with its possible transitions.
    pub(crate) fn complete(&mut self, (task, _): &Unit, possible: &[Transition]) {
        self.used += 1;
        if self.used > self.counted {
            return;
        }
        self.completed_in_task += 1;
        let size = self.sizes[task];
        let ends_task = self.completed_in_task == size;
        if ends_task {
            self.completed_in_task = 0;
            self.completed_in_round += 1;
        }
        let ends_round = self.completed_in_round == self.suites;
        if ends_round {
            self.completed_in_round = 0;
        }
        for (&measure, mean) in &mut self.means {
            let value = values(measure, possible);
            for end in [0, 1] {
                mean.task[end] += value[end];
            }
            if ends_task {
                mean.end_task(size);
            }
            if ends_round && ends_task {
                mean.end_round();
            }
        }
    }

    pub(crate) fn look(&self) -> Look {
        let intervals = self.means.iter();
        Look {
            used: self.used,
            waiting: 0,
            units: self.units,
            intervals: intervals.map(|(measure, mean)| (*measure, mean.interval())).collect(),
        }
    }
}

impl Mean {
    fn new(measure: Measure, alpha: f64) -> Self {
        let range = values(measure, &Transition::ALL);
        let kept = range.map(|end| end * CANDIDATES);
        let candidates = (kept[1] - kept[0] + 1) as usize;
        let bet = |size| Bet { size, gains: 0.0, costs: vec![0.0; candidates] };
        Self {
            alpha,
            range,
            task: [0; 2],
            round: Vec::new(),
            earlier: [0.0; 2],
            bets: [bet(SIZE), bet(-SIZE)],
            kept,
        }
    }

    fn end_task(&mut self, size: usize) {
        let sums = std::mem::take(&mut self.task);
        self.round.push(sums.map(|sum| sum as f64 / size as f64));
    }

    fn end_round(&mut self) {
        let [least, greatest] = self.range.map(|end| end as f64);
        let [sum, tasks] = self.earlier;
        let middle = (least + greatest) / 2.0;
        let centre = (sum + PRIOR_TASKS * middle) / (tasks + PRIOR_TASKS);
        let round = std::mem::take(&mut self.round);
        let first = self.range[0] * CANDIDATES;
        for bet in &mut self.bets {
            let stake = match bet.size > 0.0 {
                true => bet.size / (centre - least).max(f64::MIN_POSITIVE),
                false => bet.size / (greatest - centre).max(f64::MIN_POSITIVE),
            };
            // A mean known only as a range counts as the value that minimises the bet's gain.
            let worst = usize::from(stake < 0.0);
            let gains = round.iter().map(|mean| (stake * (mean[worst] - centre)).ln_1p());
            bet.gains += gains.sum::<f64>();
            for (index, cost) in (first..).zip(&mut bet.costs) {
                let candidate = index as f64 / CANDIDATES as f64;
                *cost -= round.len() as f64 * (stake * (candidate - centre)).ln_1p();
            }
        }
        for mean in &round {
            self.earlier[0] += (mean[0] + mean[1]) / 2.0;
            self.earlier[1] += 1.0;
        }
        let e_value = |index: i64| {
            let capital = |bet: &Bet| (bet.gains + bet.costs[(index - first) as usize]).exp();
            self.bets.iter().map(capital).sum::<f64>() / self.bets.len() as f64
        };
        let is_kept = |index: &i64| e_value(*index) * self.alpha < 1.0;
        let [low, high] = self.kept;
        // E-values are convex in the candidate, so that the kept candidates have no gaps. If none
        // is kept, the interval stays unchanged.
        if let Some(least) = (low..=high).find(is_kept) {
            let greatest = (least..=high).rev().find(is_kept).unwrap_or(least);
            self.kept = [least, greatest];
        }
    }

    /// Returns the interval of the kept candidates, extended at each end to the nearest rejected
    /// candidate.
    fn interval(&self) -> RateInterval {
        let [least, greatest] = self.range.map(|end| end * CANDIDATES);
        RateInterval {
            least: (self.kept[0] - 1).max(least),
            greatest: (self.kept[1] + 1).min(greatest),
            units: CANDIDATES as u64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROUNDS: usize = 4;

    /// Draws an order of tasks with one configuration each, in rounds of two suites.
    fn order() -> Order<Unit> {
        let suites = [0, 10].map(|first| TaskRef::all().skip(first).take(ROUNDS));
        Order::new(1, suites.into_iter().flatten(), |task: &TaskRef| task.suite())
            .expand(|task| vec![(*task, 0)])
    }

    /// Computes the exact probability that an interval ever excludes the mean, over all outcomes of
    /// tasks that succeed with the rate of their suite.
    fn miss_probability(rates: [f64; 2], alpha: f64) -> f64 {
        let order = order();
        let drawn: Vec<_> = order.rounds().iter().flatten().collect();
        let mean = (rates[0] + rates[1]) / 2.0;
        let mut missed = 0.0;
        for outcomes in 0..1_u32 << drawn.len() {
            let mut sequence = NewTasks::new(&order, [Measure::SSim].into(), alpha);
            let (mut probability, mut is_missed) = (1.0, false);
            for (bit, draw) in drawn.iter().enumerate() {
                let p = rates[draw.stratum];
                let success = outcomes >> bit & 1 == 1;
                probability *= if success { p } else { 1.0 - p };
                let possible = match success {
                    true => Transition::StillSucceeds,
                    false => Transition::Emergent,
                };
                sequence.complete(&draw.unit, &[possible]);
                is_missed |= sequence.look().intervals[&Measure::SSim].excludes(mean);
            }
            missed += if is_missed { probability } else { 0.0 };
        }
        missed
    }

    #[test]
    fn the_intervals_cover_the_mean_of_unequal_suites_over_all_outcomes() {
        let mut greatest: f64 = 0.0;
        for rates in [[0.2, 0.6], [0.5, 0.5], [0.1, 0.9], [0.9, 0.7]] {
            for alpha in [0.1, 0.3, 0.6] {
                let missed = miss_probability(rates, alpha);
                assert!(missed <= alpha, "{rates:?}: {missed} at {alpha}");
                greatest = greatest.max(missed);
            }
        }
        assert!(
            greatest > 0.0,
            "no interval ever excludes the mean, so that the test shows nothing"
        );
    }

    #[test]
    fn a_round_that_lacks_a_suite_is_ignored() {
        let suites = [(0, 1), (10, 3)].map(|(first, tasks)| TaskRef::all().skip(first).take(tasks));
        let order = Order::new(1, suites.into_iter().flatten(), |task: &TaskRef| task.suite())
            .expand(|task| vec![(*task, 0), (*task, 1)]);
        let mut sequence = NewTasks::new(&order, [Measure::SSim].into(), 0.9);
        let looks: Vec<_> = order
            .units()
            .map(|unit| {
                sequence.complete(unit, &[Transition::StillSucceeds]);
                sequence.look().intervals[&Measure::SSim]
            })
            .collect();
        assert_eq!(looks[0], looks[2], "an incomplete task or round changes no interval");
        assert_ne!(looks[2], looks[3], "a complete round narrows the interval");
        assert_eq!(looks[3], looks[7]);
    }
}
