//! Servers that are faulty on purpose: each fault is recognised, and faults of the server reach a
//! worker as an outage, which is never charged.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use policy_gateway::config::RouteSpec;
use policy_gateway::health::BROKEN_WAITS;
use proto::policy::policy_client::PolicyClient;
use proto::policy::policy_server::Policy;
use proto::policy::{
    DescribeRequest, DescribeResponse, InferBatchRequest, InferBatchResponse, InferRequest,
    InferResponse, ResetRequest, ResetResponse,
};
use tonic::transport::Channel;
use tonic::{Code, Request, Response, Status};

use crate::assertions::assert_refused;
use crate::support::{Scripted, behind, chunk, description, infer, reloadable, reset, serve};

/// Sends one query in a new session whose task is `task`.
async fn one_query(client: &mut PolicyClient<Channel>, task: &str) -> Result<(), Status> {
    let request = ResetRequest { instruction: task.to_owned(), ..reset("x", task) };
    client.reset(request).await?;
    client.infer(infer("x", task, 0)).await.map(drop)
}

#[tokio::test]
async fn a_broken_server_is_out_from_its_first_error_until_a_query_is_answered() {
    let broken = Arc::new(AtomicBool::new(true));
    let queries = Arc::new(AtomicU32::new(0));
    let (is_broken, count) = (Arc::clone(&broken), Arc::clone(&queries));
    let answer = move |_| {
        count.fetch_add(1, Ordering::SeqCst);
        match is_broken.load(Ordering::SeqCst) {
            true => Err(Status::unknown("CUDA error: device-side assert triggered")),
            false => Ok(chunk(&[0.5; 7], 7)),
        }
    };
    let (_server, _gateway, mut client) = behind(Scripted::new(description("p", 1), answer)).await;

    let first = one_query(&mut client, "butter").await.expect_err("broken");
    assert_eq!(first.code(), Code::Unavailable);
    for part in ["device-side assert", "restart it"] {
        assert!(first.message().contains(part), "{part} in {first}");
    }
    for task in ["milk", "bowl", "plate"] {
        let refused = one_query(&mut client, task).await.expect_err("still out");
        assert_eq!(refused.code(), Code::Unavailable);
        assert!(refused.message().contains("tried again in"), "{refused}");
    }
    assert_eq!(queries.load(Ordering::SeqCst), 1, "refused queries do not reach the server");

    broken.store(false, Ordering::SeqCst);
    let deadline = Instant::now() + BROKEN_WAITS.longest;
    while let Err(status) = one_query(&mut client, "again").await {
        assert_eq!(status.code(), Code::Unavailable, "{status}");
        assert!(Instant::now() < deadline, "{status}");
        tokio::time::sleep(BROKEN_WAITS.first / 10).await;
    }
    one_query(&mut client, "milk").await.expect("an answer after the outage");
}

#[tokio::test]
async fn the_same_error_to_three_tasks_is_an_outage_and_to_one_task_is_an_error() {
    let answer = |_| Err::<InferResponse, _>(Status::internal("ValueError: shape (3, 4)"));
    let (_server, _gateway, mut client) = behind(Scripted::new(description("p", 1), answer)).await;
    let mut codes = vec![];
    for task in ["butter", "butter", "butter", "butter", "milk", "bowl"] {
        let status = one_query(&mut client, task).await.expect_err("an error");
        assert!(status.message().contains("ValueError"), "{status}");
        codes.push(status.code());
    }
    assert_eq!(codes[..5], [Code::Internal; 5]);
    assert_eq!(codes[5], Code::Unavailable);
}

#[tokio::test]
async fn invalid_answers_to_three_tasks_are_an_outage_of_the_policy() {
    for invalid_answer in
        [chunk(&[f32::NAN; 7], 7), chunk(&[1e9; 7], 7), chunk(&[0.0; 18], 6), chunk(&[], 7)]
    {
        let answer = move |_| Ok(invalid_answer.clone());
        let (_server, _gateway, mut client) =
            behind(Scripted::new(description("p", 1), answer)).await;
        let mut codes = vec![];
        for task in ["butter", "milk", "bowl"] {
            let status = one_query(&mut client, task).await.expect_err("an invalid answer");
            codes.push(status.code());
        }
        assert_eq!(codes, [Code::Internal, Code::Internal, Code::Unavailable]);
    }
}

/// A server that opens sessions, and answers queries after this delay, or never.
struct DelayedPolicy(Option<Duration>);

#[tonic::async_trait]
impl Policy for DelayedPolicy {
    async fn describe(
        &self,
        _: Request<DescribeRequest>,
    ) -> Result<Response<DescribeResponse>, Status> {
        Ok(Response::new(description("late", 1)))
    }

    async fn reset(&self, _: Request<ResetRequest>) -> Result<Response<ResetResponse>, Status> {
        Ok(Response::new(ResetResponse {}))
    }

    async fn infer(&self, _: Request<InferRequest>) -> Result<Response<InferResponse>, Status> {
        match self.0 {
            Some(after) => tokio::time::sleep(after).await,
            None => std::future::pending().await,
        }
        Ok(Response::new(chunk(&[0.5; 7], 7)))
    }

    async fn infer_batch(
        &self,
        _: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        std::future::pending().await
    }
}

#[tokio::test]
async fn a_server_that_answers_after_the_limit_or_never_is_out_and_later_queries_fail_at_once() {
    expect_outage_after_the_limit(DelayedPolicy(None)).await;
    expect_outage_after_the_limit(DelayedPolicy(Some(Duration::from_millis(600)))).await;
}

async fn expect_outage_after_the_limit(server: DelayedPolicy) {
    let server = serve(server).await;
    let route = format!("x=grpc://{}", server.address);
    let spec =
        RouteSpec { answer_within: Duration::from_millis(300), ..route.parse().expect("a route") };
    let (gateway, _) = reloadable(vec![spec]).await;
    let mut client = gateway.client().await;
    assert_refused(
        one_query(&mut client, "butter").await,
        Code::DeadlineExceeded,
        &["within 0.3 s"],
    );
    assert_refused(
        one_query(&mut client, "milk").await,
        Code::Unavailable,
        &["did not answer in time"],
    );
}
