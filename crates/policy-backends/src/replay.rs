//! Back-end that answers from recordings: an observation that equals the recorded observation of
//! the same query of the same episode gets the recorded actions. For any other observation, the
//! error names the first difference from the episode's first recording. Replay needs neither
//! computation nor a server.
//!
//! An episode is identified by suite, instruction and seed. If there are several recordings of an
//! episode, the recording that contains the query's observation is used.

use std::convert::Infallible;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Arc, Mutex, PoisonError};

use prost::Message;
use proto::policy::{
    DescribeResponse, InferRequest, InferResponse, Observation, ResetRequest, StateReading,
};
use sha2::{Digest, Sha256};
use transport::Access;

use crate::backend::{Backend, BackendError};
use crate::description;
use crate::recording::{self, Reader, RecordingError};
use crate::sessions::{MAX_SESSIONS, SessionTable};
use crate::spec::{Kind, OwnError, Specified};

pub(crate) const KIND: Kind =
    Kind::new::<Recordings>(&["replay"], "replay:FOLDER (recorded sessions)");

#[derive(Clone, Debug)]
struct Recordings(PathBuf);

impl FromStr for Recordings {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self(text.trim_start_matches("replay:").into()))
    }
}

impl fmt::Display for Recordings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "replay:{}", self.0.display())
    }
}

impl Specified for Recordings {
    fn open(&self, _: &Access) -> Result<Arc<dyn Backend>, OwnError> {
        Ok(Arc::new(Replay::open(&self.0)?))
    }
}

const BATCH_MODE: &str = "replayed from a recording";

pub struct Replay {
    folder: PathBuf,
    described: DescribeResponse,
    recorded: Vec<(PathBuf, ResetRequest)>,
    sessions: Mutex<SessionTable<Arc<Vec<RecordedEpisode>>>>,
}

/// Recording of an episode, with digests in place of the observations.
struct RecordedEpisode {
    path: PathBuf,
    steps: Vec<Step>,
}

struct Step {
    query_index: u32,
    digest: [u8; 32],
    answer: InferResponse,
}

impl Replay {
    pub fn open(folder: &Path) -> Result<Self, RecordingError> {
        let mut described: Option<(PathBuf, DescribeResponse)> = None;
        let mut recorded = vec![];
        for path in recording::files(folder)? {
            let reader = Reader::open(&path)?;
            let (first, expected) =
                described.get_or_insert_with(|| (path.clone(), reader.described.clone()));
            if let Some(difference) = description::difference(expected, &reader.described) {
                return Err(RecordingError::DifferentPolicies {
                    first: first.clone(),
                    other: path,
                    difference,
                });
            }
            recorded.push((path, reader.reset));
        }
        let (_, mut described) = described.unwrap_or_default();
        described.batch_mode = BATCH_MODE.to_owned();
        // Replay gains no speed from batches.
        described.max_batch = 1;
        Ok(Self {
            folder: folder.to_owned(),
            described,
            recorded,
            sessions: Mutex::new(SessionTable::new(MAX_SESSIONS)),
        })
    }

    fn sessions(&self) -> std::sync::MutexGuard<'_, SessionTable<Arc<Vec<RecordedEpisode>>>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[tonic::async_trait]
impl Backend for Replay {
    async fn describe(&self, _suite: &str) -> Result<DescribeResponse, BackendError> {
        Ok(self.described.clone())
    }

    async fn reset(&self, request: ResetRequest) -> Result<(), BackendError> {
        let key =
            |reset: &ResetRequest| (reset.suite.clone(), reset.instruction.clone(), reset.seed);
        let paths: Vec<_> = self
            .recorded
            .iter()
            .filter(|(_, reset)| key(reset) == key(&request))
            .map(|(path, _)| path.clone())
            .collect();
        if paths.is_empty() {
            let message = format!(
                "no recording in {:?} is of {:?} in {} with seed {}; record that rollout first",
                self.folder, request.instruction, request.suite, request.seed
            );
            return Err(BackendError::Policy { message });
        }
        let read = move || paths.into_iter().map(RecordedEpisode::read).collect();
        let read: Result<Vec<_>, RecordingError> =
            tokio::task::spawn_blocking(read).await.map_err(|error| policy_error(&error))?;
        let episodes = read.map_err(|error| policy_error(&format!("failed to {error}")))?;
        self.sessions().open(&request.session, Arc::new(episodes));
        Ok(())
    }

    async fn end(&self, session: &str) {
        self.sessions().close(session);
    }

    async fn infer(&self, query: InferRequest) -> Result<InferResponse, BackendError> {
        let episodes = self.sessions().get(&query.session).cloned();
        let episodes = episodes.ok_or(BackendError::SessionLost)?;
        let observation = query.observation.unwrap_or_default();
        let observed = digest(&observation);
        let answer =
            episodes.iter().find_map(|episode| episode.answer(query.query_index, observed));
        match answer {
            Some(answer) => Ok(answer.clone()),
            None => {
                let path = episodes.first().map(|episode| episode.path.clone());
                let path = path.unwrap_or_default();
                let compare = move || difference(&path, query.query_index, &observation);
                let compared = tokio::task::spawn_blocking(compare).await;
                let difference = compared.map_err(|error| policy_error(&error))?;
                Err(BackendError::Policy {
                    message: difference.unwrap_or_else(|error| format!("failed to {error}")),
                })
            }
        }
    }
}

impl RecordedEpisode {
    fn read(path: PathBuf) -> Result<Self, RecordingError> {
        let mut reader = Reader::open(&path)?;
        let mut steps = vec![];
        while let Some(pair) = reader.pair()? {
            steps.push(Step {
                query_index: pair.query.query_index,
                digest: digest(&pair.query.observation.unwrap_or_default()),
                answer: pair.answer,
            });
        }
        Ok(Self { path, steps })
    }

    fn answer(&self, query_index: u32, observed: [u8; 32]) -> Option<&InferResponse> {
        let step = self.steps.iter().find(|step| step.query_index == query_index)?;
        (step.digest == observed).then_some(&step.answer)
    }
}

impl fmt::Display for Replay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "replay:{}", self.folder.display())
    }
}

fn digest(observation: &Observation) -> [u8; 32] {
    Sha256::digest(observation.encode_to_vec()).into()
}

fn policy_error(error: &dyn fmt::Display) -> BackendError {
    BackendError::Policy { message: error.to_string() }
}

/// Describes the first difference between an observation and the recorded observation of the same
/// query.
fn difference(path: &Path, query_index: u32, sent: &Observation) -> Result<String, RecordingError> {
    let mut reader = Reader::open(path)?;
    let mut pairs = 0;
    while let Some(pair) = reader.pair()? {
        if pair.query.query_index == query_index {
            let recorded = pair.query.observation.unwrap_or_default();
            let difference = first_difference(&recorded, sent);
            return Ok(format!(
                "the observation is not the recorded observation ({}): {difference}",
                path.display()
            ));
        }
        pairs += 1;
    }
    Ok(format!(
        "the recording ({}) has {pairs} queries and none with the number {query_index}",
        path.display()
    ))
}

fn first_difference(recorded: &Observation, sent: &Observation) -> String {
    if recorded.images.len() != sent.images.len() {
        let counts = (recorded.images.len(), sent.images.len());
        return format!("{} frames were recorded, and {} were sent", counts.0, counts.1);
    }
    for (recorded, sent) in recorded.images.iter().zip(&sent.images) {
        let shape =
            |image: &proto::policy::Image| (image.camera.clone(), image.width, image.height);
        if shape(recorded) != shape(sent) {
            return format!(
                "frame {:?} was recorded, and {:?} was sent",
                shape(recorded),
                shape(sent)
            );
        }
        if recorded.rgb.len() != sent.rgb.len() {
            let counts = (recorded.rgb.len(), sent.rgb.len());
            return format!(
                "frame {:?} had {} bytes, and {} were sent",
                sent.camera, counts.0, counts.1
            );
        }
        let levels = recorded.rgb.iter().zip(&sent.rgb);
        let differing = levels.clone().filter(|(old, new)| old != new).count();
        if let Some(index) = levels.clone().position(|(old, new)| old != new) {
            let (column, row) =
                (index / 3 % sent.width.max(1) as usize, index / 3 / sent.width.max(1) as usize);
            return format!(
                "{differing} of {} numbers of {:?} differ, first at column {column} of row {row} \
                 (row 0 is at the bottom; {} was recorded, {} was sent)",
                sent.rgb.len(),
                sent.camera,
                recorded.rgb[index],
                sent.rgb[index],
            );
        }
    }
    let pairs = recorded.state.clone().into_iter().zip(sent.state.clone());
    let differs = |(recorded, sent): &(StateReading, StateReading)| recorded != sent;
    match pairs.into_iter().find(differs) {
        Some((recorded, sent)) => format!(
            "{} was recorded as {:?}, and {} was sent as {:?}",
            recorded.field().as_str_name(),
            recorded.values,
            sent.field().as_str_name(),
            sent.values
        ),
        None => "the simulator's states or the counts of readings differ".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn an_ended_session_is_not_kept() {
        let replay = Replay {
            folder: PathBuf::new(),
            described: DescribeResponse::default(),
            recorded: vec![],
            sessions: Mutex::new(SessionTable::new(1)),
        };
        replay.sessions().open("s", Arc::new(vec![]));
        replay.end("s").await;
        assert!(replay.sessions().get("s").is_none());
    }
}
