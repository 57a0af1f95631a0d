//! A policy's answers: they are kept for retries, and refused if they are not actions. The servers
//! here are faulty on purpose.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use proto::policy::InferResponse;
use tonic::{Code, Status};

use crate::assertions::assert_refused;
use crate::support::{
    Scripted, behind, chunk, describe, description, gateway, infer, reset, serve,
};

/// Returns a gateway's refusal of a query to a server that answers `answer`.
async fn refusal(answer: Result<InferResponse, Status>) -> Status {
    let described = description("crooked", 2);
    let server = serve(Scripted::new(described, move |_| answer.clone())).await;
    let gateway = gateway(&[&format!("bent=grpc://{}", server.address)]).await;
    let mut client = gateway.client().await;
    client.reset(reset("bent", "episode-1")).await.expect("an episode");
    let status = client.infer(infer("bent", "episode-1", 3)).await.expect_err("a refusal");
    let named = status.message().matches("route bent").count();
    assert_eq!(named, 1, "{status}");
    status
}

#[tokio::test]
async fn invalid_actions_are_refused_with_route_query_and_remedy() {
    let mut nan = [0.0; 7];
    nan[4] = f32::NAN;
    let cases = [
        (chunk(&nan, 7), "component 4 of action 0 is NaN"),
        (chunk(&[0.0; 18], 6), "6 numbers wide"),
        (chunk(&[], 7), "no action"),
        (chunk(&[0.0; 21], 7), "3 actions"),
    ];
    for (answer, expected) in cases {
        let status = refusal(Ok(answer)).await;
        assert_eq!(status.code(), Code::Internal);
        for part in [expected, "query 3", "`policy-gateway check grpc://"] {
            assert!(status.message().contains(part), "{part} in {status}");
        }
    }
}

#[tokio::test]
async fn an_error_of_the_policy_keeps_its_text_and_is_no_outage() {
    let status = refusal(Err(Status::internal("ValueError: bad shape"))).await;
    assert_eq!(status.code(), Code::Internal);
    assert!(status.message().contains("ValueError: bad shape"), "{status}");

    let uncaught = refusal(Err(Status::unknown("KeyError: 'pick up the bowl'"))).await;
    assert_eq!(uncaught.code(), Code::Internal);
}

#[tokio::test]
async fn a_retry_gets_the_same_actions_without_another_query() {
    let queries = Arc::new(AtomicU32::new(0));
    let count = Arc::clone(&queries);
    let answer = move |_| Ok(chunk(&[count.fetch_add(1, Ordering::SeqCst) as f32; 7], 7));
    let (_server, gateway, mut client) =
        behind(Scripted::new(description("counter", 1), answer)).await;
    let mut send_query = async |session: &str, query_index| {
        let answer = client.infer(infer("x", session, query_index)).await.expect("an answer");
        answer.into_inner().actions[0]
    };
    assert_eq!(
        [send_query("s", 0).await, send_query("s", 0).await, send_query("s", 1).await],
        [0.0, 0.0, 1.0]
    );
    assert_eq!(
        [send_query("t", 1).await, send_query("s", 1).await, send_query("t", 1).await],
        [2.0, 1.0, 2.0]
    );
    assert_eq!(queries.load(Ordering::SeqCst), 3);

    // A restarted session has no answers yet.
    gateway.client().await.reset(reset("x", "s")).await.expect("an episode");
    assert_eq!(send_query("s", 1).await, 3.0);
}

#[tokio::test]
async fn invalid_answers_are_not_cached_for_retries() {
    let queries = AtomicU32::new(0);
    let answer = move |_| match queries.fetch_add(1, Ordering::SeqCst) {
        0 => Ok(chunk(&[f32::INFINITY; 7], 7)),
        _ => Ok(chunk(&[0.5; 7], 7)),
    };
    let (_server, _gateway, mut client) =
        behind(Scripted::new(description("flaky", 1), answer)).await;
    client.infer(infer("x", "s", 0)).await.expect_err("infinite actions");
    let answer = client.infer(infer("x", "s", 0)).await.expect("good actions");
    assert_eq!(answer.get_ref().actions, [0.5; 7]);
}

#[tokio::test]
async fn concurrent_retries_query_the_policy_once() {
    let queries = Arc::new(AtomicU32::new(0));
    let count = Arc::clone(&queries);
    let answer = move |_| {
        std::thread::sleep(std::time::Duration::from_millis(50));
        Ok(chunk(&[count.fetch_add(1, Ordering::SeqCst) as f32; 7], 7))
    };
    let server = serve(Scripted::new(description("slow", 1), answer)).await;
    let gateway = gateway(&[&format!("x=grpc://{}", server.address)]).await;
    let (mut first, mut second) = (gateway.client().await, gateway.client().await);
    let (first, second) =
        tokio::join!(first.infer(infer("x", "s", 0)), second.infer(infer("x", "s", 0)));
    assert_eq!(first.expect("an answer").get_ref(), second.expect("an answer").get_ref());
    assert_eq!(queries.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn a_stateful_builtin_answers_queries_in_order_only() {
    let gateway = gateway(&["expert=builtin:expert"]).await;
    let mut client = gateway.client().await;
    client.reset(reset("", "s")).await.expect("an episode");
    assert_refused(
        client.infer(infer("", "s", 1)).await,
        Code::FailedPrecondition,
        &["query 0 is next"],
    );
}

#[tokio::test]
async fn a_builtin_names_the_missing_input() {
    let gateway = gateway(&["expert=builtin:expert"]).await;
    let mut client = gateway.client().await;
    client.reset(reset("", "s")).await.expect("an episode");
    assert_refused(
        client.infer(infer("", "s", 0)).await,
        Code::Internal,
        &["route expert", "privileged"],
    );
}

#[tokio::test]
async fn an_invalid_description_is_refused_with_its_fault() {
    let mut newer = description("p", 1);
    newer.protocol_version = proto::PROTOCOL_VERSION + 1;
    let cases = [
        (description("", 1), Code::Internal, "no name".to_owned()),
        (description("p", 0), Code::Internal, "horizon is 0".to_owned()),
        (newer, Code::FailedPrecondition, format!("version {}", proto::PROTOCOL_VERSION + 1)),
    ];
    for (described, code, expected) in cases {
        let server = serve(Scripted::new(described, |_| Ok(chunk(&[0.0; 7], 7)))).await;
        let gateway = gateway(&[&format!("x=grpc://{}", server.address)]).await;
        assert_refused(
            gateway.client().await.describe(describe("x")).await,
            code,
            &[expected.as_str(), "route x", &server.address.to_string()],
        );
    }
}
