//! A worker's side of the policy protocol: describes, resets and asks a policy,
//! and checks what it answers before an action reaches a robot. Blocking: a
//! slot has nothing else to do while its policy thinks. Retrying is the
//! coordinator's business, which pauses the jobs of a policy that is down.

use std::time::Duration;

use proto::policy::policy_client::PolicyClient as GrpcClient;
use proto::policy::{
    CameraRequest, DescribeRequest, DescribeResponse, EndRequest, InferRequest, InferResponse,
    Observation, ResetRequest, StateField,
};
use proto::{MAX_MESSAGE_BYTES, PROTOCOL_VERSION};
use tokio::runtime::Runtime;
use tonic::transport::Endpoint;
use tonic::{Response, Status};
use transport::{
    Access, Connection, Peer, ServerKind, Settings, answer, is_outage, parse_endpoint,
};

use crate::actor::{ACTION_WIDTH, Action, Actor, CAMERAS, Description, PolicyError, PolicySession};
use crate::grpc::within;

/// Longest wait for one answer of a policy. A policy that needs longer once, to
/// compile itself, does so before it serves.
pub const POLICY_CALL_DEADLINE: Duration = Duration::from_secs(60);
/// Longest wait for word that the end of an episode was noted.
const END_DEADLINE: Duration = Duration::from_secs(2);
/// Longest wait for a connection.
const CONNECT_DEADLINE: Duration = Duration::from_secs(10);
/// HTTP/2 window, bytes: holds an observation, so that no call waits for
/// window updates half-way.
const WINDOW_BYTES: u32 = 4 << 20;
/// The largest frame that a policy may ask for, pixels along a side.
const MAX_FRAME_SIDE: u32 = 1024;

/// A connection to one endpoint.
#[derive(Debug)]
pub struct PolicyClient {
    endpoint: String,
    // One thread in the background, so that the connection is looked after
    // while the simulator has this one.
    runtime: Runtime,
    grpc: GrpcClient<Connection>,
    peer: Peer,
}

/// Where the user of a campaign's policy says which one is meant.
pub const OF_A_CAMPAIGN: Settings = Settings {
    address: "the campaign's endpoint",
    authority: "the worker's --ca",
    clear: "http://",
    encrypted: "https://",
};
/// Where the user of a policy for one rollout does.
pub const OF_ONE_ROLLOUT: Settings = Settings {
    address: "--endpoint",
    authority: "--ca",
    ..OF_A_CAMPAIGN
};

impl PolicyClient {
    /// A client of the endpoint, `grpc://HOST:PORT` or `http://HOST:PORT`, with
    /// TLS `grpcs://` or `https://`, which was set in `settings`. The connection is
    /// made at the first call.
    ///
    /// # Errors
    /// If the endpoint is no such URL.
    pub fn new(endpoint: &str, access: &Access, settings: Settings) -> Result<Self, PolicyError> {
        let address = with_settings(parse_endpoint(endpoint)?);
        let peer = Peer::new(address.clone(), access, ServerKind::Policy, settings);
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .map_err(PolicyError::Runtime)?;
        let connection = {
            let _inside = runtime.enter();
            access.connect_lazy(address)
        };
        let grpc = GrpcClient::new(connection?)
            .max_decoding_message_size(MAX_MESSAGE_BYTES)
            .max_encoding_message_size(MAX_MESSAGE_BYTES);
        Ok(Self {
            endpoint: endpoint.to_owned(),
            runtime,
            grpc,
            peer,
        })
    }

    /// The endpoint, as given.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    fn call<T, F>(&self, deadline: Duration, call: F) -> Result<T, Status>
    where
        F: Future<Output = Result<Response<T>, Status>>,
    {
        self.runtime.block_on(within(deadline, call))
    }

    fn unavailable(
        &self,
        call: &'static str,
        session: PolicySession<'_>,
        status: &Status,
    ) -> PolicyError {
        PolicyError::Unavailable {
            call,
            policy: session.policy.to_owned(),
            endpoint: self.endpoint.clone(),
            problem: self.explain(status),
        }
    }

    fn refused(
        &self,
        call: &'static str,
        session: PolicySession<'_>,
        query: String,
        status: &Status,
    ) -> PolicyError {
        if is_outage(status) {
            return self.unavailable(call, session, status);
        }
        misbehaved(session, query, self.explain(status))
    }

    /// What the policy answered, or what is there in its place.
    fn explain(&self, status: &Status) -> String {
        let trouble = self.runtime.block_on(self.peer.trouble(status));
        trouble.map_or_else(|| answer(status), |trouble| trouble.to_string())
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
        let about = self
            .call(session.deadline, grpc.describe(request))
            .map_err(|status| self.unavailable("describe", session, &status))?;
        check_description(about).map_err(|problem| PolicyError::Description {
            policy: session.policy.to_owned(),
            endpoint: self.endpoint.clone(),
            problem,
        })
    }

    fn reset(
        &mut self,
        session: PolicySession<'_>,
        suite: &str,
        instruction: &str,
        seed: u64,
    ) -> Result<(), PolicyError> {
        let request = ResetRequest {
            policy: session.policy.to_owned(),
            session: session.session.to_owned(),
            suite: suite.to_owned(),
            instruction: instruction.to_owned(),
            seed,
        };
        let mut grpc = self.grpc.clone();
        self.call(session.deadline, grpc.reset(request))
            .map(|_| ())
            .map_err(|status| self.refused("reset", session, "reset".to_owned(), &status))
    }

    fn end(&mut self, session: PolicySession<'_>) {
        let request = EndRequest {
            policy: session.policy.to_owned(),
            session: session.session.to_owned(),
        };
        let mut grpc = self.grpc.clone();
        if let Err(status) = self.call(END_DEADLINE.min(session.deadline), grpc.end(request)) {
            tracing::debug!("end of session {:?}: {status}", session.session);
        }
    }

    fn infer(
        &mut self,
        session: PolicySession<'_>,
        query_index: u32,
        observation: Observation,
        horizon: usize,
    ) -> Result<Vec<Action>, PolicyError> {
        let request = infer_request(session, query_index, observation);
        let mut grpc = self.grpc.clone();
        let response = self
            .call(session.deadline, grpc.infer(request))
            .map_err(|status| self.refused("ask", session, query_index.to_string(), &status))?;
        check_actions(&response, horizon)
            .map_err(|violation| misbehaved(session, query_index.to_string(), violation))
    }
}

/// What a policy is asked with.
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
    }
}

fn misbehaved(session: PolicySession<'_>, query: String, violation: String) -> PolicyError {
    PolicyError::Misbehaved {
        policy: session.policy.to_owned(),
        session: session.session.to_owned(),
        query,
        violation,
    }
}

fn with_settings(endpoint: Endpoint) -> Endpoint {
    endpoint
        .connect_timeout(CONNECT_DEADLINE)
        .tcp_nodelay(true)
        .initial_stream_window_size(WINDOW_BYTES)
        .initial_connection_window_size(WINDOW_BYTES)
}

/// Checks a description. The error reads after "its description …".
fn check_description(about: DescribeResponse) -> Result<Description, String> {
    if about.protocol_version != PROTOCOL_VERSION {
        return Err(format!(
            "is of protocol version {}, but this worker speaks {PROTOCOL_VERSION}: bring both to \
             the same release",
            about.protocol_version
        ));
    }
    let (horizon, execute) = (about.horizon as usize, about.execute as usize);
    if horizon == 0 || execute == 0 || execute > horizon {
        return Err(format!(
            "has horizon {horizon} and execute {execute}: 1 <= execute <= horizon must hold"
        ));
    }
    let problem = about.cameras.iter().find_map(camera_problem);
    if let Some(problem) = problem.or_else(|| about.settings_problem()) {
        return Err(problem);
    }
    let state = about
        .state
        .iter()
        .map(|&field| match StateField::try_from(field) {
            Ok(StateField::Unspecified) | Err(_) => Err(format!(
                "wants state field {field}, which is none of 1 to 8"
            )),
            Ok(known) => Ok(known),
        })
        .collect::<Result<_, _>>()?;
    Ok(Description {
        about,
        state,
        horizon,
        execute,
    })
}

fn camera_problem(camera: &CameraRequest) -> Option<String> {
    let CameraRequest {
        name,
        width,
        height,
    } = camera;
    if !CAMERAS.contains(&name.as_str()) {
        return Some(format!(
            "wants camera `{name}`: there are {}",
            CAMERAS.join(" and ")
        ));
    }
    let sides = 1..=MAX_FRAME_SIDE;
    let fits = sides.contains(width) && sides.contains(height);
    (!fits).then(|| format!("wants {width}×{height} pixels: sides are 1 to {MAX_FRAME_SIDE}"))
}

/// Checks an answer's shape and numbers. The error says what is wrong.
fn check_actions(response: &InferResponse, horizon: usize) -> Result<Vec<Action>, String> {
    let numbers = response.actions.len();
    if response.action_width as usize != ACTION_WIDTH {
        return Err(format!(
            "actions have {} numbers each, but this robot takes {ACTION_WIDTH}",
            response.action_width
        ));
    }
    let (actions, rest) = response.actions.as_chunks::<ACTION_WIDTH>();
    if !rest.is_empty() {
        return Err(format!(
            "{numbers} numbers are no whole actions of {ACTION_WIDTH}"
        ));
    }
    if actions.is_empty() {
        return Err("it holds no action".to_owned());
    }
    if actions.len() > horizon {
        let given = actions.len();
        return Err(format!(
            "it holds {given} actions, but the policy declared {horizon} at most"
        ));
    }
    for (step, action) in actions.iter().enumerate() {
        if let Some(place) = action.iter().position(|number| !number.is_finite()) {
            return Err(format!(
                "number {place} of action {step} is {}",
                action[place]
            ));
        }
    }
    Ok(actions.iter().map(|action| action.map(f64::from)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(actions: Vec<f32>, action_width: u32) -> InferResponse {
        InferResponse {
            actions,
            action_width,
        }
    }

    #[test]
    fn answers_that_no_robot_can_execute_are_named() {
        let check = |actions: Vec<f32>, width: u32, expected: &str| {
            let error = check_actions(&answer(actions, width), 2).expect_err(expected);
            assert!(error.contains(expected), "{error}");
        };
        let mut nan = vec![0.0; 14];
        nan[9] = f32::NAN;
        check(nan, 7, "number 2 of action 1 is NaN");
        check(
            vec![f32::NEG_INFINITY; 7],
            7,
            "number 0 of action 0 is -inf",
        );
        check(vec![0.0; 6], 6, "6 numbers each");
        check(vec![0.0; 13], 7, "13 numbers are no whole actions");
        check(vec![], 7, "no action");
        check(vec![0.0; 21], 7, "3 actions, but the policy declared 2");
    }

    #[test]
    fn a_sound_answer_is_taken_number_by_number() {
        let numbers: Vec<f32> = (0..14_u8).map(|n| f32::from(n) / 16.0).collect();
        let actions = check_actions(&answer(numbers, 7), 8).expect("sound");
        assert_eq!(actions.len(), 2);
        assert_eq!(actions[1][0], 7.0 / 16.0);
    }

    fn description() -> DescribeResponse {
        DescribeResponse {
            protocol_version: PROTOCOL_VERSION,
            horizon: 10,
            execute: 5,
            cameras: vec![CameraRequest {
                name: "agentview".to_owned(),
                width: 256,
                height: 256,
            }],
            state: vec![StateField::EefPos as i32, StateField::GripperPos as i32],
            ..DescribeResponse::default()
        }
    }

    #[test]
    fn a_description_is_read() {
        let read = check_description(description()).expect("sound");
        assert_eq!((read.horizon, read.execute), (10, 5));
        assert_eq!(read.state, [StateField::EefPos, StateField::GripperPos]);
    }

    #[test]
    fn descriptions_that_fit_no_rollout_are_named() {
        let check = |change: fn(&mut DescribeResponse), expected: &str| {
            let mut about = description();
            change(&mut about);
            let error = check_description(about).expect_err(expected);
            assert!(error.contains(expected), "{error}");
        };
        check(
            |about| about.protocol_version = 7,
            "version 7, but this worker speaks 1",
        );
        check(|about| about.execute = 11, "horizon 10 and execute 11");
        check(|about| about.execute = 0, "execute 0");
        check(|about| about.state.push(9), "state field 9");
        check(
            |about| about.cameras[0].name = "frontview".to_owned(),
            "`frontview`",
        );
        check(|about| about.cameras[0].width = 0, "0×256");
    }
}
