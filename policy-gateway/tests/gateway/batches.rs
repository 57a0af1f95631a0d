//! Queries that are sent to a server as a batch. The server is simulated: its batches take a fixed
//! time each, one after the other.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use policy_gateway::config::{Batching, RouteSpec};
use proto::policy::policy_server::Policy;
use proto::policy::{
    DescribeRequest, DescribeResponse, InferBatchRequest, InferBatchResponse, InferRequest,
    InferResponse, InferResult, ResetRequest, ResetResponse, infer_result,
};
use tokio::sync::Mutex;
use tokio::task::JoinSet;
use tonic::{Code, Request, Response, Status};

use crate::assertions::assert_refused;
use crate::support::{behind, chunk, describe, description, infer, reloadable, reset, serve};

const LARGEST: u32 = 4;
const BATCH_TIME: Duration = Duration::from_millis(5);

/// A simulated server of fixed speed. It answers with a hundredth of the number in a session's
/// name, with an error to session 3, and with a long error to session 99.
struct FixedSpeed {
    computing: Mutex<()>,
    /// Size of the largest batch so far.
    largest: Arc<AtomicUsize>,
}

fn answer(request: &InferRequest) -> Result<InferResponse, String> {
    let number: u32 = request.session.parse().map_err(|_| "no number")?;
    match number {
        3 => Err("KeyError: 3".to_owned()),
        99 => Err(format!("KeyError: 99\n{}", "x".repeat(1 << 20))),
        _ => Ok(chunk(&[number as f32 / 100.0; 7], 7)),
    }
}

#[tonic::async_trait]
impl Policy for FixedSpeed {
    async fn describe(
        &self,
        _: Request<DescribeRequest>,
    ) -> Result<Response<DescribeResponse>, Status> {
        Ok(Response::new(DescribeResponse { max_batch: LARGEST, ..description("simulated", 1) }))
    }

    async fn reset(&self, _: Request<ResetRequest>) -> Result<Response<ResetResponse>, Status> {
        Ok(Response::new(ResetResponse {}))
    }

    async fn infer(
        &self,
        request: Request<InferRequest>,
    ) -> Result<Response<InferResponse>, Status> {
        self.largest.fetch_max(1, Ordering::SeqCst);
        answer(request.get_ref()).map(Response::new).map_err(Status::internal)
    }

    async fn infer_batch(
        &self,
        request: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        let queries = request.into_inner().queries;
        self.largest.fetch_max(queries.len(), Ordering::SeqCst);
        let _one_at_a_time = self.computing.lock().await;
        tokio::time::sleep(BATCH_TIME).await;
        let result = |query: &InferRequest| InferResult {
            result: Some(match answer(query) {
                Ok(response) => infer_result::Result::Response(response),
                Err(error) => infer_result::Result::Error(error),
            }),
        };
        let results = queries.iter().map(result).collect();
        Ok(Response::new(InferBatchResponse { results }))
    }
}

/// Plays 12 concurrent sessions of 3 queries; returns the largest batch, and the batch mode that
/// results record.
async fn play(batching: Batching) -> (usize, String) {
    let largest = Arc::new(AtomicUsize::new(0));
    let server =
        serve(FixedSpeed { computing: Mutex::default(), largest: Arc::clone(&largest) }).await;
    let route = format!("x=grpc://{}", server.address);
    let spec = RouteSpec { batching, ..route.parse().expect("a route") };
    let (gateway, _) = reloadable(vec![spec]).await;
    let described = gateway.client().await.describe(describe("x")).await;
    let batch_mode = described.expect("a description").into_inner().batch_mode;
    let mut playing = JoinSet::new();
    for number in 0..12_u32 {
        let mut client = gateway.client().await;
        playing.spawn(async move {
            let session = number.to_string();
            client.reset(reset("x", &session)).await.expect("an episode");
            for query_index in 0..3 {
                let answer = client.infer(infer("x", &session, query_index)).await;
                if number == 3 {
                    assert_refused(answer, Code::Internal, &["KeyError: 3"]);
                } else {
                    let answer = answer.expect("an answer").into_inner();
                    assert_eq!(answer.actions, [number as f32 / 100.0; 7]);
                }
            }
        });
    }
    while let Some(played) = playing.join_next().await {
        played.expect("no session panicked");
    }
    (largest.load(Ordering::SeqCst), batch_mode)
}

#[tokio::test]
async fn queries_are_batched_and_each_gets_its_own_answer() {
    let (largest, batch_mode) = play(Batching::Dynamic).await;
    assert_eq!(batch_mode, format!("up to {LARGEST}"));
    assert!((2..=LARGEST as usize).contains(&largest), "{largest}");
}

#[tokio::test]
async fn with_batching_off_queries_are_sent_one_by_one() {
    let (single, deterministic) = ("single".to_owned(), "deterministic".to_owned());
    assert_eq!(play(Batching::Single).await, (1, single));
    assert_eq!(play(Batching::Deterministic).await, (1, deterministic));
}

/// An error text that does not fit the response's HTTP/2 header would count as an outage.
#[tokio::test]
async fn an_error_of_a_mebibyte_is_truncated_and_no_outage() {
    let (_server, _gateway, mut client) =
        behind(FixedSpeed { computing: Mutex::default(), largest: Arc::default() }).await;
    client.reset(reset("x", "99")).await.expect("an episode");
    let status = client.infer(infer("x", "99", 0)).await;
    let status = status.expect_err("an error");
    assert_eq!(status.code(), Code::Internal);
    let text = status.message();
    assert!(text.contains("KeyError: 99 | xxx"), "{text}");
    assert!(text.len() < 8 << 10, "{} bytes", text.len());
}
