//! The diagnosed server, and the queries sent to it.

use std::time::Duration;

use benchmark::Suite;
use proto::checks::ActionFault;
use proto::policy::{InferResponse, Observation};

use crate::doctor::{
    randomness::{REPEATABLE, SEEDS_PER_MEAN},
    server::{Action, ExaminationError, Server},
    server_pair::SEED,
    situation::Situation,
    variant::{Turn, Variant},
};

/// Number of situations in which a change is tried.
const MAX_TRIED_SITUATIONS: usize = 4;
/// Queries per episode in the memory check.
const EPISODE_QUERIES: usize = 2;

/// The diagnosed server, the situations it is queried in, and its latencies.
pub(super) struct DiagnosedServer<'a> {
    server: &'a Server,
    situations: &'a [Situation],
    observations: Vec<Observation>,
    /// Number of answers to a query whose mean counts as its answer: several if they differ.
    answers_per_mean: usize,
    /// Latency of every query, in order.
    pub(super) latencies: Vec<Duration>,
}

#[derive(Default)]
pub(super) struct Answered {
    pub(super) count: usize,
    /// Faults of the answers that are not valid chunks of actions.
    pub(super) faults: Vec<ActionFault>,
    pub(super) actions: Vec<Action>,
    /// Largest difference between answers to two situations.
    pub(super) between_situations: f64,
    /// Largest difference between answers to a repeated query.
    pub(super) noise: f64,
}

impl<'a> DiagnosedServer<'a> {
    pub(super) fn new(
        server: &'a Server,
        situations: &'a [Situation],
    ) -> Result<Self, ExaminationError> {
        let observations =
            situations.iter().map(|situation| situation.observation(&server.described));
        let observations: Result<Vec<Observation>, _> = observations.collect();
        Ok(Self {
            server,
            situations,
            observations: observations.map_err(|missing| server.lacks(missing))?,
            answers_per_mean: 1,
            latencies: vec![],
        })
    }

    pub(super) fn server(&self) -> &'a Server {
        self.server
    }

    pub(super) fn situation_count(&self) -> usize {
        self.situations.len()
    }

    /// Queries each situation in an episode of its own, repeats some of these queries, then queries
    /// all situations in one shared episode. The instruction is always the same. If a repeated
    /// query gets another answer, the server samples, and every answer is a mean from then on.
    pub(super) async fn answer_all(&mut self) -> Result<Answered, ExaminationError> {
        let mut answered = Answered::default();
        let mut first: Vec<Vec<Action>> = vec![];
        let situation = &self.situations[0];
        let (suite, instruction) = (&situation.suite, &situation.instruction);
        let mut twice = vec![];
        for _ in 0..2 {
            let observation = self.observations[0].clone();
            twice.push(self.query(0, observation, Some(instruction)).await?.actions);
        }
        let pairs = twice[0].iter().zip(&twice[1]);
        let noise = pairs.map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
        if noise > REPEATABLE {
            self.answers_per_mean = SEEDS_PER_MEAN;
        }
        for index in 0..self.situations.len() {
            let actions = self.recorded(index, instruction, &mut answered).await?;
            for earlier in &first {
                let difference = largest_difference(earlier, &actions);
                answered.between_situations = answered.between_situations.max(difference);
            }
            first.push(actions);
        }
        for (index, earlier) in first.iter().enumerate().take(self.tried_situations()) {
            let repeated = self.recorded(index, instruction, &mut answered).await?;
            let difference = largest_difference(earlier, &repeated);
            answered.noise = answered.noise.max(difference);
        }
        let mut episode = self.server.episode(suite, instruction, SEED).await?;
        for observation in &self.observations {
            let answer = episode.query(observation.clone()).await?;
            self.latencies.push(answer.latency);
            answered.record(self.server, &answer.response);
        }
        episode.end().await;
        Ok(answered)
    }

    /// Returns the largest change of an answer when one camera's frames are flipped or black.
    pub(super) async fn with_other_frames(
        &mut self,
        camera: &str,
    ) -> Result<f64, ExaminationError> {
        let flipped = Variant::Turned(Turn::UpsideDown, Some(camera.to_owned()));
        let mut largest = 0.0_f64;
        for index in 0..self.tried_situations() {
            let unchanged = self.actions(index, self.observations[index].clone(), None).await?;
            let mut changed = self.observations[index].clone();
            flipped.apply(&self.situations[index], &mut changed);
            let to_flipped = self.actions(index, changed.clone(), None).await?;
            for image in changed.images.iter_mut().filter(|image| image.camera == camera) {
                image.rgb = vec![0; image.rgb.len()].into();
            }
            let to_black = self.actions(index, changed, None).await?;
            for answer in [to_flipped, to_black] {
                largest = largest.max(largest_difference(&unchanged, &answer));
            }
        }
        Ok(largest)
    }

    /// Returns the largest change of an answer when the instruction is replaced by another task's,
    /// with the number of instructions tried.
    pub(super) async fn with_other_instructions(
        &mut self,
    ) -> Result<(f64, usize), ExaminationError> {
        let mut largest = 0.0_f64;
        let mut count = 0;
        for index in 0..self.tried_situations() {
            let situation = &self.situations[index];
            let suite: Suite = situation.suite.parse().unwrap_or(Suite::Object);
            let tasks = suite.tasks().map(|task| task.instruction());
            let other_tasks = tasks.filter(|task| *task != situation.instruction);
            let instructions = other_tasks.skip(index).step_by(4).take(2);
            let unchanged = self.actions(index, self.observations[index].clone(), None).await?;
            for instruction in instructions {
                let observation = self.observations[index].clone();
                let answer = self.actions(index, observation, Some(&instruction)).await?;
                largest = largest.max(largest_difference(&unchanged, &answer));
                count += 1;
            }
        }
        Ok((largest, count))
    }

    /// Plays a short episode; returns the total latency of its queries.
    pub(super) async fn episode(&mut self) -> Result<Duration, ExaminationError> {
        let index = self.latencies.len();
        let situation = &self.situations[index % self.situations.len()];
        let (suite, instruction) = (&situation.suite, &situation.instruction);
        let mut episode = self.server.episode(suite, instruction, index as u64).await?;
        let mut total_latency = Duration::ZERO;
        for query in 0..EPISODE_QUERIES {
            let observation = &self.observations[(index + query) % self.observations.len()];
            let answer = episode.query(observation.clone()).await?;
            self.latencies.push(answer.latency);
            total_latency += answer.latency;
        }
        episode.end().await;
        Ok(total_latency)
    }

    fn tried_situations(&self) -> usize {
        MAX_TRIED_SITUATIONS.min(self.situations.len())
    }

    async fn actions(
        &mut self,
        index: usize,
        observation: Observation,
        instruction: Option<&str>,
    ) -> Result<Vec<Action>, ExaminationError> {
        let mut answers = vec![];
        for _ in 0..self.answers_per_mean {
            let response = self.query(index, observation.clone(), instruction).await?;
            let actions = self.server.actions(&response);
            answers.push(actions.map_err(|fault| ExaminationError::InvalidActions {
                url: self.server.url.clone(),
                fault,
            })?);
        }
        Ok(mean(&answers))
    }

    /// Queries an unchanged situation, and counts the answers.
    async fn recorded(
        &mut self,
        index: usize,
        instruction: &str,
        answered: &mut Answered,
    ) -> Result<Vec<Action>, ExaminationError> {
        let mut answers = vec![];
        for _ in 0..self.answers_per_mean {
            let observation = self.observations[index].clone();
            let response = self.query(index, observation, Some(instruction)).await?;
            answers.push(answered.record(self.server, &response));
        }
        Ok(mean(&answers))
    }

    /// Sends one query in its own episode.
    async fn query(
        &mut self,
        index: usize,
        observation: Observation,
        instruction: Option<&str>,
    ) -> Result<InferResponse, ExaminationError> {
        let situation = &self.situations[index];
        let instruction = instruction.unwrap_or(&situation.instruction);
        let mut episode = self.server.episode(&situation.suite, instruction, SEED).await?;
        let answer = episode.query(observation).await?;
        episode.end().await;
        self.latencies.push(answer.latency);
        Ok(answer.response)
    }
}

impl Answered {
    /// Counts an answer and returns its actions; empty if the answer is not a valid chunk.
    fn record(&mut self, server: &Server, response: &InferResponse) -> Vec<Action> {
        self.count += 1;
        match server.actions(response) {
            Ok(actions) => {
                self.actions.extend(&actions);
                actions
            }
            Err(fault) => {
                self.faults.push(fault);
                vec![]
            }
        }
    }
}

/// Returns the mean of answers, as long as the shortest of them.
fn mean(answers: &[Vec<Action>]) -> Vec<Action> {
    let length = answers.iter().map(Vec::len).min().unwrap_or(0);
    let at = |action: usize, number: usize| {
        answers.iter().map(|answer| answer[action][number]).sum::<f64>() / answers.len() as f64
    };
    (0..length).map(|action| std::array::from_fn(|number| at(action, number))).collect()
}

fn largest_difference(first: &[Action], second: &[Action]) -> f64 {
    let pairs = first.iter().flatten().zip(second.iter().flatten());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}
