//! Client of an examined server, with the observations that it is sent.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use benchmark::{Action, Suite};
use policy_backends::DEFAULT_ANSWER_WITHIN;
use policy_backends::description::MAX_BATCH_QUERIES;
use policy_backends::grpc::CONNECT_TIMEOUT;
use policy_backends::http2::{CONNECTION_WINDOW_BYTES, STREAM_WINDOW_BYTES};
use proto::checks::DescriptionFault;
use proto::policy::policy_client::PolicyClient;
use proto::policy::policy_server::SERVICE_NAME;
use proto::policy::{
    DescribeRequest, DescribeResponse, EndRequest, InferBatchRequest, InferRequest, InferResponse,
    Observation, ResetRequest, infer_result,
};
use thiserror::Error;
use tokio::task::JoinSet;
use tonic::{Code, Status};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use transport::{
    Access, AccessError, ConnectError, Connection, Peer, ServerKind, Settings, parse_endpoint,
    status_text,
};

use crate::doctor::synthetic::{self, Situation};
use crate::doctor::verdict::{Verdict, fail, pass, refused};

const SETTINGS: Settings =
    Settings { address: "the URL", authority: "--ca", clear: "grpc://", encrypted: "https://" };
/// Queries per episode.
const QUERIES: u32 = 5;

/// Server and policy to examine.
#[derive(Clone, Debug)]
pub struct Target {
    /// `grpc://HOST:PORT`; over TLS, `https://HOST:PORT`.
    pub url: String,
    /// Address as the user gave it, for messages.
    pub shown: String,
    /// Name of the policy; empty selects the only policy of the server.
    pub policy: String,
    pub suite: Suite,
    pub access: Access,
}

/// Reason why a server cannot be examined. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum ExaminationError {
    #[error("read {url:?} as a policy server's address: write grpc://HOST:PORT")]
    Url { url: String },
    #[error(transparent)]
    Access(#[from] AccessError),
    #[error("reach the policy server at {url}: {trouble}")]
    Connect { url: String, trouble: Box<ConnectError> },
    #[error("have {url} describe its policy: {}", status_text(status))]
    Describe { url: String, status: Box<Status> },
    #[error("use the description of {url}: {fault}")]
    Description { url: String, fault: DescriptionFault },
    #[error("play one episode with {url}: {}", status_text(status))]
    Episode { url: String, status: Box<Status> },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum QueryOrder {
    Forward,
    Backward,
}

#[derive(Clone, Debug)]
pub(crate) struct EpisodeAnswers {
    pub answers: Vec<InferResponse>,
    /// Latency of each query, in the order of sending.
    pub latencies: Vec<Duration>,
}

#[derive(Clone, Debug)]
pub struct Probe {
    connection: Connection,
    client: PolicyClient<Connection>,
    target: Target,
    pub described: DescribeResponse,
    pub(crate) situations: Arc<[Situation]>,
    /// Observation of each situation, as the server requests it.
    pub(crate) observations: Arc<[Observation]>,
    sessions: Arc<AtomicU32>,
    /// Process id, which distinguishes this run's sessions from those of other runs.
    run: u32,
}

impl Probe {
    pub async fn connect(target: &Target) -> Result<Self, ExaminationError> {
        let url = || target.shown.clone();
        let endpoint = parse_endpoint(&target.url)
            .map_err(|_| ExaminationError::Url { url: url() })?
            .connect_timeout(CONNECT_TIMEOUT)
            .timeout(DEFAULT_ANSWER_WITHIN)
            .tcp_nodelay(true)
            .initial_stream_window_size(STREAM_WINDOW_BYTES)
            .initial_connection_window_size(CONNECTION_WINDOW_BYTES);
        let peer = Peer::new(&endpoint, ServerKind::Policy, SETTINGS);
        let connection = target.access.connect_lazy(endpoint)?;
        let mut client = PolicyClient::new(connection.clone())
            .max_decoding_message_size(proto::MAX_MESSAGE_BYTES)
            .max_encoding_message_size(proto::MAX_MESSAGE_BYTES);
        let described = client.describe(describe(target, proto::PROTOCOL_VERSION)).await;
        let described = described.map_err(|status| match peer.diagnose(&status) {
            Some(trouble) => ExaminationError::Connect { url: url(), trouble: trouble.into() },
            None => ExaminationError::Describe { url: url(), status: status.into() },
        });
        let described = described?.into_inner();
        if let Err(fault) = proto::checks::description(&described) {
            return Err(ExaminationError::Description { url: url(), fault });
        }
        let situations: Arc<[Situation]> = synthetic::situations(target.suite).into();
        let observations = situations.iter().map(|situation| situation.observation(&described));
        Ok(Self {
            connection,
            client,
            target: target.clone(),
            observations: observations.collect(),
            situations,
            described,
            sessions: Arc::default(),
            run: std::process::id(),
        })
    }

    pub(crate) fn failed(&self, status: Status) -> ExaminationError {
        ExaminationError::Episode { url: self.target.shown.clone(), status: status.into() }
    }

    pub(crate) async fn other_version(&self) -> Verdict {
        let newer = proto::PROTOCOL_VERSION + 1;
        match self.client.clone().describe(describe(&self.target, newer)).await {
            Err(status) if status.code() == Code::FailedPrecondition => pass(""),
            Err(status) => refused(&status),
            Ok(_) => fail(format!("it accepts a caller of protocol version {newer}")),
        }
    }

    /// Checks that the health service reports SERVING for the policy service; any other state is a
    /// failed verdict.
    pub(crate) async fn health(&self) -> Result<Verdict, Status> {
        let request = HealthCheckRequest { service: SERVICE_NAME.to_owned() };
        let answer = HealthClient::new(self.connection.clone()).check(request).await?.into_inner();
        Ok(match answer.status() {
            ServingStatus::Serving => pass(""),
            other => fail(format!("it reports {}", other.as_str_name())),
        })
    }

    pub(crate) async fn episode(
        &self,
        seed: u64,
        order: QueryOrder,
    ) -> Result<EpisodeAnswers, Status> {
        self.episode_in(&self.session(), seed, order).await
    }

    async fn episode_in(
        &self,
        session: &str,
        seed: u64,
        order: QueryOrder,
    ) -> Result<EpisodeAnswers, Status> {
        self.reset(session, seed).await?;
        let mut episode = EpisodeAnswers { answers: vec![], latencies: vec![] };
        for at in 0..QUERIES {
            let query_index = match order {
                QueryOrder::Forward => at,
                QueryOrder::Backward => QUERIES - 1 - at,
            };
            let sent = Instant::now();
            episode.answers.push(self.infer(session, query_index).await?);
            episode.latencies.push(sent.elapsed());
        }
        if order == QueryOrder::Backward {
            episode.answers.reverse();
        }
        Ok(episode)
    }

    /// Plays one episode with every query sent twice; returns the first and the second answers.
    pub(crate) async fn retries(
        &self,
        seed: u64,
    ) -> Result<(Vec<InferResponse>, Vec<InferResponse>), Status> {
        let session = self.session();
        self.reset(&session, seed).await?;
        let (mut answers, mut retries) = (vec![], vec![]);
        for query_index in 0..QUERIES {
            answers.push(self.infer(&session, query_index).await?);
            retries.push(self.infer(&session, query_index).await?);
        }
        Ok((answers, retries))
    }

    /// Plays two episodes in alternation, with `seed` and `other_seed`; returns the answers of the
    /// episode with `seed`.
    pub(crate) async fn interleaved(
        &self,
        seed: u64,
        other_seed: u64,
    ) -> Result<Vec<InferResponse>, Status> {
        let (mine, others) = (self.session(), self.session());
        self.reset(&mine, seed).await?;
        self.reset(&others, other_seed).await?;
        let mut answers = vec![];
        for query_index in 0..QUERIES {
            self.infer(&others, query_index).await?;
            answers.push(self.infer(&mine, query_index).await?);
        }
        Ok(answers)
    }

    /// Plays half an episode with `other_seed`, then restarts the session with `seed`; returns
    /// the answers after the restart.
    pub(crate) async fn restarted(
        &self,
        seed: u64,
        other_seed: u64,
    ) -> Result<Vec<InferResponse>, Status> {
        let session = self.session();
        self.reset(&session, other_seed).await?;
        for query_index in 0..QUERIES / 2 {
            self.infer(&session, query_index).await?;
        }
        Ok(self.episode_in(&session, seed, QueryOrder::Forward).await?.answers)
    }

    /// Plays concurrent episodes in batches of the policy's largest size; returns the answers of
    /// the first episode, whose seed is `seed`.
    pub(crate) async fn batched(&self, seed: u64) -> Result<Vec<InferResponse>, Status> {
        let size = self.described.max_batch.min(MAX_BATCH_QUERIES as u32);
        let sessions: Vec<_> = (0..size).map(|_| self.session()).collect();
        for (session, seed) in sessions.iter().zip(seed..) {
            self.reset(session, seed).await?;
        }
        let mut answers = vec![];
        for query_index in 0..QUERIES {
            let queries = sessions.iter().map(|session| self.query(session, query_index));
            let request = InferBatchRequest { queries: queries.collect() };
            let batch = self.client.clone().infer_batch(request).await?;
            let first =
                batch.into_inner().results.into_iter().next().and_then(|result| result.result);
            answers.push(match first {
                Some(infer_result::Result::Response(response)) => response,
                Some(infer_result::Result::Error(text)) => return Err(Status::internal(text)),
                None => return Err(Status::internal("the answer to a batch lacks a result")),
            });
        }
        Ok(answers)
    }

    pub(crate) async fn unopened(&self) -> Verdict {
        match self.infer(&self.session(), 0).await {
            Err(_) => pass(""),
            Ok(_) => fail("it answers without instruction and seed"),
        }
    }

    /// Plays `concurrency` episodes at once; returns the total time and every query's latency.
    pub(crate) async fn concurrent_episodes(
        &self,
        concurrency: u32,
    ) -> Result<(Duration, Vec<Duration>), Status> {
        let started = Instant::now();
        let mut playing = JoinSet::new();
        for seed in 0..concurrency {
            let probe = self.clone();
            playing.spawn(async move { probe.episode(seed.into(), QueryOrder::Forward).await });
        }
        let mut latencies = vec![];
        while let Some(played) = playing.join_next().await {
            let episode = played.map_err(|error| Status::internal(error.to_string()))??;
            latencies.extend(episode.latencies);
        }
        Ok((started.elapsed(), latencies))
    }

    /// Sends an observation `count` times in a session of its own; returns the actions of all
    /// answers.
    pub(crate) async fn actions(
        &self,
        (instruction, seed): (&str, u64),
        observation: &Observation,
        count: u32,
    ) -> Result<Vec<Action>, Status> {
        let session = self.session();
        self.reset_to(&session, instruction, seed).await?;
        let mut actions = vec![];
        for query_index in 0..count {
            let query = InferRequest {
                observation: Some(observation.clone()),
                ..self.query(&session, query_index)
            };
            let response = self.client.clone().infer(query).await?.into_inner();
            let chunk = proto::checks::actions(&response, self.described.horizon);
            let chunk = chunk.map_err(|fault| Status::internal(fault.to_string()))?;
            actions.extend(chunk.iter().map(|action| action.map(f64::from)));
        }
        let end = EndRequest { policy: self.target.policy.clone(), session };
        // A server may not implement `End`.
        let _ = self.client.clone().end(end).await;
        Ok(actions)
    }

    async fn reset(&self, session: &str, seed: u64) -> Result<(), Status> {
        self.reset_to(session, &self.situations[0].instruction, seed).await
    }

    async fn reset_to(&self, session: &str, instruction: &str, seed: u64) -> Result<(), Status> {
        let request = ResetRequest {
            policy: self.target.policy.clone(),
            session: session.to_owned(),
            suite: self.target.suite.name().to_owned(),
            instruction: instruction.to_owned(),
            seed,
        };
        self.client.clone().reset(request).await.map(drop)
    }

    async fn infer(&self, session: &str, query_index: u32) -> Result<InferResponse, Status> {
        let query = self.query(session, query_index);
        Ok(self.client.clone().infer(query).await?.into_inner())
    }

    fn query(&self, session: &str, query_index: u32) -> InferRequest {
        InferRequest {
            policy: self.target.policy.clone(),
            session: session.to_owned(),
            query_index,
            observation: self.observations.get(query_index as usize).cloned(),
            under_way: None,
        }
    }

    fn session(&self) -> String {
        let number = self.sessions.fetch_add(1, Ordering::Relaxed);
        format!("examination {}: {number}", self.run)
    }
}

fn describe(target: &Target, protocol_version: u32) -> DescribeRequest {
    DescribeRequest {
        protocol_version,
        policy: target.policy.clone(),
        suite: target.suite.name().to_owned(),
    }
}
