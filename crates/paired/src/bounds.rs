//! Worst and best case of a cell with quarantined rollouts: the range of each
//! measure over all possible outcomes of those rollouts.

use std::collections::BTreeMap;

use benchmark::Axis;
use serde::{Deserialize, Serialize};

use crate::outcomes::{Matched, Outcome};

/// Lowest and highest value of each measure over all possible outcomes of the
/// quarantined rollouts.
///
/// Every range except that of `d` is sharp: some outcomes reach its ends. A
/// quarantined rollout says nothing about the policy, so the measures themselves
/// exclude such rollouts; the range shows how much their outcomes could change a measure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// Configurations of which no rollout, single or simultaneous, is missing. Their nominal
    /// rollouts are ignored.
    pub n: u64,
    /// Configurations counted in `n` that have a quarantined rollout.
    pub affected: u64,
    /// Success rate under each axis alone.
    pub s_axis: BTreeMap<Axis, [f64; 2]>,
    /// Π `s_axis`.
    pub s_indep: [f64; 2],
    /// Share that succeeds under every axis alone.
    pub s_conj: [f64; 2],
    /// Success rate under simultaneous perturbation.
    pub s_sim: [f64; 2],
    /// `s_conj` − `s_indep` by interval arithmetic, which contains the sharp range.
    pub d: [f64; 2],
    /// `s_sim` − `s_conj`.
    pub i: [f64; 2],
    /// Emergent failures / `n`.
    pub r_e: [f64; 2],
    /// Compensated successes / `n`.
    pub r_c: [f64; 2],
    /// Changed outcomes / `n`.
    pub r_d: [f64; 2],
}

/// Truth value of a statement that depends on unknown outcomes.
#[derive(Clone, Copy)]
struct Possible {
    is_certain: bool,
    is_possible: bool,
}

impl Possible {
    /// Returns the truth value of "the rollout succeeds"; `None` for a missing rollout.
    fn new(outcome: Outcome) -> Option<Self> {
        match outcome {
            Outcome::Missing => None,
            Outcome::Quarantined => Some(Self { is_certain: false, is_possible: true }),
            Outcome::Success | Outcome::Failure => {
                let is_certain = outcome == Outcome::Success;
                Some(Self { is_certain, is_possible: is_certain })
            }
        }
    }

    fn and(self, other: Self) -> Self {
        Self {
            is_certain: self.is_certain && other.is_certain,
            is_possible: self.is_possible && other.is_possible,
        }
    }

    fn not(self) -> Self {
        Self { is_certain: !self.is_possible, is_possible: !self.is_certain }
    }

    fn count(self, [low, high]: &mut [u64; 2]) {
        *low += u64::from(self.is_certain);
        *high += u64::from(self.is_possible);
    }
}

/// Lowest and highest number of configurations for which the statement behind each measure can be
/// true.
#[derive(Default)]
struct Ranges {
    s_axis: BTreeMap<Axis, [u64; 2]>,
    s_conj: [u64; 2],
    s_sim: [u64; 2],
    emergent: [u64; 2],
    compensated: [u64; 2],
    changed: [u64; 2],
    /// Lowest and highest number of simultaneous successes minus conjunctions.
    i: [i64; 2],
}

impl Bounds {
    /// Computes the bounds over configurations of one level without a missing
    /// rollout; `None` if none of these has a quarantined rollout.
    pub fn of(configurations: &[Matched]) -> Option<Self> {
        let (mut n, mut affected) = (0, 0);
        let mut ranges = Ranges::default();
        for matched in configurations {
            let outcomes = matched.combined().map(|(_, outcome)| outcome);
            let mut outcomes = outcomes.chain([matched.simultaneous]);
            let quarantined = outcomes.any(|outcome| outcome == Outcome::Quarantined);
            if ranges.add(matched).is_some() {
                n += 1;
                affected += u64::from(quarantined);
            }
        }
        (affected > 0).then(|| ranges.bounds(n, affected))
    }
}

impl Ranges {
    /// Adds a configuration; `None` if one of its rollouts is missing.
    fn add(&mut self, matched: &Matched) -> Option<()> {
        let simultaneous = Possible::new(matched.simultaneous)?;
        let mut alone = BTreeMap::new();
        for (axis, outcome) in matched.combined() {
            alone.insert(axis, Possible::new(outcome)?);
        }
        let mut conjunction = Possible { is_certain: true, is_possible: true };
        for (axis, possible) in alone {
            possible.count(self.s_axis.entry(axis).or_default());
            conjunction = conjunction.and(possible);
        }
        conjunction.count(&mut self.s_conj);
        simultaneous.count(&mut self.s_sim);
        let (emergent, compensated) =
            (conjunction.and(simultaneous.not()), conjunction.not().and(simultaneous));
        emergent.count(&mut self.emergent);
        compensated.count(&mut self.compensated);
        self.changed[0] += u64::from(emergent.is_certain || compensated.is_certain);
        self.changed[1] += u64::from(emergent.is_possible || compensated.is_possible);
        self.i[0] += i64::from(simultaneous.is_certain) - i64::from(conjunction.is_possible);
        self.i[1] += i64::from(simultaneous.is_possible) - i64::from(conjunction.is_certain);
        Some(())
    }

    fn bounds(&self, n: u64, affected: u64) -> Bounds {
        let rates = |counts: [u64; 2]| counts.map(|count| count as f64 / n as f64);
        let s_axis: BTreeMap<Axis, [f64; 2]> =
            self.s_axis.iter().map(|(&axis, &counts)| (axis, rates(counts))).collect();
        let product = |end: usize| s_axis.values().map(|range| range[end]).product();
        let s_indep: [f64; 2] = [product(0), product(1)];
        let s_conj = rates(self.s_conj);
        Bounds {
            n,
            affected,
            s_indep,
            s_conj,
            s_sim: rates(self.s_sim),
            d: [s_conj[0] - s_indep[1], s_conj[1] - s_indep[0]],
            i: self.i.map(|sum| sum as f64 / n as f64),
            r_e: rates(self.emergent),
            r_c: rates(self.compensated),
            r_d: rates(self.changed),
            s_axis,
        }
    }
}
