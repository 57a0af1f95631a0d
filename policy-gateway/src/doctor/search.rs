//! Searches for the usual differences between two pipelines that explain two servers' different
//! answers, and prefers the explanation with the fewest assumptions.

use crate::doctor::answers::Answers;
use crate::doctor::fit::{Fit, Limit, fit};
use crate::doctor::probe::ExaminationError;
use crate::doctor::server_pair::{ServerPair, Side};
use crate::doctor::variant::{Topic, Variant};

/// Largest number of changes to observations in one explanation.
const MAX_CHANGES: usize = 3;
/// Another change is kept only if it reduces the remaining difference to less than this share.
const MAX_REMAINDER_PER_CHANGE: f64 = 0.75;

/// Largest share of a difference that an accepted explanation may leave. The part of it above
/// `SearchSetup::floor` is then searched as a separate difference.
const MAX_UNEXPLAINED: f64 = 0.1;

pub(crate) struct SearchSetup<'a> {
    pub servers: &'a ServerPair,
    /// Seeds of a situation; the answers with several seeds are averaged.
    pub seeds: &'a (dyn Fn(usize) -> Vec<u64> + Sync),
    /// Largest difference that counts as equality.
    pub floor: Limit,
    /// True if several simultaneous differences are searched for.
    pub allows_several: bool,
}

/// Changes to the observations, and a map of the actions.
#[derive(Clone, Debug)]
pub(crate) struct Explanation {
    pub changes: Vec<(Side, Variant)>,
    pub fit: Fit,
}

impl Explanation {
    fn cost(&self) -> u32 {
        self.fit.cost() + self.changes.len() as u32
    }
}

#[derive(Clone, Debug)]
pub(crate) enum SearchResult {
    Explained(Explanation),
    /// No explanation makes the answers alike; this explanation leaves the smallest difference.
    Unexplained(Explanation),
}

impl SearchSetup<'_> {
    /// Searches for an explanation of the difference between the answers `a` and `b` to the
    /// unchanged situations. A change that explains nine tenths of a difference is accepted; the
    /// remaining tenth is then searched separately.
    pub(crate) async fn search(
        &self,
        a: &Answers,
        b: &Answers,
    ) -> Result<SearchResult, ExaminationError> {
        let mut limit = self.limit(fit(a, b, &[f64::INFINITY; 7]).remaining);
        let plain = Explanation { changes: vec![], fit: fit(a, b, &limit) };
        let mut explained = match self.extend(&plain, &limit, a, b).await? {
            SearchResult::Explained(explained) => explained,
            unexplained => return Ok(unexplained),
        };
        while explained.changes.len() < MAX_CHANGES && self.allows_several {
            let next_limit = self.limit(explained.fit.remaining);
            if next_limit == limit || explained.fit.is_within(&self.floor) {
                break;
            }
            limit = next_limit;
            let (changed_a, changed_b) = self.answers(&explained.changes, a, b).await?;
            let fit = fit(&changed_a, &changed_b, &limit);
            let changes = explained.changes.clone();
            match self.extend(&Explanation { changes, fit }, &limit, a, b).await? {
                SearchResult::Explained(extended) => explained = extended,
                SearchResult::Unexplained(_) => break,
            }
        }
        Ok(SearchResult::Explained(explained))
    }

    /// Returns the largest remainder that counts as explained for a difference of this size.
    fn limit(&self, difference: Limit) -> Limit {
        std::array::from_fn(|component| {
            self.floor[component].max(MAX_UNEXPLAINED * difference[component])
        })
    }

    /// Finds the simplest explanation that extends `start`.
    async fn extend(
        &self,
        start: &Explanation,
        limit: &Limit,
        a: &Answers,
        b: &Answers,
    ) -> Result<SearchResult, ExaminationError> {
        // No extension is cheaper: each further change to the observations costs 1.
        if start.fit.explains && start.fit.cost() <= 1 {
            return Ok(SearchResult::Explained(start.clone()));
        }
        let remainder = |explanation: &Explanation| explanation.fit.remainder(limit);
        let mut closest = start.clone();
        let mut explanations: Vec<Explanation> =
            start.fit.explains.then_some(start).cloned().into_iter().collect();
        let depth = if self.allows_several { MAX_CHANGES - start.changes.len() } else { 1 };
        for _ in 0..depth {
            let mut candidates = vec![];
            for changes in self.extensions(&closest.changes) {
                let (changed_a, changed_b) = self.answers(&changes, a, b).await?;
                let fit = fit(&changed_a, &changed_b, limit);
                candidates.push(Explanation { changes, fit });
            }
            explanations
                .extend(candidates.iter().filter(|candidate| candidate.fit.explains).cloned());
            let simplest = explanations.iter().min_by(|first, second| {
                let by_remainder = || remainder(first).total_cmp(&remainder(second));
                first.cost().cmp(&second.cost()).then_with(by_remainder)
            });
            if let Some(simplest) = simplest {
                return Ok(SearchResult::Explained(simplest.clone()));
            }
            let nearest = candidates
                .into_iter()
                .min_by(|first, second| remainder(first).total_cmp(&remainder(second)));
            match nearest {
                Some(nearest)
                    if remainder(&nearest) < MAX_REMAINDER_PER_CHANGE * remainder(&closest) =>
                {
                    closest = nearest
                }
                _ => break,
            }
        }
        Ok(SearchResult::Unexplained(closest))
    }

    /// Returns all extensions of `changes` by one change whose topic is not among those of
    /// `changes`.
    fn extensions(&self, changes: &[(Side, Variant)]) -> Vec<Vec<(Side, Variant)>> {
        let used: Vec<Topic> = changes.iter().map(|(_, variant)| variant.topic()).collect();
        let mut extensions = vec![];
        for side in [Side::A, Side::B] {
            for variant in self.servers.variants(side) {
                let is_tried_on_a = side == Side::B
                    && variant.is_its_own_inverse()
                    && self.servers.variants(Side::A).contains(&variant);
                if !is_tried_on_a && !used.contains(&variant.topic()) {
                    extensions.push([changes, &[(side, variant)]].concat());
                }
            }
        }
        extensions
    }

    /// Returns both servers' answers under these changes; `a` and `b` are the answers without
    /// changes.
    async fn answers(
        &self,
        changes: &[(Side, Variant)],
        a: &Answers,
        b: &Answers,
    ) -> Result<(Answers, Answers), ExaminationError> {
        let changed_a = self.changed(Side::A, changes).await?;
        let changed_b = self.changed(Side::B, changes).await?;
        Ok((changed_a.unwrap_or_else(|| a.clone()), changed_b.unwrap_or_else(|| b.clone())))
    }

    /// Returns one server's answers under its changes; `None` if `changes` holds no change for this
    /// server.
    async fn changed(
        &self,
        side: Side,
        changes: &[(Side, Variant)],
    ) -> Result<Option<Answers>, ExaminationError> {
        let of_side = changes.iter().filter(|(changed, _)| *changed == side);
        let variants: Vec<Variant> = of_side.map(|(_, variant)| variant.clone()).collect();
        if variants.is_empty() {
            return Ok(None);
        }
        let all = self.servers.situation_count();
        let answers = self.servers.query(side, &variants, all, self.seeds).await?;
        Ok(Some(answers))
    }
}
