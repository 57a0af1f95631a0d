//! A policy server whose misbehaviour is selected by the policy's name, with the real protocol over
//! a real socket.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use proto::policy::policy_server::{Policy, PolicyServer};
use proto::policy::{
    CameraRequest, DescribeRequest, DescribeResponse, EndRequest, EndResponse, InferBatchRequest,
    InferBatchResponse, InferRequest, InferResponse, Language, ResetRequest, ResetResponse,
    StateField,
};
use tokio::net::TcpListener;
use tokio::task::JoinSet;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::transport::Server;
use tonic::{Request, Response, Status};

/// Side of the frames that the policy `observing` requests, pixels.
pub(crate) const FRAME_SIDE: u32 = 64;
/// Number of actions per answer; all of them are executed.
pub(crate) const HORIZON: u32 = 8;

/// Requests that the policies received.
#[derive(Debug, Default)]
pub(crate) struct ReceivedRequests {
    pub resets: Vec<ResetRequest>,
    pub queries: Vec<InferRequest>,
    pub ended: Vec<String>,
}

pub(crate) struct ScriptedPolicy {
    address: SocketAddr,
    pub(crate) received: Arc<Mutex<ReceivedRequests>>,
    /// The server's task, which ends when the set is dropped.
    _serving: JoinSet<()>,
}

impl ScriptedPolicy {
    pub(crate) async fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let received: Arc<Mutex<ReceivedRequests>> = Arc::default();
        let service = Service { received: Arc::clone(&received) };
        let mut serving = JoinSet::new();
        serving.spawn(async move {
            let served = Server::builder()
                .add_service(PolicyServer::new(service))
                .serve_with_incoming(TcpListenerStream::new(listener));
            served.await.expect("serves");
        });
        Self { address, received, _serving: serving }
    }

    pub(crate) fn url(&self) -> String {
        format!("grpc://{}", self.address)
    }
}

struct Service {
    received: Arc<Mutex<ReceivedRequests>>,
}

fn answer(numbers: usize, action_width: u32) -> InferResponse {
    InferResponse { actions: vec![0.0; numbers], action_width }
}

#[tonic::async_trait]
impl Policy for Service {
    async fn describe(
        &self,
        request: Request<DescribeRequest>,
    ) -> Result<Response<DescribeResponse>, Status> {
        let name = request.into_inner().policy;
        let camera = |camera: &str| CameraRequest {
            name: camera.to_owned(),
            width: FRAME_SIDE,
            height: FRAME_SIDE,
        };
        let mut about = DescribeResponse {
            protocol_version: proto::PROTOCOL_VERSION,
            name: name.clone(),
            checkpoint: "scripted".to_owned(),
            checkpoint_digest: "5c".repeat(32),
            horizon: HORIZON,
            execute: HORIZON,
            language: Language::FreeForm as i32,
            ..DescribeResponse::default()
        };
        match name.as_str() {
            "unknown" => return Err(Status::not_found("no such policy here")),
            "of-another-version" => about.protocol_version += 1,
            "hungry" => about.execute = HORIZON + 1,
            "foreign" => about.cameras = vec![camera("front")],
            "by-heart" => about.language = Language::CanonicalOnly as i32,
            "observing" => {
                about.cameras = ["agentview", "robot0_eye_in_hand"].map(camera).to_vec();
                about.state =
                    [StateField::EefPos, StateField::EefAxisAngle, StateField::GripperPos]
                        .map(|field| field as i32)
                        .to_vec();
            }
            _ => {}
        }
        Ok(Response::new(about))
    }

    async fn reset(
        &self,
        request: Request<ResetRequest>,
    ) -> Result<Response<ResetResponse>, Status> {
        let request = request.into_inner();
        let policy = request.policy.clone();
        self.received.lock().expect("unpoisoned").resets.push(request);
        match policy.as_str() {
            "refusing" => Err(Status::invalid_argument("this instruction is not one of 40")),
            "dying-at-reset" => Err(Status::unavailable("the server has died")),
            _ => Ok(Response::new(ResetResponse {})),
        }
    }

    async fn infer(
        &self,
        request: Request<InferRequest>,
    ) -> Result<Response<InferResponse>, Status> {
        let request = request.into_inner();
        let (policy, query) = (request.policy.clone(), request.query_index);
        self.received.lock().expect("unpoisoned").queries.push(request);
        let full = HORIZON as usize * 7;
        let mut actions = answer(full, 7);
        match policy.as_str() {
            "nan" if query == 1 => actions.actions[9] = f32::NAN,
            "narrow" => actions = answer(6, 6),
            "ragged" => actions = answer(13, 7),
            "empty" => actions = answer(0, 7),
            "generous" => actions = answer(full + 7, 7),
            "broken" => return Err(Status::internal("CUDA error: device-side assert triggered")),
            "dying-at-query" if query == 2 => {
                return Err(Status::unavailable("the server has died"));
            }
            "overloaded" => return Err(Status::resource_exhausted("the queue is full")),
            "silent" => std::future::pending().await,
            "slow" => tokio::time::sleep(Duration::from_millis(200)).await,
            _ => {}
        }
        Ok(Response::new(actions))
    }

    async fn end(&self, request: Request<EndRequest>) -> Result<Response<EndResponse>, Status> {
        self.received.lock().expect("unpoisoned").ended.push(request.into_inner().session);
        Ok(Response::new(EndResponse {}))
    }

    async fn infer_batch(
        &self,
        _request: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        Err(Status::unimplemented("one at a time"))
    }
}
