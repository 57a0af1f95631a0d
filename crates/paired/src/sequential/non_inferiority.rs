//! Sequential test of non-inferiority: is a policy's success lower than a reference's by more than a
//! margin? The reference is another policy's outcomes of the same rollouts, or known rates.
//!
//! # Estimand
//! Δ, the mean difference of success over configurations like those of the plan. Outcomes of a
//! stochastic policy vary, so that Δ is not determined even by all rollouts of a finite plan: unlike
//! the intervals of `sequential`, these do not shrink to a point when all units are drawn.
//!
//! # Guarantee
//! The rollouts of a condition that share task and configuration (or initial state) form a unit,
//! whose value is the sum of its rollouts' differences over the number of rollouts of the largest
//! unit. Units run in random order and are taken as independent. For numbers b in (0, 1), the product
//! over the units of 1 − b + b·(1 + x)/(1 + m) has an expectation of at most 1 if the mean of the
//! values x is at most m, and so has its average over several b. By Ville's inequality it reaches 1/α
//! at any time with a probability of at most α; the values' negatives give the other direction. For
//! *worse*, which one condition decides, α is shared among the conditions; *not worse* requires all.
//!
//! # Source
//! I. Waudby-Smith and A. Ramdas, Estimating means of bounded random variables by betting,
//! JRSS B 86 (2024), 1–27.

use std::collections::BTreeMap;

use benchmark::{Condition, RolloutId, TaskRef};
use serde::Serialize;

use super::order::Order;
use crate::outcomes::Outcome;

/// Largest probability of a wrong answer in either direction.
const ALPHA: f64 = 0.025;
/// Bets b; the best is about the gap between mean and m divided by the variance.
const BETS: [f64; 4] = [0.05, 0.15, 0.4, 0.9];
/// Halvings of [-1, 1] in the search for a bound.
const HALVINGS: u32 = 24;

/// Answer of the test about one condition or all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Δ is above minus the margin.
    NotWorse,
    /// Δ is below minus the margin.
    Worse,
    Undecided,
}

/// Rollouts of both sides in the random order in which they run and count.
#[derive(Clone, Debug)]
pub struct NonInferiority {
    /// Least and greatest success of the reference in each rollout, a fraction.
    reference: BTreeMap<RolloutId, [f64; 2]>,
    units: Vec<(Condition, Vec<RolloutId>)>,
    conditions: Vec<Condition>,
}

/// Evidence about one condition, over all its levels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ConditionEvidence {
    pub condition: Condition,
    pub verdict: Verdict,
    /// Rollouts that count: those of the units before the first incomplete one.
    pub rollouts: u64,
    /// Rollouts of the plan.
    pub planned: u64,
    /// The estimate of Δ; absent without a rollout.
    pub difference: Option<f64>,
    /// The interval of Δ, which holds at all times with 95 %.
    pub interval: [f64; 2],
}

impl NonInferiority {
    /// Plans the rollouts of some conditions of a reference, which is nowhere missing an outcome.
    pub fn new(
        reference: impl IntoIterator<Item = (RolloutId, [f64; 2])>,
        conditions: &[Condition],
        seed: u64,
    ) -> Self {
        let reference = reference.into_iter();
        let reference: BTreeMap<_, _> =
            reference.filter(|(id, _)| conditions.contains(&id.condition())).collect();
        let mut units: BTreeMap<(Condition, TaskRef, u16), Vec<RolloutId>> = BTreeMap::new();
        for id in reference.keys() {
            units.entry((id.condition(), id.task(), id.number())).or_default().push(*id);
        }
        let order = Order::new(seed, units.keys().copied(), |_| ());
        let mut conditions: Vec<Condition> =
            units.keys().map(|(condition, ..)| *condition).collect();
        conditions.dedup();
        let units = order.units().map(|unit| (unit.0, units[unit].clone()));
        Self { units: units.collect(), reference, conditions }
    }

    /// Returns the rollouts of the units in the order in which they run, without the conditions that
    /// are decided.
    pub fn open_units<'a>(
        &'a self,
        evidence: &'a [ConditionEvidence],
    ) -> impl Iterator<Item = &'a [RolloutId]> {
        let is_open = |condition: Condition| {
            let mut of = evidence.iter().filter(move |of| of.condition == condition);
            of.all(|of| of.verdict == Verdict::Undecided)
        };
        let units = self.units.iter().filter(move |(condition, _)| is_open(*condition));
        units.map(|(_, rollouts)| rollouts.as_slice())
    }

    /// Evaluates the outcomes so far against a margin, a fraction. Outcomes of units behind the first
    /// incomplete one do not count, since successful rollouts end sooner.
    pub fn evidence(
        &self,
        outcomes: &BTreeMap<RolloutId, Outcome>,
        margin: f64,
    ) -> Vec<ConditionEvidence> {
        let evidence = |&of| self.values(of, outcomes).evidence(of, margin, self.conditions.len());
        self.conditions.iter().map(evidence).collect()
    }

    /// Returns the answer of [`Self::evidence`] alone, and the rollouts after which it was known.
    pub fn verdict(&self, outcomes: &BTreeMap<RolloutId, Outcome>, margin: f64) -> (Verdict, u64) {
        let conditions = self.conditions.iter();
        let decided =
            conditions.map(|&of| self.values(of, outcomes).decide(margin, self.conditions.len()));
        let decided: Vec<(Verdict, usize)> = decided.collect();
        let rollouts = self.conditions.iter().zip(&decided).map(|(&condition, (_, units))| {
            let of = self.units.iter().filter(|(of, _)| *of == condition);
            of.take(*units).map(|(_, ids)| ids.len() as u64).sum::<u64>()
        });
        (Verdict::of_all(decided.iter().map(|of| of.0)), rollouts.sum())
    }

    /// Returns the values of the units before the first one without all outcomes.
    fn values(&self, condition: Condition, outcomes: &BTreeMap<RolloutId, Outcome>) -> Values {
        let units = || self.units.iter().filter(|(of, _)| *of == condition).map(|(_, ids)| ids);
        let largest = units().map(Vec::len).max().unwrap_or(1) as f64;
        let planned: usize = units().map(Vec::len).sum();
        let mut rollouts = 0;
        let values = units().map_while(|ids| {
            let mut value = [0.0; 2];
            for id in ids {
                let [least, greatest] = outcomes.get(id)?.possible_successes()?;
                let [low, high] = self.reference[id];
                value[0] += (least as f64 - high) / largest;
                value[1] += (greatest as f64 - low) / largest;
            }
            rollouts += ids.len() as u64;
            Some(value)
        });
        Values {
            values: values.collect(),
            scale: planned as f64 / (units().count() as f64 * largest),
            rollouts,
            planned: planned as u64,
        }
    }
}

/// Values of a condition's units.
struct Values {
    /// Least and greatest value of each unit.
    values: Vec<[f64; 2]>,
    /// Mean of the values over Δ.
    scale: f64,
    rollouts: u64,
    planned: u64,
}

impl Values {
    fn least(&self) -> impl Iterator<Item = f64> {
        self.values.iter().map(|value| value[0])
    }

    fn negated(&self) -> impl Iterator<Item = f64> {
        self.values.iter().map(|value| -value[1])
    }

    /// Returns the answer, and the number of units after which it was known.
    fn decide(&self, margin: f64, conditions: usize) -> (Verdict, usize) {
        let threshold = -margin * self.scale;
        let above_it = above(self.least(), threshold, ALPHA);
        let below_it = above(self.negated(), -threshold, ALPHA / conditions as f64);
        match (above_it, below_it) {
            (above, Some(below)) if above.is_none_or(|above| below < above) => {
                (Verdict::Worse, below)
            }
            (Some(above), _) => (Verdict::NotWorse, above),
            (None, _) => (Verdict::Undecided, self.values.len()),
        }
    }

    fn evidence(&self, condition: Condition, margin: f64, conditions: usize) -> ConditionEvidence {
        let n = self.values.len() as f64;
        let sum: f64 = self.values.iter().map(|[low, high]| (low + high) / 2.0).sum();
        let bound = |value: f64| (value / self.scale).clamp(-1.0, 1.0);
        let low = lower_bound(|| self.least(), ALPHA);
        let high = -lower_bound(|| self.negated(), ALPHA / conditions as f64);
        ConditionEvidence {
            condition,
            verdict: self.decide(margin, conditions).0,
            rollouts: self.rollouts,
            planned: self.planned,
            difference: (n > 0.0).then(|| bound(sum / n)),
            interval: [low, high].map(bound),
        }
    }
}

impl Verdict {
    /// Returns the answer over all conditions: worse if it is worse under any, not worse if it is
    /// worse under none.
    pub fn of_all(conditions: impl IntoIterator<Item = Self>) -> Self {
        let rank = |verdict: &Self| match verdict {
            Self::NotWorse => 0,
            Self::Undecided => 1,
            Self::Worse => 2,
        };
        conditions.into_iter().max_by_key(rank).unwrap_or(Self::Undecided)
    }
}

/// Bisection for the first policy that is worse, of several in an order in which all later ones are
/// worse, too.
#[derive(Clone, Debug)]
pub struct Bisection {
    /// Policies before it are not worse.
    sound: usize,
    /// Policies from it on are worse.
    worse: usize,
    next: Option<usize>,
    policies: usize,
}

impl Bisection {
    /// Begins with the last policy: if it is not worse, nothing need be searched.
    pub fn new(policies: usize) -> Self {
        Self { sound: 0, worse: policies, next: policies.checked_sub(1), policies }
    }

    /// Returns the policy to judge next; `None` if the first worse one is known, or cannot be.
    pub fn next(&self) -> Option<usize> {
        self.next
    }

    /// Records the answer about the next policy; one that is undecided ends the search.
    pub fn record(&mut self, verdict: Verdict) {
        let Some(judged) = self.next.take() else { return };
        match verdict {
            Verdict::NotWorse => self.sound = judged + 1,
            Verdict::Worse => self.worse = judged,
            Verdict::Undecided => return,
        }
        self.next = (self.sound < self.worse).then(|| usize::midpoint(self.sound, self.worse));
    }

    pub fn first_worse(&self) -> Option<usize> {
        (self.sound == self.worse && self.worse < self.policies).then_some(self.worse)
    }

    /// Returns the answer over all policies.
    pub fn verdict(&self) -> Verdict {
        match (self.sound == self.worse, self.first_worse()) {
            (false, _) => Verdict::Undecided,
            (true, None) => Verdict::NotWorse,
            (true, Some(_)) => Verdict::Worse,
        }
    }
}

/// Returns the number of values after which the evidence that their mean exceeds `mean` reaches 1/α;
/// `None` if it never does. Values lie in [-1, 1].
fn above(values: impl Iterator<Item = f64>, mean: f64, alpha: f64) -> Option<usize> {
    if mean <= -1.0 {
        return Some(0);
    }
    let mut capitals = [1.0_f64; BETS.len()];
    let enough = BETS.len() as f64 / alpha;
    let mut reached = values.map(|value| {
        for (capital, bet) in capitals.iter_mut().zip(BETS) {
            *capital *= 1.0 - bet + bet * (1.0 + value) / (1.0 + mean);
        }
        capitals.iter().sum::<f64>() >= enough
    });
    reached.position(|is_reached| is_reached).map(|index| index + 1)
}

/// Returns the greatest mean that the values rule out, with everything below.
fn lower_bound<I: Iterator<Item = f64>>(values: impl Fn() -> I, alpha: f64) -> f64 {
    let (mut low, mut high) = (-1.0, 1.0);
    for _ in 0..HALVINGS {
        let middle = (low + high) / 2.0;
        match above(values(), middle, alpha) {
            Some(_) => low = middle,
            None => high = middle,
        }
    }
    low
}
