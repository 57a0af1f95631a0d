//! The order of sets by inclusion.

use benchmark::AxisSet;

/// Returns the sets that have no proper subset among `sets`.
pub(crate) fn minimal(sets: &[AxisSet]) -> Vec<AxisSet> {
    let has_smaller = |set: &AxisSet| sets.iter().any(|other| other.is_proper_subset(*set));
    sets.iter().copied().filter(|set| !has_smaller(set)).collect()
}

/// Returns the sets that have no proper superset among `sets`.
pub(crate) fn maximal(sets: &[AxisSet]) -> Vec<AxisSet> {
    let has_larger = |set: &AxisSet| sets.iter().any(|other| set.is_proper_subset(*other));
    sets.iter().copied().filter(|set| !has_larger(set)).collect()
}

/// Returns the sets strictly between `low` and `high` by inclusion, in order.
pub(crate) fn between(low: AxisSet, high: AxisSet) -> Vec<AxisSet> {
    let inside = |set: &AxisSet| low.is_proper_subset(*set) && *set != high;
    high.subsets().into_iter().filter(inside).collect()
}
