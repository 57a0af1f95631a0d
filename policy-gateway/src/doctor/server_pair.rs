//! The two compared servers with their situations. Queries a server in every situation, with the
//! given changes and seeds.

use proto::policy::{DescribeResponse, Observation};

use crate::doctor::{
    answers::Answers,
    server::{Action, ExaminationError, Server},
    situation::Situation,
    variant::Variant,
};

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
    a: Server,
    b: Server,
    situations: Vec<Situation>,
    /// Unchanged observations of all situations, by server.
    observations_a: Vec<Observation>,
    observations_b: Vec<Observation>,
    /// Number of queries per episode.
    queries: u32,
}

impl ServerPair {
    /// Prepares the observations of both servers.
    pub(crate) fn new(
        a: Server,
        b: Server,
        situations: Vec<Situation>,
    ) -> Result<Self, ExaminationError> {
        let observations = |server: &Server| -> Result<Vec<Observation>, ExaminationError> {
            let observations =
                situations.iter().map(|situation| situation.observation(&server.described));
            observations.collect::<Result<_, _>>().map_err(|missing| {
                ExaminationError::MissingInput { url: server.url.clone(), missing }
            })
        };
        let (observations_a, observations_b) = (observations(&a)?, observations(&b)?);
        let described = [&a.described, &b.described];
        let are_single = described.iter().all(|description| description.horizon == 1);
        let is_repeated = are_single && described.iter().any(|description| description.stateful);
        Ok(Self {
            observations_a,
            observations_b,
            situations,
            queries: if is_repeated { REPEATED_QUERIES } else { 1 },
            a,
            b,
        })
    }

    pub(crate) fn described(&self, side: Side) -> &DescribeResponse {
        &self.server(side).described
    }

    pub(crate) fn server(&self, side: Side) -> &Server {
        match side {
            Side::A => &self.a,
            Side::B => &self.b,
        }
    }

    pub(crate) fn situation_count(&self) -> usize {
        self.situations.len()
    }

    /// Returns the changes that apply to a server's observations in all situations.
    pub(crate) fn variants(&self, side: Side) -> Vec<Variant> {
        let other = match side {
            Side::A => Side::B,
            Side::B => Side::A,
        };
        let mut variants = Variant::all(self.described(side), self.described(other));
        variants
            .retain(|variant| self.situations.iter().all(|situation| variant.applies(situation)));
        variants
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
        let observations = match side {
            Side::A => &self.observations_a,
            Side::B => &self.observations_b,
        };
        let mut all = vec![];
        for (index, situation) in self.situations.iter().take(count).enumerate() {
            let mut observation = observations[index].clone();
            for variant in variants {
                variant.apply(situation, &mut observation);
            }
            let mut answers = vec![];
            for seed in seeds(index) {
                answers.push(self.chunk(side, situation, &observation, seed).await?);
            }
            all.push(answers);
        }
        Ok(Answers::averaged(all))
    }

    async fn chunk(
        &self,
        side: Side,
        situation: &Situation,
        observation: &Observation,
        seed: u64,
    ) -> Result<Vec<Action>, ExaminationError> {
        let server = self.server(side);
        let (suite, instruction) = (&situation.suite, &situation.instruction);
        let mut episode = server.episode(suite, instruction, seed).await?;
        let mut chunk = vec![];
        for _ in 0..self.queries {
            chunk.extend(episode.actions(observation.clone()).await?);
        }
        episode.end().await;
        Ok(chunk)
    }
}
