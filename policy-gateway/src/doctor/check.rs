//! `policy-gateway check URL`: checks that a server conforms to the policy protocol, then looks for
//! the usual mistakes of servers whose rollouts fail. This module orders the checks: `probe` queries
//! the server, `verdict` and `mistakes` judge the answers.
//!
//! The observations are synthetic, so no answer to them is good or bad: a mistake is a warning.

use benchmark::Action;
use proto::policy::Observation;
use tonic::Status;

use crate::doctor::answers::Answers;
use crate::doctor::mistakes::{self, Change};
use crate::doctor::probe::{EpisodeAnswers, ExaminationError, Probe, QueryOrder, Target};
use crate::doctor::randomness::{REPEATABLE, SEEDS_PER_MEAN};
use crate::doctor::variant::{Turn, Variant};
use crate::doctor::verdict::{self, Finding, Verdict, pass, points, skip};

const SEED: u64 = 1;
/// Seed of episodes whose answers may differ from those of the reference episode.
const OTHER_SEED: u64 = 2;
pub(crate) const CONCURRENCY: u32 = 8;
const TRIED_SITUATIONS: usize = 4;

points! {
    Description "the description is consistent",
    Version "another protocol version is refused",
    Health "the health service reports SERVING",
    Shape "answers are finite actions, n × 7, within the horizon",
    Range "actions lie within -1..1",
    Retry "a retry gets the same actions",
    SameSeed "the same seed gives the same actions",
    OtherSeed "another seed gives other actions exactly if declared stochastic",
    Order "the order of queries does not change the actions",
    Isolation "sessions do not affect one another",
    Restart "a Reset starts an open session anew",
    Batch "other queries of a batch do not change the actions",
    Unopened "a session that was never opened is refused",
    Speed "answer times are measured",
    Motion "the arm moves",
    Observations "other observations get other actions",
    Frames "other frames get other actions",
    Instructions "other instructions get other actions",
    Gripper "the gripper opens",
}

impl Point {
    /// Returns true if a server may conform without this point.
    fn is_mistake(self) -> bool {
        use Point::{Frames, Gripper, Instructions, Motion, Observations};
        matches!(self, Motion | Observations | Frames | Instructions | Gripper)
    }
}

/// Checks a policy server point by point, and reports each finding as soon as it is made. Returns
/// true if the server conforms to the protocol.
pub async fn check(
    target: &Target,
    report: &mut dyn FnMut(&Finding),
) -> Result<bool, ExaminationError> {
    let probe = Probe::connect(target).await?;
    let reference = probe.episode(SEED, QueryOrder::Forward).await;
    let reference = reference.map_err(|status| probe.failed(status))?;
    let mut usual = None;
    let mut conforms = true;
    for &point in Point::ALL {
        let verdict = examine(point, &probe, &reference, &mut usual).await;
        let verdict = match verdict.unwrap_or_else(|status| verdict::refused(&status)) {
            Verdict::Fail { reason } if point.is_mistake() => Verdict::Warn { reason },
            verdict => verdict,
        };
        conforms &= !verdict.has_failed();
        report(&Finding { point, verdict });
    }
    Ok(conforms)
}

async fn examine(
    point: Point,
    probe: &Probe,
    reference: &EpisodeAnswers,
    usual: &mut Option<Usual>,
) -> Result<Verdict, Status> {
    let described = &probe.described;
    let answers = &reference.answers;
    Ok(match point {
        Point::SameSeed
        | Point::OtherSeed
        | Point::Order
        | Point::Isolation
        | Point::Restart
        | Point::Batch
            if described.unseeded =>
        {
            skip(
                "the policy's random numbers do not depend on the seed, so episodes cannot be \
                 compared",
            )
        }
        Point::Description => pass(format!(
            "{:?}, checkpoint {:?}, horizon {}, execute {}",
            described.name, described.checkpoint, described.horizon, described.execute
        )),
        Point::Version => probe.other_version().await,
        Point::Health => probe.health().await?,
        Point::Shape => verdict::shapes(answers, described.horizon),
        Point::Range => verdict::range(answers),
        Point::Retry => {
            let (first, second) = probe.retries(SEED).await?;
            verdict::same(&first, &second)
        }
        Point::SameSeed => {
            let again = probe.episode(SEED, QueryOrder::Forward).await?;
            verdict::same(answers, &again.answers)
        }
        Point::OtherSeed => {
            let other = probe.episode(OTHER_SEED, QueryOrder::Forward).await?;
            verdict::seeds(described.stochastic, answers, &other.answers)
        }
        Point::Order if described.stateful => {
            skip("the policy is stateful: it requires queries in order")
        }
        Point::Order => {
            let backward = probe.episode(SEED, QueryOrder::Backward).await?;
            verdict::same(answers, &backward.answers)
        }
        Point::Isolation => verdict::same(answers, &probe.interleaved(SEED, OTHER_SEED).await?),
        Point::Restart => verdict::same(answers, &probe.restarted(SEED, OTHER_SEED).await?),
        Point::Batch if described.max_batch <= 1 => skip("the policy declares no batches"),
        Point::Batch => verdict::batch(answers, &probe.batched(SEED).await?),
        Point::Unopened => probe.unopened().await,
        Point::Speed => {
            let (wall, concurrent) = probe.concurrent_episodes(CONCURRENCY).await?;
            verdict::speed(&reference.latencies, CONCURRENCY, wall, &concurrent)
        }
        _ if verdict::shapes(answers, described.horizon).has_failed() => {
            skip("its answers are not actions")
        }
        mistake => {
            let usual = match usual {
                Some(usual) => usual,
                None => usual.insert(Usual::new(probe).await?),
            };
            usual.verdict(mistake, probe).await?
        }
    })
}

/// The server's answers in all situations, each in an episode of its own with the same instruction.
/// A server whose answers to a repeated query differ samples, and each of its answers is a mean.
struct Usual {
    answers_per_mean: usize,
    actions: Vec<Action>,
    /// Largest difference between answers to two situations, and to a repeated one.
    change: Change,
}

impl Usual {
    async fn new(probe: &Probe) -> Result<Self, Status> {
        let instruction = &probe.situations[0].instruction;
        let mut usual = Self { answers_per_mean: 1, actions: vec![], change: Change::default() };
        let mut repeated = vec![];
        for _ in 0..2 {
            repeated.push(usual.mean(probe, instruction, &probe.observations[0]).await?);
        }
        if largest_difference(&repeated[0], &repeated[1]) > REPEATABLE {
            usual.answers_per_mean = SEEDS_PER_MEAN;
        }
        let mut first: Vec<Vec<Action>> = vec![];
        for observation in &*probe.observations {
            let actions = usual.mean(probe, instruction, observation).await?;
            for earlier in &first {
                let difference = largest_difference(earlier, &actions);
                usual.change.largest = usual.change.largest.max(difference);
            }
            first.push(actions);
        }
        for (observation, earlier) in probe.observations.iter().zip(&first).take(TRIED_SITUATIONS) {
            let again = usual.mean(probe, instruction, observation).await?;
            usual.change.noise = usual.change.noise.max(largest_difference(earlier, &again));
        }
        usual.actions = first.concat();
        Ok(usual)
    }

    async fn verdict(&self, point: Point, probe: &Probe) -> Result<Verdict, Status> {
        let (actions, described) = (&self.actions, &probe.described);
        let effect = |largest| Change { largest, ..self.change };
        Ok(match point {
            Point::Motion => mistakes::motion(actions),
            Point::Gripper => mistakes::gripper(actions),
            _ if mistakes::is_constant(actions) => skip("all of its actions are the same"),
            Point::Observations => {
                mistakes::observations(self.change, probe.situations.len(), described)
            }
            Point::Frames if described.cameras.is_empty() => skip("it requests no frames"),
            Point::Frames => {
                let mut changes = vec![];
                for camera in &described.cameras {
                    let largest = self.with_other_frames(probe, &camera.name).await?;
                    changes.push((camera.name.clone(), effect(largest)));
                }
                mistakes::frames(&changes)
            }
            _ => match mistakes::reads_language(described) {
                Err(reason) => skip(reason),
                Ok(()) => {
                    let (largest, count) = self.with_other_instructions(probe).await?;
                    mistakes::instructions(effect(largest), count)
                }
            },
        })
    }

    /// Returns the largest change of an answer when one camera's frames are flipped or black.
    async fn with_other_frames(&self, probe: &Probe, camera: &str) -> Result<f64, Status> {
        let flipped = Variant::Turned(Turn::UpsideDown, Some(camera.to_owned()));
        let mut largest = 0.0_f64;
        for (situation, observation) in
            probe.situations.iter().zip(&*probe.observations).take(TRIED_SITUATIONS)
        {
            let unchanged = self.mean(probe, &situation.instruction, observation).await?;
            let mut changed = observation.clone();
            flipped.apply(situation, &mut changed);
            let mut black = changed.clone();
            for image in black.images.iter_mut().filter(|image| image.camera == camera) {
                image.rgb = vec![0; image.rgb.len()].into();
            }
            for changed in [changed, black] {
                let answer = self.mean(probe, &situation.instruction, &changed).await?;
                largest = largest.max(largest_difference(&unchanged, &answer));
            }
        }
        Ok(largest)
    }

    /// Returns the largest change of an answer when the instruction is replaced by another task's,
    /// with the number of instructions tried.
    async fn with_other_instructions(&self, probe: &Probe) -> Result<(f64, usize), Status> {
        let mut largest = 0.0_f64;
        let mut count = 0;
        for (index, observation) in probe.observations.iter().enumerate().take(TRIED_SITUATIONS) {
            let instruction = |index: usize| &probe.situations[index % probe.situations.len()];
            let own = instruction(index);
            let unchanged = self.mean(probe, &own.instruction, observation).await?;
            for other in [instruction(index + 1), instruction(index + 4)] {
                let answer = self.mean(probe, &other.instruction, observation).await?;
                largest = largest.max(largest_difference(&unchanged, &answer));
                count += 1;
            }
        }
        Ok((largest, count))
    }

    /// Returns the mean of the answers to an observation, as long as the shortest of them.
    async fn mean(
        &self,
        probe: &Probe,
        instruction: &str,
        observation: &Observation,
    ) -> Result<Vec<Action>, Status> {
        let mut answers = vec![];
        for _ in 0..self.answers_per_mean {
            answers.push(probe.actions((instruction, SEED), observation, 1).await?);
        }
        Ok(Answers::averaged(vec![answers]).chunks.concat())
    }
}

fn largest_difference(first: &[Action], second: &[Action]) -> f64 {
    let pairs = first.iter().flatten().zip(second.iter().flatten());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}
