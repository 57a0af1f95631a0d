//! Search for the policy's last query at which lifting the perturbations saves a rollout. Pure
//! functions.

use std::collections::BTreeMap;

/// Number of evenly spread queries that are tried before the bracket is narrowed. They reveal
/// rollouts for which an earlier lift fails and a later one succeeds.
const SPREAD: usize = 8;

/// Trials so far: for each tried query, counted from 0, true if lifting the perturbations there
/// saves the rollout and the placebo does not. Lifting after the last query is taken to fail.
#[derive(Clone, Debug)]
pub(super) struct Search {
    queries: usize,
    tried: BTreeMap<usize, bool>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SearchResult {
    /// No tried query saves the rollout; the first query is among the tried ones.
    NeverSaved,
    /// Lifting at `saved` saves the rollout, and lifting at the next query does not.
    SavedUntil {
        /// Last tried query from which the rollout is saved.
        saved: usize,
        /// True if lifting at each tried query before `saved` also saves the rollout.
        is_monotone: bool,
    },
}

impl Search {
    pub(super) fn new(queries: usize) -> Self {
        Self { queries, tried: BTreeMap::new() }
    }

    /// Records a trial. `saved` is true if lifting at `query` saves the rollout and the placebo
    /// (nothing lifted, the robot nudged) does not.
    pub(super) fn record(&mut self, query: usize, saved: bool) {
        self.tried.insert(query, saved);
    }

    /// Returns the next query to try; `None` once the result is known.
    pub(super) fn next(&self) -> Option<usize> {
        let spread = (0..SPREAD).map(|part| part * self.queries / SPREAD);
        let mut untried =
            spread.filter(|query| *query < self.queries && !self.tried.contains_key(query));
        untried.next().or_else(|| {
            let saved = self.last_saved()?;
            let lost = self.first_lost_after(saved);
            (lost - saved > 1).then(|| saved.midpoint(lost))
        })
    }

    pub(super) fn result(&self) -> SearchResult {
        match self.last_saved() {
            None => SearchResult::NeverSaved,
            Some(saved) => SearchResult::SavedUntil {
                saved,
                is_monotone: self.tried.range(..saved).all(|(_, saved)| *saved),
            },
        }
    }

    fn last_saved(&self) -> Option<usize> {
        let mut saved = self.tried.iter().filter(|(_, saved)| **saved);
        saved.next_back().map(|(query, _)| *query)
    }

    /// Returns the first tried query after the last saved one, or the number of queries if there is
    /// none.
    fn first_lost_after(&self, saved: usize) -> usize {
        let after = self.tried.range(saved + 1..).next();
        after.map_or(self.queries, |(query, _)| *query)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn search(queries: usize, saves: impl Fn(usize) -> bool) -> Search {
        let mut search = Search::new(queries);
        while let Some(query) = search.next() {
            assert!(query < queries && !search.tried.contains_key(&query));
            search.record(query, saves(query));
        }
        search
    }

    proptest! {
        #[test]
        fn the_last_query_that_saves_is_found(queries in 1..200_usize, share in 0.0..1.0_f64) {
            let last = (share * queries as f64) as usize;
            let search = search(queries, |query| query <= last);
            let expected = SearchResult::SavedUntil { saved: last, is_monotone: true };
            prop_assert_eq!(search.result(), expected);
            let bracket = queries.div_ceil(SPREAD) as f64;
            prop_assert!(search.tried.len() <= SPREAD + bracket.log2().ceil() as usize);
        }

        #[test]
        fn the_result_was_tried(saves in prop::collection::vec(any::<bool>(), 1..80)) {
            let search = search(saves.len(), |query| saves[query]);
            match search.result() {
                SearchResult::NeverSaved => {
                    prop_assert!(search.tried.values().all(|saved| !saved));
                }
                SearchResult::SavedUntil { saved, is_monotone } => {
                    prop_assert_eq!(search.tried[&saved], true);
                    let next = saved + 1;
                    prop_assert!(next == saves.len() || !search.tried[&next]);
                    let earlier = search.tried.range(..saved);
                    prop_assert_eq!(is_monotone, earlier.into_iter().all(|(_, saved)| *saved));
                }
            }
        }
    }

    #[test]
    fn the_search_ends_if_no_query_saves() {
        let search = search(40, |_| false);
        assert_eq!(search.result(), SearchResult::NeverSaved);
        assert_eq!(search.tried.len(), SPREAD);
    }
}
