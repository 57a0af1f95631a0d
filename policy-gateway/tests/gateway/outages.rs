//! Backends that are unavailable, become unavailable, and return.

use std::time::{Duration, Instant};

use policy_backends::builtin::noop::NOOP_ACTION;
use policy_gateway::health::WAITS;
use proto::policy::InferBatchRequest;
use proto::policy::policy_client::PolicyClient;
use tonic::transport::Channel;
use tonic::{Code, Status};

use crate::assertions::assert_refused;
use crate::support::{describe, gateway, gateway_at, infer, reset, unused_address};

/// Requests the description until the policy answers, for at most twice the longest back-off.
async fn describe_until_answered(client: &mut PolicyClient<Channel>) -> Result<(), Status> {
    let deadline = Instant::now() + 2 * WAITS.longest;
    loop {
        match client.describe(describe("")).await {
            Ok(_) => return Ok(()),
            Err(status) if Instant::now() > deadline => return Err(status),
            Err(status) => assert_eq!(status.code(), Code::Unavailable, "{status}"),
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test]
async fn a_policy_that_is_down_is_unavailable_and_named_until_it_comes_up() {
    let address = unused_address().await;
    let outer = gateway(&[&format!("pi05=grpc://{address}")]).await;
    let mut client = outer.client().await;

    let down = client.reset(reset("pi05", "s")).await.expect_err("nothing listens there");
    assert_eq!(down.code(), Code::Unavailable);
    for part in ["route pi05", &address.to_string(), "nothing listens there"] {
        assert!(down.message().contains(part), "{part} in {down}");
    }
    // The error is returned at once, without another attempt to connect.
    assert_refused(client.describe(describe("pi05")).await, Code::Unavailable, &["tried again in"]);

    let queries = vec![infer("pi05", "s", 0)];
    assert_refused(client.infer_batch(InferBatchRequest { queries }).await, Code::Unavailable, &[]);

    let _inner = gateway_at(address, &["noop=builtin:noop"]).await;
    describe_until_answered(&mut client).await.expect("the policy came up");
}

#[tokio::test]
async fn a_restarted_policy_is_used_again() {
    let inner = gateway(&["noop=builtin:noop"]).await;
    let address = inner.address;
    let outer = gateway(&[&format!("noop=grpc://{address}")]).await;
    let mut client = outer.client().await;
    client.reset(reset("", "s")).await.expect("an episode");
    client.infer(infer("", "s", 0)).await.expect("an answer");

    inner.stop().await;
    assert_refused(client.infer(infer("", "s", 1)).await, Code::Unavailable, &[]);

    let _inner = gateway_at(address, &["noop=builtin:noop"]).await;
    describe_until_answered(&mut client).await.expect("the policy came back");
    // The server has lost the session, but keeps no state between queries: the gateway repeats the
    // session's Reset, and the session continues.
    let answer = client.infer(infer("", "s", 1)).await.expect("an answer");
    assert_eq!(answer.get_ref().actions, NOOP_ACTION);
}

#[tokio::test]
async fn a_caller_that_disconnects_during_a_probe_lets_the_next_caller_probe() {
    let inner = gateway(&["noop=builtin:noop"]).await;
    let address = inner.address;
    let outer = gateway(&[&format!("noop=grpc://{address}")]).await;
    let mut client = outer.client().await;
    client.reset(reset("", "s")).await.expect("an episode");
    inner.stop().await;
    client.infer(infer("", "s", 0)).await.expect_err("the server has stopped");

    // A server that accepts connections and never sends anything.
    let silent_listener = tokio::net::TcpListener::bind(address).await.expect("free");
    tokio::time::sleep(WAITS.longest / 10).await;
    let probe = client.reset(reset("", "gone"));
    let patience = Duration::from_millis(300);
    let cut_off = tokio::time::timeout(patience, probe).await;
    cut_off.expect_err("no answer before the caller disconnects");

    drop(silent_listener);
    let _inner = gateway_at(address, &["noop=builtin:noop"]).await;
    let restarted_at = Instant::now();
    describe_until_answered(&mut client).await.expect("the policy is tried again");
    assert!(restarted_at.elapsed() < WAITS.longest);
}

#[tokio::test]
async fn a_restarted_gateway_adopts_sessions_of_its_back_end() {
    let inner = gateway(&["noop=builtin:noop"]).await;
    let route = format!("noop=grpc://{}", inner.address);
    let outer = gateway(&[&route]).await;
    outer.client().await.reset(reset("", "s")).await.expect("an episode");
    let address = outer.address;
    outer.stop().await;

    let outer = gateway_at(address, &[&route]).await;
    let answer = outer.client().await.infer(infer("", "s", 1)).await.expect("an answer");
    assert_eq!(answer.get_ref().actions, NOOP_ACTION);
}
