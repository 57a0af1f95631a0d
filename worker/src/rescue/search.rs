//! Search for the policy's last query at which lifting the perturbations saves a rollout. Pure
//! functions.

use std::collections::BTreeMap;

/// Evenly spread queries that are tried before the bracket is narrowed. They reveal rollouts for
/// which an earlier lift fails and a later one succeeds.
const SPREAD: usize = 8;

/// Trials so far: for each tried query, from 0, whether lifting the perturbations there saves the
/// rollout. Lifting after the last query is taken to fail.
#[derive(Clone, Debug)]
pub(super) struct Search {
    looks: usize,
    tried: BTreeMap<usize, bool>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// No tried query saves the rollout; the first was tried.
    NeverSaved,
    /// Lifting at `saved` saves the rollout, and lifting at the next query does not.
    SavedUntil {
        /// Last query from which the rollout is saved.
        saved: usize,
        /// True if every earlier trial also saved the rollout.
        monotone: bool,
    },
}

impl Search {
    /// Starts a search over a rollout with `looks` queries.
    pub(super) fn new(looks: usize) -> Self {
        Self {
            looks,
            tried: BTreeMap::new(),
        }
    }

    /// Records a trial: `saved` if lifting at `look` saves the rollout and the placebo does not.
    pub(super) fn record(&mut self, look: usize, saved: bool) {
        self.tried.insert(look, saved);
    }

    /// Returns the next query to try; `None` once the result is known.
    pub(super) fn next(&self) -> Option<usize> {
        let spread = (0..SPREAD).map(|part| part * self.looks / SPREAD);
        let mut untried =
            spread.filter(|look| *look < self.looks && !self.tried.contains_key(look));
        untried.next().or_else(|| {
            let saved = self.last_saved()?;
            let lost = self.first_lost_after(saved);
            (lost - saved > 1).then(|| saved.midpoint(lost))
        })
    }

    /// Returns the result once [`Search::next`] has nothing left to try.
    pub(super) fn found(&self) -> Found {
        match self.last_saved() {
            None => Found::NeverSaved,
            Some(saved) => Found::SavedUntil {
                saved,
                monotone: self.tried.range(..saved).all(|(_, saved)| *saved),
            },
        }
    }

    fn last_saved(&self) -> Option<usize> {
        let mut saved = self.tried.iter().filter(|(_, saved)| **saved);
        saved.next_back().map(|(look, _)| *look)
    }

    /// Returns the first later query that is known to be lost, or the number of queries.
    fn first_lost_after(&self, saved: usize) -> usize {
        let after = self.tried.range(saved + 1..).next();
        after.map_or(self.looks, |(look, _)| *look)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn search(looks: usize, saves: impl Fn(usize) -> bool) -> Search {
        let mut search = Search::new(looks);
        while let Some(look) = search.next() {
            assert!(look < looks && !search.tried.contains_key(&look));
            search.record(look, saves(look));
        }
        search
    }

    proptest! {
        #[test]
        fn a_last_look_that_saves_is_found(looks in 1..200_usize, share in 0.0..1.0_f64) {
            let last = (share * looks as f64) as usize;
            let search = search(looks, |look| look <= last);
            let expected = Found::SavedUntil { saved: last, monotone: true };
            prop_assert_eq!(search.found(), expected);
            let bracket = looks.div_ceil(SPREAD) as f64;
            prop_assert!(search.tried.len() <= SPREAD + bracket.log2().ceil() as usize);
        }

        #[test]
        fn whatever_saves_the_answer_was_tried(saves in prop::collection::vec(any::<bool>(), 1..80)) {
            let search = search(saves.len(), |look| saves[look]);
            match search.found() {
                Found::NeverSaved => {
                    prop_assert!(search.tried.values().all(|saved| !saved));
                }
                Found::SavedUntil { saved, monotone } => {
                    prop_assert_eq!(search.tried[&saved], true);
                    let next = saved + 1;
                    prop_assert!(next == saves.len() || !search.tried[&next]);
                    let earlier = search.tried.range(..saved);
                    prop_assert_eq!(monotone, earlier.into_iter().all(|(_, saved)| *saved));
                }
            }
        }
    }

    #[test]
    fn what_nothing_saves_is_given_up() {
        let search = search(40, |_| false);
        assert_eq!(search.found(), Found::NeverSaved);
        assert_eq!(search.tried.len(), SPREAD);
    }
}
