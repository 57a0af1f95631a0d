//! Client of the conformance check: plays episodes of synthetic observations and collects the
//! answers. Judges three points itself, the protocol version, the health service and sessions
//! without a Reset; `verdict` judges the others.

use std::time::{Duration, Instant};

use policy_backends::{
    DEFAULT_ANSWER_WITHIN,
    description::MAX_BATCH_QUERIES,
    grpc::CONNECT_TIMEOUT,
    http2::{CONNECTION_WINDOW_BYTES, STREAM_WINDOW_BYTES},
};
use proto::policy::{
    DescribeRequest, DescribeResponse, InferBatchRequest, InferRequest, InferResponse,
    ResetRequest, infer_result, policy_client::PolicyClient, policy_server::SERVICE_NAME,
};
use tokio::task::JoinSet;
use tonic::{Code, Status};
use tonic_health::pb::{
    HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient,
};
use transport::{Connection, Peer, ServerKind, Settings, parse_endpoint};

use super::{ConformanceError, QUERIES, Target, scene, verdict::refused};
use crate::doctor::verdict::{Verdict, fail, pass};

const SETTINGS: Settings =
    Settings { address: "the URL", authority: "--ca", clear: "grpc://", encrypted: "https://" };

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum QueryOrder {
    Forward,
    Backward,
}

#[derive(Clone, Debug)]
pub(super) struct EpisodeAnswers {
    pub answers: Vec<InferResponse>,
    /// Latency of each query, in the order of sending.
    pub latencies: Vec<Duration>,
}

#[derive(Clone, Debug)]
pub(super) struct Probe {
    connection: Connection,
    client: PolicyClient<Connection>,
    target: Target,
    described: DescribeResponse,
    /// Process id, which distinguishes this run's sessions from those of other runs.
    run: u32,
}

impl Probe {
    /// Connects and reads the policy's description.
    pub(super) async fn connect(target: &Target) -> Result<Self, ConformanceError> {
        let endpoint = parse_endpoint(&target.url)
            .map_err(|_| ConformanceError::Url { url: target.shown.clone() })?
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
        let described = match described {
            Ok(response) => response.into_inner(),
            Err(status) => {
                let url = target.shown.clone();
                return Err(match peer.diagnose(&status) {
                    Some(trouble) => ConformanceError::Connect { url, trouble: trouble.into() },
                    None => ConformanceError::Describe { url, status: status.into() },
                });
            }
        };
        Ok(Self { connection, client, target: target.clone(), described, run: std::process::id() })
    }

    pub(super) fn described(&self) -> &DescribeResponse {
        &self.described
    }

    pub(super) async fn other_version(&self) -> Verdict {
        let newer = proto::PROTOCOL_VERSION + 1;
        match self.client.clone().describe(describe(&self.target, newer)).await {
            Err(status) if status.code() == Code::FailedPrecondition => pass(""),
            Err(status) => refused(&status),
            Ok(_) => fail(format!("it accepts a caller of protocol version {newer}")),
        }
    }

    /// Checks that the health service reports SERVING for the policy service; any other state is a
    /// failed verdict.
    pub(super) async fn health(&self) -> Result<Verdict, Status> {
        let request = HealthCheckRequest { service: SERVICE_NAME.to_owned() };
        let answer = HealthClient::new(self.connection.clone()).check(request).await?.into_inner();
        Ok(match answer.status() {
            ServingStatus::Serving => pass(""),
            other => fail(format!("it reports {}", other.as_str_name())),
        })
    }

    pub(super) async fn episode(
        &self,
        name: &str,
        seed: u64,
        order: QueryOrder,
    ) -> Result<EpisodeAnswers, Status> {
        self.reset(name, seed).await?;
        let mut episode = EpisodeAnswers { answers: vec![], latencies: vec![] };
        for at in 0..QUERIES {
            let query_index = match order {
                QueryOrder::Forward => at,
                QueryOrder::Backward => QUERIES - 1 - at,
            };
            let sent = Instant::now();
            episode.answers.push(self.infer(name, query_index).await?);
            episode.latencies.push(sent.elapsed());
        }
        if order == QueryOrder::Backward {
            episode.answers.reverse();
        }
        Ok(episode)
    }

    /// Plays one episode with every query sent twice; returns the first and the second answers.
    pub(super) async fn retries(
        &self,
        seed: u64,
    ) -> Result<(Vec<InferResponse>, Vec<InferResponse>), Status> {
        self.reset("retried", seed).await?;
        let (mut answers, mut retries) = (vec![], vec![]);
        for query_index in 0..QUERIES {
            answers.push(self.infer("retried", query_index).await?);
            retries.push(self.infer("retried", query_index).await?);
        }
        Ok((answers, retries))
    }

    /// Plays two episodes in alternation, with `seed` and `other_seed`; returns the answers of the
    /// episode with `seed`.
    pub(super) async fn interleaved(
        &self,
        seed: u64,
        other_seed: u64,
    ) -> Result<Vec<InferResponse>, Status> {
        self.reset("mine", seed).await?;
        self.reset("other's", other_seed).await?;
        let mut answers = vec![];
        for query_index in 0..QUERIES {
            self.infer("other's", query_index).await?;
            answers.push(self.infer("mine", query_index).await?);
        }
        Ok(answers)
    }

    /// Plays half an episode with `other_seed`, then restarts the session with `seed`; returns
    /// the answers after the restart.
    pub(super) async fn restarted(
        &self,
        seed: u64,
        other_seed: u64,
    ) -> Result<Vec<InferResponse>, Status> {
        self.reset("restarted", other_seed).await?;
        for query_index in 0..QUERIES / 2 {
            self.infer("restarted", query_index).await?;
        }
        Ok(self.episode("restarted", seed, QueryOrder::Forward).await?.answers)
    }

    /// Plays concurrent episodes in batches of the policy's largest size; returns the answers of
    /// the first episode, whose seed is `seed`.
    pub(super) async fn batched(&self, seed: u64) -> Result<Vec<InferResponse>, Status> {
        let size = self.described.max_batch.min(MAX_BATCH_QUERIES as u32);
        let names: Vec<_> = (0..size).map(|at| format!("in a batch {at}")).collect();
        for (name, seed) in names.iter().zip(seed..) {
            self.reset(name, seed).await?;
        }
        let mut answers = vec![];
        for query_index in 0..QUERIES {
            let queries = names.iter().map(|name| self.query(name, query_index)).collect();
            let batch = self.client.clone().infer_batch(InferBatchRequest { queries }).await?;
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

    pub(super) async fn unopened(&self) -> Verdict {
        match self.infer("never opened", 0).await {
            Err(_) => pass(""),
            Ok(_) => fail("it answers without instruction and seed"),
        }
    }

    /// Plays `concurrency` episodes at once; returns the total time and every query's latency.
    pub(super) async fn concurrent_episodes(
        &self,
        concurrency: u32,
    ) -> Result<(Duration, Vec<Duration>), Status> {
        let started = Instant::now();
        let mut playing = JoinSet::new();
        for at in 0..concurrency {
            let probe = self.clone();
            playing.spawn(async move {
                let name = format!("concurrent {at}");
                probe.episode(&name, u64::from(at), QueryOrder::Forward).await
            });
        }
        let mut latencies = vec![];
        while let Some(played) = playing.join_next().await {
            let episode = played.map_err(|error| Status::internal(error.to_string()))??;
            latencies.extend(episode.latencies);
        }
        Ok((started.elapsed(), latencies))
    }

    async fn reset(&self, name: &str, seed: u64) -> Result<(), Status> {
        let request = ResetRequest {
            policy: self.target.policy.clone(),
            session: self.session(name),
            suite: self.target.suite.clone(),
            instruction: scene::instruction(&self.target.suite).to_owned(),
            seed,
        };
        self.client.clone().reset(request).await.map(drop)
    }

    async fn infer(&self, name: &str, query_index: u32) -> Result<InferResponse, Status> {
        let query = self.query(name, query_index);
        Ok(self.client.clone().infer(query).await?.into_inner())
    }

    fn query(&self, name: &str, query_index: u32) -> InferRequest {
        InferRequest {
            policy: self.target.policy.clone(),
            session: self.session(name),
            query_index,
            observation: Some(scene::observation(&self.described, query_index)),
            under_way: None,
        }
    }

    fn session(&self, name: &str) -> String {
        format!("conformance check {}: {name}", self.run)
    }
}

fn describe(target: &Target, protocol_version: u32) -> DescribeRequest {
    DescribeRequest { protocol_version, policy: target.policy.clone(), suite: target.suite.clone() }
}
