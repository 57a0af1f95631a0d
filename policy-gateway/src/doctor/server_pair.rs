//! The two compared servers. Queries a server in every situation, with the given changes and seeds.

use proto::policy::DescribeResponse;

use crate::doctor::answers::Answers;
use crate::doctor::probe::{ExaminationError, Probe};
use crate::doctor::variant::Variant;

/// First seed, which is no program's default.
pub(crate) const SEED: u64 = 4_711;
/// Queries per episode, all with the same observation, for stateful policies that answer one
/// action at a time from a chunk: a single answer would show only the first action of the chunk.
const REPEATED_QUERIES: u32 = 4;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    /// The first server on the command line.
    A,
    /// The second server on the command line.
    B,
}

pub(crate) struct ServerPair {
    a: Probe,
    b: Probe,
    /// Number of queries per episode.
    queries: u32,
}

impl ServerPair {
    pub(crate) fn new(a: Probe, b: Probe) -> Self {
        let described = [&a.described, &b.described];
        let are_single = described.iter().all(|description| description.horizon == 1);
        let is_repeated = are_single && described.iter().any(|description| description.stateful);
        Self { queries: if is_repeated { REPEATED_QUERIES } else { 1 }, a, b }
    }

    pub(crate) fn described(&self, side: Side) -> &DescribeResponse {
        &self.server(side).described
    }

    fn server(&self, side: Side) -> &Probe {
        match side {
            Side::A => &self.a,
            Side::B => &self.b,
        }
    }

    pub(crate) fn situation_count(&self) -> usize {
        self.a.situations.len()
    }

    pub(crate) fn variants(&self, side: Side) -> Vec<Variant> {
        match side {
            Side::A => Variant::all(&self.a.described, &self.b.described),
            Side::B => Variant::all(&self.b.described, &self.a.described),
        }
    }

    /// Queries a server in the first `count` situations, changed by `variants`, once per seed of
    /// `seeds(situation)`.
    pub(crate) async fn query(
        &self,
        side: Side,
        variants: &[Variant],
        count: usize,
        seeds: impl Fn(usize) -> Vec<u64>,
    ) -> Result<Answers, ExaminationError> {
        let server = self.server(side);
        let mut all = vec![];
        for (index, situation) in server.situations.iter().enumerate().take(count) {
            let mut observation = server.observations[index].clone();
            for variant in variants {
                variant.apply(situation, &mut observation);
            }
            let mut answers = vec![];
            for seed in seeds(index) {
                let episode = (&*situation.instruction, seed);
                let actions = server.actions(episode, &observation, self.queries).await;
                answers.push(actions.map_err(|status| server.failed(status))?);
            }
            all.push(answers);
        }
        Ok(Answers::averaged(all))
    }
}
