//! A policy server without a policy: it takes a fixed time per batch, like an accelerator, and
//! answers zeros; or it never answers.

use std::{
    net::SocketAddr,
    sync::Mutex,
    time::{Duration, Instant},
};

use anyhow::Result;
use clap::Args;
use policy_backends::http2::{CONNECTION_WINDOW_BYTES, MAX_FRAME_BYTES, STREAM_WINDOW_BYTES};
use proto::policy::{
    CameraRequest, DescribeRequest, DescribeResponse, InferBatchRequest, InferBatchResponse,
    InferRequest, InferResponse, InferResult, ResetRequest, ResetResponse, StateField,
    infer_result,
    policy_server::{Policy, PolicyServer},
};
use tokio::net::TcpListener;
use tonic::{
    Request, Response, Status,
    transport::{Server, server::TcpIncoming},
};

/// The cameras of LIBERO-CTRL, at its resolution.
const CAMERAS: [&str; 2] = ["agentview", "robot0_eye_in_hand"];
/// Side of a frame, pixels.
const SIDE: u32 = 256;

#[derive(Args)]
pub(crate) struct Options {
    /// Milliseconds for one batch, whatever its size; 0 answers at once
    #[arg(long, default_value_t = 0)]
    pub(crate) batch_millis: u64,
    /// Largest batch
    #[arg(long, default_value_t = 1)]
    pub(crate) max_batch: u32,
    /// Take queries and never answer one
    #[arg(long)]
    pub(crate) stalled: bool,
}

/// Bytes of the frames of one observation.
pub(crate) fn observation_bytes() -> u32 {
    CAMERAS.len() as u32 * SIDE * SIDE * 3
}

/// Serves on a free port until it is killed; the printed line has the address.
pub(crate) async fn serve(options: Options) -> Result<()> {
    let listener = TcpListener::bind(SocketAddr::from(([127, 0, 0, 1], 0))).await?;
    println!("listening on {}", listener.local_addr()?);
    let policies = PolicyServer::new(Simulated { options, busy_until: Mutex::new(Instant::now()) })
        .max_decoding_message_size(proto::MAX_MESSAGE_BYTES);
    Server::builder()
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .max_frame_size(MAX_FRAME_BYTES)
        .add_service(policies)
        .serve_with_incoming(TcpIncoming::from(listener).with_nodelay(Some(true)))
        .await?;
    Ok(())
}

struct Simulated {
    options: Options,
    /// End of the last accepted batch.
    busy_until: Mutex<Instant>,
}

impl Simulated {
    /// Waits until a batch has been computed. A batch that arrives during another batch starts at
    /// the end of the earlier batch, even if the timer fires late, since a real server does not
    /// compute batches on the thread that receives them.
    async fn compute(&self) {
        if self.options.stalled {
            std::future::pending::<()>().await;
        }
        let done = {
            let mut busy_until =
                self.busy_until.lock().expect("no code panics while it holds the lock");
            let began = Instant::now().max(*busy_until);
            *busy_until = began + Duration::from_millis(self.options.batch_millis);
            *busy_until
        };
        if self.options.batch_millis > 0 {
            tokio::time::sleep_until(done.into()).await;
        }
    }
}

fn answer() -> InferResponse {
    InferResponse { actions: vec![0.0; 7], action_width: 7 }
}

#[tonic::async_trait]
impl Policy for Simulated {
    async fn describe(
        &self,
        _: Request<DescribeRequest>,
    ) -> Result<Response<DescribeResponse>, Status> {
        let cameras =
            CAMERAS.map(|name| CameraRequest { name: name.to_owned(), width: SIDE, height: SIDE });
        let state = [StateField::EefPos, StateField::EefAxisAngle, StateField::GripperPos];
        Ok(Response::new(DescribeResponse {
            protocol_version: proto::PROTOCOL_VERSION,
            name: "simulated".to_owned(),
            cameras: cameras.into(),
            state: state.map(i32::from).into(),
            horizon: 1,
            execute: 1,
            max_batch: self.options.max_batch,
            ..DescribeResponse::default()
        }))
    }

    async fn reset(&self, _: Request<ResetRequest>) -> Result<Response<ResetResponse>, Status> {
        Ok(Response::new(ResetResponse {}))
    }

    async fn infer(&self, _: Request<InferRequest>) -> Result<Response<InferResponse>, Status> {
        self.compute().await;
        Ok(Response::new(answer()))
    }

    async fn infer_batch(
        &self,
        request: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        let queries = request.into_inner().queries.len();
        self.compute().await;
        let result = InferResult { result: Some(infer_result::Result::Response(answer())) };
        Ok(Response::new(InferBatchResponse { results: vec![result; queries] }))
    }
}
