//! Verdict of a subset from its rollouts: a single outcome, or a sequential test.

use crate::mcnemar_exact;
use serde::{Deserialize, Serialize};

use crate::adaptive::outcomes::Tally;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The rollout succeeds, or a significant majority of the replicates does.
    Success,
    /// The rollout fails, or a significant majority of the replicates does.
    Failure,
    /// No rollout was requested.
    NotRun,
    /// A requested rollout has no result.
    Pending,
    /// Undecided; more rollouts are needed.
    Short { more: u32 },
    /// Every rollout is quarantined: the outcome is unknown and no rollout runs again.
    Quarantined,
    /// Undecided after the largest allowed number of rollouts, or because the results of a
    /// deterministic policy contradict each other.
    Undecided,
}

impl Verdict {
    /// Returns true if the subset succeeds; `None` without a decision.
    pub const fn success(self) -> Option<bool> {
        match self {
            Self::Success => Some(true),
            Self::Failure => Some(false),
            _ => None,
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Evidence {
    /// The policy is deterministic: one result decides. Results that
    /// contradict each other leave the subset undecided.
    #[default]
    Once,
    /// The policy is stochastic: a test over replicates decides.
    Repeated(Repeats),
}

/// Role of a subset in the claims about a lattice; the role determines the level of its test.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// One axis alone, or all axes: the subset is part of the transition.
    Transition,
    /// Two or more axes, but not all: any of the `subsets` subsets that the search for minimal
    /// subsets may run.
    Further { subsets: u32 },
}

impl Role {
    /// Returns the role of the further subsets of a lattice of `axes` axes: those with two
    /// or more axes, but not all.
    pub const fn further(axes: usize) -> Self {
        let all = 1_u32 << axes;
        let subsets = all.saturating_sub(axes as u32 + 2);
        Self::Further { subsets }
    }
}

/// Sequential tests of whether subsets succeed more often than not, with a bound on the
/// probability of any false claim about a lattice.
///
/// Rollouts are requested in batches, with an exact sign test after each batch. A subset
/// succeeds if the hypothesis that its success probability is at most ½ is rejected, and
/// fails if the hypothesis that it is at least ½ is rejected. This is equivalent to the
/// Clopper–Pearson interval of its success rate lying above or below ½.
///
/// # Error probability
/// `error` bounds the probability of any false claim about a lattice:
///
/// - *The transition* is claimed if each axis alone and all axes together have the outcomes
///   for which the configuration was selected. For every one of these subsets, the hypothesis
///   of the opposite outcome must be rejected. The selecting outcomes fix the direction of each
///   hypothesis beforehand, and all hypotheses must be rejected, so that each is tested at the
///   full level (an intersection–union test). No tally includes the selecting outcomes.
/// - *Further subsets* are tested only after the transition is claimed, each by a two-sided
///   test at `error` divided by their number (Bonferroni). Since they are tested only where all
///   hypotheses of the transition are rejected, both families have the full level (serial
///   gatekeeping).
///
/// With m looks, each test has its level divided by m (Bonferroni).
///
/// Sources: R. L. Berger, Multiparameter hypothesis testing and acceptance sampling,
/// Technometrics 24 (1982), 295–300; P. H. Westfall and A. Krishen, Optimally weighted,
/// fixed sequence and gatekeeper multiple testing procedures, Journal of Statistical
/// Planning and Inference 99 (2001), 25–40.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Repeats {
    /// Fewest rollouts per batch; at least 1.
    pub batch: u32,
    /// Largest number of rollouts of a subset; at least `batch`.
    pub most: u32,
    /// Largest probability of a false claim about a lattice.
    pub error: f64,
}

/// Schedule of the looks, that is, tests, at the rollouts of one subset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Looks {
    pub batch: u32,
    pub most: u32,
    /// Two-sided significance level of one test.
    pub level: f64,
}

impl Default for Repeats {
    /// An axis alone is decided by eight equal outcomes, by 16 with a minority of at most three, or
    /// by 24 with a minority of at most six. A further subset in a lattice of six axes is decided
    /// by 13 equal outcomes, or by 24 with a minority of at most three.
    fn default() -> Self {
        Self { batch: 8, most: 24, error: 0.05 }
    }
}

impl Repeats {
    pub fn up_to(most: u32) -> Self {
        let default = Self::default();
        Self { batch: default.batch.min(most), most, ..default }
    }

    /// Returns the fewest rollouts per subset that can decide about every subset of a lattice
    /// of `axes` axes.
    pub fn fewest(axes: usize) -> u32 {
        let fewest_for = |role| {
            let can_decide = |most: &u32| Self::up_to(*most).looks(role).can_decide();
            (1..).find(can_decide).expect("2⁻ⁿ falls below any level")
        };
        fewest_for(Role::Transition).max(fewest_for(Role::further(axes)))
    }

    /// Returns the looks at a subset. The first batch is large enough that equal outcomes
    /// decide, if `most` allows it: earlier looks would spend significance level and decide
    /// nothing.
    pub fn looks(&self, role: Role) -> Looks {
        // A one-sided test at some level is one side of the two-sided test at twice that level.
        let level = match role {
            Role::Transition => 2.0 * self.error,
            Role::Further { subsets } => self.error / f64::from(subsets.max(1)),
        };
        let most = self.most.max(self.batch).max(1);
        let looks =
            |batch: u32| Looks { batch, most, level: level / f64::from(most.div_ceil(batch)) };
        let mut batches = (self.batch.max(1)..=most).map(looks);
        let deciding = batches.find(Looks::can_decide);
        deciding.unwrap_or_else(|| looks(most))
    }

    fn verdict(&self, tally: &Tally, role: Role) -> Verdict {
        let Looks { batch, most, level } = self.looks(role);
        let requested = tally.requested();
        if requested < batch {
            return Verdict::Short { more: batch - requested };
        }
        let decides = sign_test(tally.successes, tally.failures) <= level;
        match tally.majority() {
            Some(true) if decides => Verdict::Success,
            Some(false) if decides => Verdict::Failure,
            _ if requested < most => Verdict::Short { more: batch.min(most - requested) },
            _ if tally.count().n == 0 => Verdict::Quarantined,
            _ => Verdict::Undecided,
        }
    }
}

impl Looks {
    /// Returns true if equal outcomes can decide.
    fn can_decide(&self) -> bool {
        sign_test(self.batch, 0) <= self.level
    }
}

/// Returns the exact two-sided p-value of the sign test, which equals the p-value of McNemar's
/// test of the two counts.
fn sign_test(successes: u32, failures: u32) -> f64 {
    mcnemar_exact(successes.into(), failures.into())
}

impl Evidence {
    pub fn verdict(&self, tally: &Tally, role: Role) -> Verdict {
        let Tally { successes, failures, pending, .. } = *tally;
        match self {
            _ if tally.requested() == 0 => Verdict::NotRun,
            Self::Repeated(_) if pending > 0 => Verdict::Pending,
            Self::Repeated(repeats) => repeats.verdict(tally, role),
            Self::Once => match (successes > 0, failures > 0) {
                (true, false) => Verdict::Success,
                (false, true) => Verdict::Failure,
                (true, true) => Verdict::Undecided,
                (false, false) if pending > 0 => Verdict::Pending,
                (false, false) => Verdict::Quarantined,
            },
        }
    }

    pub(crate) fn first_batch(&self, role: Role) -> u32 {
        match self {
            Self::Once => 1,
            Self::Repeated(repeats) => repeats.looks(role).batch,
        }
    }

    /// Returns the largest number of rollouts that may still be requested for a subset.
    pub(crate) fn remaining(&self, tally: &Tally, role: Role) -> u32 {
        let most = match self {
            Self::Once => 1,
            Self::Repeated(repeats) => repeats.looks(role).most,
        };
        match self.verdict(tally, role) {
            Verdict::NotRun | Verdict::Pending | Verdict::Short { .. } => {
                most.saturating_sub(tally.requested())
            }
            _ => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::adaptive::subsets::proportion::clopper_pearson;

    fn tally(successes: u32, failures: u32) -> Tally {
        Tally { successes, failures, ..Tally::default() }
    }

    const ROLES: [Role; 2] = [Role::Transition, Role::Further { subsets: 56 }];

    #[test]
    fn one_result_decides_for_a_deterministic_policy() {
        let once = |successes, failures| {
            Evidence::Once.verdict(&tally(successes, failures), Role::Transition)
        };
        assert_eq!(once(0, 0), Verdict::NotRun);
        assert_eq!(once(1, 0), Verdict::Success);
        assert_eq!(once(0, 1), Verdict::Failure);
        assert_eq!(once(1, 1), Verdict::Undecided);
        let quarantined = Tally { quarantined: 1, ..Tally::default() };
        let verdict = Evidence::Once.verdict(&quarantined, Role::Transition);
        assert_eq!(verdict, Verdict::Quarantined);
    }

    #[test]
    fn a_verdict_is_reached_exactly_where_the_interval_excludes_one_half() {
        let repeats = Repeats::default();
        for role in ROLES {
            let Looks { batch, most, level } = repeats.looks(role);
            for n in batch..=most {
                for successes in 0..=n {
                    let tally = tally(successes, n - successes);
                    let [low, high] =
                        clopper_pearson(tally.count(), 1.0 - level).expect("rollouts");
                    let expected = (low > 0.5).then_some(true).or((high < 0.5).then_some(false));
                    let verdict = Evidence::Repeated(repeats).verdict(&tally, role);
                    assert_eq!(verdict.success(), expected, "{role:?}: {successes} of {n}");
                }
            }
        }
    }

    /// Returns the probability that the sequential test decides *success* after the outcomes
    /// in `earlier`, by enumerating every reachable state: the numbers of rollouts and of
    /// successes so far.
    fn probability_of_success(repeats: Repeats, role: Role, p: f64, earlier: Tally) -> f64 {
        let mut probability = 0.0;
        let mut states = BTreeMap::from([((earlier.requested(), earlier.successes), 1.0)]);
        while let Some(((n, successes), weight)) = states.pop_first() {
            let tally = tally(successes, n - successes);
            let more = match Evidence::Repeated(repeats).verdict(&tally, role) {
                Verdict::Success => {
                    probability += weight;
                    continue;
                }
                Verdict::NotRun => repeats.looks(role).batch,
                Verdict::Short { more } => more,
                _ => continue,
            };
            let mut ways = 1.0;
            for k in 0..=more {
                let chance = ways * p.powi(k as i32) * (1.0 - p).powi((more - k) as i32);
                *states.entry((n + more, successes + k)).or_default() += weight * chance;
                ways *= f64::from(more - k) / f64::from(k + 1);
            }
        }
        probability
    }

    #[test]
    fn a_wrong_verdict_is_at_most_as_probable_as_stated_and_a_right_one_is_likely() {
        for (batch, most, error) in [(8, 24, 0.05), (6, 6, 0.05), (5, 23, 0.1), (1, 30, 0.2)] {
            let repeats = Repeats { batch, most, error };
            for (role, bound) in [
                (Role::Transition, error),
                (Role::Further { subsets: 1 }, error / 2.0),
                (Role::Further { subsets: 56 }, error / 112.0),
            ] {
                for p in [0.0, 0.1, 0.3, 0.45, 0.5] {
                    let wrong = probability_of_success(repeats, role, p, Tally::default());
                    assert!(wrong <= bound, "{repeats:?} {role:?} at {p}: {wrong}");
                }
            }
        }
        for (role, least) in ROLES.into_iter().zip([0.999, 0.97]) {
            let right = probability_of_success(Repeats::default(), role, 0.95, Tally::default());
            assert!(right > least, "{role:?}: {right}");
        }
    }

    /// An outcome that selected a configuration, counted as its first repeat, favours the
    /// verdict for which it was selected.
    #[test]
    fn a_selecting_outcome_among_the_repeats_would_inflate_the_error() {
        let repeats = Repeats::default();
        let probability = |earlier| probability_of_success(repeats, Role::Transition, 0.5, earlier);
        let (fresh, selected) = (probability(Tally::default()), probability(tally(1, 0)));
        assert!(selected > 1.4 * fresh, "{fresh} {selected}");
    }

    #[test]
    fn requests_never_exceed_the_largest_number_of_rollouts() {
        let repeated = |successes, failures, role| {
            Evidence::Repeated(Repeats::default()).verdict(&tally(successes, failures), role)
        };
        let [transition, further] = ROLES;
        let cases = [
            (3, 2, Verdict::Short { more: 3 }),
            (8, 0, Verdict::Success),
            (4, 4, Verdict::Short { more: 8 }),
            (10, 11, Verdict::Short { more: 3 }),
            (12, 12, Verdict::Undecided),
            (30, 29, Verdict::Undecided),
        ];
        for (successes, failures, expected) in cases {
            assert_eq!(repeated(successes, failures, transition), expected);
        }
        let cases = [
            (8, 0, Verdict::Short { more: 5 }),
            (13, 0, Verdict::Success),
            (12, 1, Verdict::Short { more: 11 }),
            (21, 3, Verdict::Success),
            (20, 4, Verdict::Undecided),
        ];
        for (successes, failures, expected) in cases {
            assert_eq!(repeated(successes, failures, further), expected);
        }
    }

    #[test]
    fn the_fewest_repeats_are_the_shortest_series_of_equal_outcomes_that_decides() {
        // The p-value of n equal outcomes is 2¹⁻ⁿ. 2⁻¹¹ ≤ 0.05 / 56 < 2⁻¹⁰, and 2⁻⁵ ≤ 0.05 < 2⁻⁴.
        assert_eq!((Repeats::fewest(6), Repeats::fewest(2)), (12, 6));
    }
}
