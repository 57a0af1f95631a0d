//! Merge of the records that two databases (halves) hold of one campaign's rollouts, and detection
//! of contradictions.

use std::collections::BTreeMap;

use super::lease::OutcomeKey;

/// Record of a rollout in one half.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RolloutRecord {
    /// Progress of the rollout.
    pub standing: Standing,
    /// Reports of an outcome that differs from the committed one.
    pub divergences: u32,
    pub is_filmed: bool,
    pub charged_attempts: u32,
    pub attempts: u32,
}

/// State of a rollout in one half.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Standing {
    /// Still to be run.
    #[default]
    Open,
    /// Quarantined: too many attempts failed, or an operator skipped the rollout.
    Quarantined,
    Committed(OutcomeKey),
}

/// The half whose record of a rollout is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeptHalf {
    First,
    Second,
}

/// Two different outcomes of one rollout.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Contradiction<N> {
    pub rollout: N,
    pub first: OutcomeKey,
    pub second: OutcomeKey,
}

impl RolloutRecord {
    /// Chooses which record of a rollout to keep: an outcome is preferred to a quarantine, and a
    /// quarantine to an open rollout; of two records with the same state, the one with more
    /// information.
    ///
    /// # Errors
    /// If both halves have an outcome and the outcomes differ. The error holds both outcomes.
    pub fn choose(&self, other: &RolloutRecord) -> Result<KeptHalf, (OutcomeKey, OutcomeKey)> {
        if let (Standing::Committed(first), Standing::Committed(second)) =
            (self.standing, other.standing)
            && first != second
        {
            return Err((first, second));
        }
        Ok(match other.weight() > self.weight() {
            true => KeptHalf::Second,
            false => KeptHalf::First,
        })
    }

    fn weight(&self) -> (u8, u32, bool, u32, u32) {
        let standing = match self.standing {
            Standing::Open => 0,
            Standing::Quarantined => 1,
            Standing::Committed(_) => 2,
        };
        (standing, self.divergences, self.is_filmed, self.charged_attempts, self.attempts)
    }
}

/// Chooses the half whose record is kept, for every rollout. A rollout that one half lacks is taken
/// from the other.
///
/// # Errors
/// All contradictions, in order, if there are any.
pub fn merge<N: Clone + Ord>(
    first: &BTreeMap<N, RolloutRecord>,
    second: &BTreeMap<N, RolloutRecord>,
) -> Result<BTreeMap<N, KeptHalf>, Vec<Contradiction<N>>> {
    let mut kept = BTreeMap::new();
    let mut contradictions = Vec::new();
    for (rollout, record) in first {
        match second.get(rollout).map_or(Ok(KeptHalf::First), |second| record.choose(second)) {
            Ok(half) => {
                kept.insert(rollout.clone(), half);
            }
            Err((first, second)) => {
                contradictions.push(Contradiction { rollout: rollout.clone(), first, second })
            }
        }
    }
    for rollout in second.keys().filter(|id| !first.contains_key(*id)) {
        kept.insert(rollout.clone(), KeptHalf::Second);
    }
    match contradictions.is_empty() {
        true => Ok(kept),
        false => Err(contradictions),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    type Half = BTreeMap<u8, RolloutRecord>;

    fn any_record() -> impl Strategy<Value = RolloutRecord> {
        let standing = prop_oneof![
            Just(Standing::Open),
            Just(Standing::Quarantined),
            (any::<bool>(), 0..3_u32).prop_map(|(success, steps)| {
                Standing::Committed(OutcomeKey { success, steps })
            }),
        ];
        (standing, 0..2_u32, any::<bool>(), 0..3_u32, 0..4_u32).prop_map(
            |(standing, divergences, is_filmed, charged_attempts, attempts)| RolloutRecord {
                standing,
                divergences,
                is_filmed,
                charged_attempts,
                attempts,
            },
        )
    }

    fn half() -> impl Strategy<Value = Half> {
        proptest::collection::btree_map(0..6_u8, any_record(), 0..6)
    }

    fn merged(first: &Half, second: &Half) -> Option<Half> {
        let kept = merge(first, second).ok()?;
        let record = |(rollout, kept): (u8, KeptHalf)| match kept {
            KeptHalf::First => (rollout, first[&rollout]),
            KeptHalf::Second => (rollout, second[&rollout]),
        };
        Some(kept.into_iter().map(record).collect())
    }

    fn outcome(record: Option<&RolloutRecord>) -> Option<OutcomeKey> {
        match record?.standing {
            Standing::Committed(outcome) => Some(outcome),
            _ => None,
        }
    }

    proptest! {
        #[test]
        fn the_merge_has_exactly_the_outcomes_of_both_halves(a in half(), b in half()) {
            if let Some(whole) = merged(&a, &b) {
                let names: Vec<u8> = a.keys().chain(b.keys()).copied().collect();
                for rollout in names {
                    let either = outcome(a.get(&rollout)).or(outcome(b.get(&rollout)));
                    prop_assert_eq!(outcome(whole.get(&rollout)), either);
                }
                prop_assert!(whole.keys().all(|id| a.contains_key(id) || b.contains_key(id)));
            }
        }

        #[test]
        fn a_rollout_is_open_exactly_if_it_is_open_in_both_halves(a in half(), b in half()) {
            if let Some(whole) = merged(&a, &b) {
                let is_open = |half: &Half, id| {
                    half.get(id).is_none_or(|record| record.standing == Standing::Open)
                };
                for id in whole.keys() {
                    prop_assert_eq!(is_open(&whole, id), is_open(&a, id) && is_open(&b, id));
                }
            }
        }

        #[test]
        fn contradictions_are_the_rollouts_with_two_outcomes(a in half(), b in half()) {
            let expected: Vec<u8> = a
                .keys()
                .filter(|id| {
                    let both = outcome(a.get(*id)).zip(outcome(b.get(*id)));
                    both.is_some_and(|(in_a, in_b)| in_a != in_b)
                })
                .copied()
                .collect();
            let found = merge(&a, &b).err().unwrap_or_default();
            let rollouts: Vec<u8> = found.iter().map(|conflict| conflict.rollout).collect();
            prop_assert_eq!(rollouts, expected);
            for conflict in found {
                prop_assert_eq!(Some(conflict.first), outcome(a.get(&conflict.rollout)));
                prop_assert_eq!(Some(conflict.second), outcome(b.get(&conflict.rollout)));
            }
        }

        #[test]
        fn the_order_of_the_halves_does_not_matter(a in half(), b in half(), c in half()) {
            prop_assert_eq!(merged(&a, &b), merged(&b, &a));
            let left = merged(&a, &b).and_then(|ab| merged(&ab, &c));
            let right = merged(&b, &c).and_then(|bc| merged(&a, &bc));
            // Both are `None` if the halves contradict each other, in whatever order they are
            // merged.
            prop_assert_eq!(left, right);
        }

        #[test]
        fn a_half_merged_with_itself_or_with_nothing_is_unchanged(a in half()) {
            prop_assert_eq!(merged(&a, &a), Some(a.clone()));
            prop_assert_eq!(merged(&a, &Half::new()), Some(a));
        }
    }
}
