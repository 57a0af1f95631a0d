//! Client of the policy protocol: describes, resets and queries a policy, and checks its answers
//! before an action reaches a robot. Calls block, because a slot waits for its policy anyway.
//! Retries are up to the coordinator, which pauses the jobs of a policy that is down.

use std::time::Duration;

use benchmark::Query;
use proto::checks::{ACTION_WIDTH, DescriptionFault};
use proto::policy::policy_client::PolicyClient as GrpcClient;
use proto::policy::{
    DescribeRequest, DescribeResponse, EndRequest, InferRequest, Observation, ResetRequest,
    StateField, UnderWay,
};
use proto::{MAX_MESSAGE_BYTES, PROTOCOL_VERSION};
use tokio::runtime::Runtime;
use tonic::transport::Endpoint;
use tonic::{Code, Response, Status};
use transport::{
    Access, Connection, Peer, ServerKind, Settings, chain, is_outage, parse_endpoint, status_text,
};

use crate::actor::{Action, Actor, Description, PolicyError, PolicySession};
use crate::grpc::with_deadline;
use crate::message::Assignment;

/// Longest wait for one answer. A policy that compiles its network must do so before it serves.
pub const POLICY_CALL_DEADLINE: Duration = Duration::from_secs(60);
/// Longest wait for the acknowledgement of an episode's end.
const END_DEADLINE: Duration = Duration::from_secs(2);
const CONNECT_DEADLINE: Duration = Duration::from_secs(10);
/// HTTP/2 receive window, bytes: larger than an answer, so that no call waits for a window update.
const WINDOW_BYTES: u32 = 4 << 20;

#[derive(Debug)]
pub struct PolicyClient {
    endpoint: String,
    // Its background thread keeps the connection alive while the simulator occupies the main
    // thread.
    runtime: Runtime,
    grpc: GrpcClient<Connection>,
    peer: Peer,
    /// Number of queries that the policy has answered since it last described itself, that is, in
    /// the current attempt; `None` if the last Describe failed.
    answered: Option<u32>,
}

/// Names, in messages, of the settings with which a campaign's user addresses a policy.
pub const CAMPAIGN_SETTINGS: Settings = Settings {
    address: "the campaign's endpoint",
    authority: "the worker's --ca",
    clear: "http://",
    encrypted: "https://",
};
/// Names, in messages, of the settings with which the user of `worker rollout` addresses a policy.
pub const ROLLOUT_SETTINGS: Settings =
    Settings { address: "--endpoint", authority: "--ca", ..CAMPAIGN_SETTINGS };

impl PolicyClient {
    /// Creates a client of `grpc://HOST:PORT` or `http://HOST:PORT`, or with TLS `grpcs://` or
    /// `https://`. `settings` names, in messages, the settings with which a user addresses the
    /// policy. The first call opens the connection.
    pub fn new(endpoint: &str, access: &Access, settings: Settings) -> Result<Self, PolicyError> {
        let address = parse_endpoint(endpoint).map_err(PolicyError::Endpoint)?;
        let address = with_settings(address);
        let peer = Peer::new(&address, ServerKind::Policy, settings);
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .map_err(PolicyError::Runtime)?;
        let grpc = {
            let _runtime_context = runtime.enter();
            connect(address, access)?
        };
        Ok(Self { endpoint: endpoint.to_owned(), runtime, grpc, peer, answered: None })
    }

    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    fn call<T, F>(&self, deadline: Duration, call: F) -> Result<T, Status>
    where
        F: Future<Output = Result<Response<T>, Status>>,
    {
        self.runtime.block_on(with_deadline(deadline, call))
    }

    fn unavailable(&self, call: &str, session: PolicySession<'_>, status: &Status) -> PolicyError {
        PolicyError::Unavailable {
            answered: self.answered.filter(|_| status.code() != Code::ResourceExhausted),
            call: call.to_owned(),
            policy: session.policy.to_owned(),
            endpoint: self.endpoint.clone(),
            problem: self.explain(status),
        }
    }

    fn refused(&self, call: &str, session: PolicySession<'_>, status: &Status) -> PolicyError {
        if is_outage(status) {
            return self.unavailable(call, session, status);
        }
        PolicyError::Failed {
            call: call.to_owned(),
            policy: session.policy.to_owned(),
            endpoint: self.endpoint.clone(),
            problem: self.explain(status),
        }
    }

    /// Describes a failed call: by the policy's own error, or by a diagnosis of the connection.
    fn explain(&self, status: &Status) -> String {
        let diagnosis = self.peer.diagnose(status);
        diagnosis.map_or_else(|| status_text(status), |diagnosis| diagnosis.to_string())
    }
}

impl Actor for PolicyClient {
    fn describe(&mut self, session: PolicySession<'_>) -> Result<Description, PolicyError> {
        let request = DescribeRequest {
            protocol_version: PROTOCOL_VERSION,
            policy: session.policy.to_owned(),
            suite: session.suite.to_owned(),
        };
        let mut grpc = self.grpc.clone();
        self.answered = None;
        let about = self
            .call(session.deadline, grpc.describe(request))
            .map_err(|status| self.unavailable("Describe", session, &status))?;
        self.answered = Some(0);
        read_description(about).map_err(|fault| PolicyError::Description {
            policy: session.policy.to_owned(),
            endpoint: self.endpoint.clone(),
            fault,
        })
    }

    fn reset(
        &mut self,
        session: PolicySession<'_>,
        instruction: &str,
        seed: u64,
    ) -> Result<(), PolicyError> {
        let request = ResetRequest {
            policy: session.policy.to_owned(),
            session: session.session.to_owned(),
            suite: session.suite.to_owned(),
            instruction: instruction.to_owned(),
            seed,
        };
        let mut grpc = self.grpc.clone();
        self.call(session.deadline, grpc.reset(request))
            .map(|_| ())
            .map_err(|status| self.refused("Reset", session, &status))
    }

    fn end(&mut self, session: PolicySession<'_>) {
        let grpc = self.grpc.clone();
        self.runtime.block_on(end(grpc, session));
    }

    fn infer(
        &mut self,
        session: PolicySession<'_>,
        query_index: u32,
        observation: Observation,
        horizon: usize,
        under_way: Option<&Query>,
    ) -> Result<Vec<Action>, PolicyError> {
        let mut request = infer_request(session, query_index, observation);
        request.under_way = under_way.map(|query| UnderWay {
            // Policies answer with 32-bit floats, so the conversion is exact.
            actions: query.under_way.iter().flatten().map(|value| *value as f32).collect(),
            action_width: ACTION_WIDTH as u32,
            delay: query.delay,
        });
        let mut grpc = self.grpc.clone();
        let call = format!("query {query_index}");
        let response = self
            .call(session.deadline, grpc.infer(request))
            .map_err(|status| self.refused(&call, session, &status))?;
        self.answered = Some(query_index + 1);
        let horizon = u32::try_from(horizon).unwrap_or(u32::MAX);
        let actions = proto::checks::actions(&response, horizon);
        let actions = actions.map_err(|fault| PolicyError::InvalidAnswer {
            call,
            policy: session.policy.to_owned(),
            endpoint: self.endpoint.clone(),
            fault,
        })?;
        Ok(actions.iter().map(|action| action.map(f64::from)).collect())
    }
}

/// Ends the session of a rollout whose slot died, so that the policy's capacity is free at once.
pub(crate) async fn end_session(rollout: &Assignment, access: &Access) {
    let address = parse_endpoint(&rollout.policy_endpoint).map_err(PolicyError::Endpoint);
    match address.and_then(|address| connect(with_settings(address), access)) {
        Ok(grpc) => end(grpc, rollout.policy_session()).await,
        Err(error) => tracing::debug!("end of session {}: {}", rollout.session, chain(&error)),
    }
}

fn connect(address: Endpoint, access: &Access) -> Result<GrpcClient<Connection>, PolicyError> {
    Ok(GrpcClient::new(access.connect_lazy(address).map_err(PolicyError::Access)?)
        .max_decoding_message_size(MAX_MESSAGE_BYTES)
        .max_encoding_message_size(MAX_MESSAGE_BYTES))
}

async fn end(mut grpc: GrpcClient<Connection>, session: PolicySession<'_>) {
    let request =
        EndRequest { policy: session.policy.to_owned(), session: session.session.to_owned() };
    let deadline = END_DEADLINE.min(session.deadline);
    if let Err(status) = with_deadline(deadline, grpc.end(request)).await {
        tracing::debug!("end of session {:?}: {status}", session.session);
    }
}

pub fn infer_request(
    session: PolicySession<'_>,
    query_index: u32,
    observation: Observation,
) -> InferRequest {
    InferRequest {
        policy: session.policy.to_owned(),
        session: session.session.to_owned(),
        query_index,
        observation: Some(observation),
        under_way: None,
    }
}

fn with_settings(endpoint: Endpoint) -> Endpoint {
    endpoint
        .connect_timeout(CONNECT_DEADLINE)
        .tcp_nodelay(true)
        .initial_stream_window_size(WINDOW_BYTES)
        .initial_connection_window_size(WINDOW_BYTES)
}

fn read_description(about: DescribeResponse) -> Result<Description, DescriptionFault> {
    proto::checks::description(&about)?;
    let fields = about.state.iter();
    Ok(Description {
        state: fields.filter_map(|&field| StateField::try_from(field).ok()).collect(),
        horizon: about.horizon as usize,
        execute: about.execute as usize,
        about,
    })
}

#[cfg(test)]
mod tests {
    use proto::policy::CameraRequest;

    use super::*;

    fn description() -> DescribeResponse {
        DescribeResponse {
            protocol_version: PROTOCOL_VERSION,
            name: "pi05".to_owned(),
            horizon: 10,
            execute: 5,
            cameras: vec![CameraRequest { name: "agentview".to_owned(), width: 256, height: 256 }],
            state: vec![StateField::EefPos as i32, StateField::GripperPos as i32],
            ..DescribeResponse::default()
        }
    }

    #[test]
    fn a_valid_description_is_parsed() {
        let read = read_description(description()).expect("a valid description");
        assert_eq!((read.horizon, read.execute), (10, 5));
        assert_eq!(read.state, [StateField::EefPos, StateField::GripperPos]);
    }
}
