//! Several servers behind one name: selection of the server for each query.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use policy_gateway::config::{Batching, Config, RouteSpec};
use proto::policy::policy_client::PolicyClient;
use proto::policy::{DescribeRequest, DescribeResponse, ResetRequest};
use tonic::Code;
use tonic::transport::Channel;

use crate::assertions::assert_refused;
use crate::support::{
    Running, Scripted, chunk, describe, description, gateway, infer, reloadable, reset, serve,
    unused_address,
};

async fn server_answering(described: DescribeResponse, number: f32) -> Running {
    serve(Scripted::new(described, move |_| Ok(chunk(&[number; 7], 7)))).await
}

async fn number(client: &mut PolicyClient<Channel>, session: &str, query_index: u32) -> f32 {
    let answer = client.infer(infer("x", session, query_index)).await;
    answer.expect("an answer").get_ref().actions[0]
}

fn stateful() -> DescribeResponse {
    DescribeResponse { stateful: true, ..description("p", 1) }
}

fn replicas(servers: &[&Running]) -> String {
    let addresses: Vec<_> =
        servers.iter().map(|server| format!("grpc://{}", server.address)).collect();
    format!("x={}", addresses.join(","))
}

#[tokio::test]
async fn sessions_of_a_stateful_policy_are_distributed_and_stay_on_their_replica() {
    let first = server_answering(stateful(), 0.1).await;
    let second = server_answering(stateful(), 0.2).await;
    let gateway = gateway(&[&replicas(&[&first, &second])]).await;
    let mut client = gateway.client().await;
    let mut replica_numbers = vec![];
    for session in ["a", "b", "c", "d"] {
        client.reset(reset("x", session)).await.expect("an episode");
        replica_numbers.push(number(&mut client, session, 0).await);
    }
    assert_eq!(replica_numbers.iter().filter(|number| **number == 0.1).count(), 2);
    for query_index in 1..4 {
        for (session, expected) in ["a", "b", "c", "d"].iter().zip(&replica_numbers) {
            assert_eq!(number(&mut client, session, query_index).await, *expected);
        }
    }
    // A session of a stateful policy may not move to another replica.
    first.stop().await;
    let lost_session = replica_numbers.iter().position(|number| *number == 0.1);
    let lost_session = ["a", "b", "c", "d"][lost_session.expect("a session on the first replica")];
    assert_refused(client.infer(infer("x", lost_session, 4)).await, Code::Unavailable, &[]);
}

#[tokio::test]
async fn a_stateless_policys_query_moves_to_another_replica_after_a_reset_there() {
    let by_seed = |query: crate::support::Query| {
        let seed = query.seed.ok_or_else(|| tonic::Status::internal("no Reset"))?;
        Ok(chunk(&[seed as f32; 7], 7))
    };
    let first = serve(Scripted::new(description("p", 1), by_seed)).await;
    let second = serve(Scripted::new(description("p", 1), by_seed)).await;
    let gateway = gateway(&[&replicas(&[&first, &second])]).await;
    let mut client = gateway.client().await;
    client.reset(reset("x", "s")).await.expect("an episode");
    assert_eq!(number(&mut client, "s", 0).await, 7.0);
    first.stop().await;
    assert_eq!(number(&mut client, "s", 1).await, 7.0);
    // New sessions go to the remaining server, too.
    for session in ["t", "u", "v"] {
        client.reset(reset("x", session)).await.expect("an episode");
        assert_eq!(number(&mut client, session, 0).await, 7.0);
    }
}

#[tokio::test]
async fn a_replica_with_other_weights_serves_no_session() {
    let digest = |digest: &str| DescribeResponse {
        checkpoint_digest: digest.to_owned(),
        ..description("p", 1)
    };
    let first = server_answering(digest("aaaa"), 0.1).await;
    let second = server_answering(digest("bbbb"), 0.2).await;
    let route = replicas(&[&first, &second]);
    let gateway = gateway(&[&route]).await;
    let mut client = gateway.client().await;
    for session in ["a", "b", "c"] {
        client.reset(reset("x", session)).await.expect("an episode");
        assert_eq!(number(&mut client, session, 0).await, 0.1);
    }
    first.stop().await;
    assert_refused(client.reset(reset("x", "d")).await, Code::Unavailable, &[]);
}

#[tokio::test]
async fn a_changed_description_of_the_only_replica_is_refused_with_the_difference() {
    let digest_number = Arc::new(AtomicU32::new(0));
    let count = Arc::clone(&digest_number);
    let server = serve(Scripted::new(description("p", 1), |_| Ok(chunk(&[0.5; 7], 7))).describing(
        move || DescribeResponse {
            checkpoint_digest: format!("digest {}", count.load(Ordering::SeqCst)),
            ..description("p", 1)
        },
    ))
    .await;
    let gateway = gateway(&[&replicas(&[&server])]).await;
    let mut client = gateway.client().await;
    client.reset(reset("x", "s")).await.expect("an episode");
    digest_number.store(1, Ordering::SeqCst);
    assert_refused(
        client.reset(reset("x", "t")).await,
        Code::Unavailable,
        &["checkpoint digest", "digest 1", "digest 0", "SIGHUP"],
    );
}

fn per_suite(goal: &Running, object: &Running) -> RouteSpec {
    let backend = |server: &Running| {
        let text = format!("grpc://{}", server.address);
        vec![text.parse().expect("an address")]
    };
    let suites = [("libero_goal", goal), ("libero_object", object)];
    let suites = suites.map(|(suite, server)| (suite.to_owned(), backend(server)));
    RouteSpec { checkpoints: suites.into(), ..route(&replicas(&[goal])) }
}

fn route(text: &str) -> RouteSpec {
    text.parse().expect(text)
}

#[tokio::test]
async fn a_suite_is_answered_by_its_own_checkpoint_and_an_unknown_suite_is_refused() {
    let goal = server_answering(description("oft goal", 1), 0.1).await;
    let object = server_answering(description("oft object", 1), 0.2).await;
    let (gateway, _) = reloadable(vec![per_suite(&goal, &object)]).await;
    let mut client = gateway.client().await;
    for (suite, expected) in [("libero_goal", 0.1), ("libero_object", 0.2)] {
        let request = DescribeRequest { suite: suite.to_owned(), ..describe("x") };
        let described = client.describe(request).await.expect("a description");
        assert!(suite.ends_with(&described.get_ref().name[4..]));
        let request = ResetRequest { suite: suite.to_owned(), ..reset("x", suite) };
        client.reset(request).await.expect("an episode");
        assert_eq!(number(&mut client, suite, 0).await, expected);
    }
    assert_refused(
        client.describe(describe("x")).await,
        Code::InvalidArgument,
        &["names no suite", "libero_goal, libero_object"],
    );
    let request = DescribeRequest { suite: "libero_10".to_owned(), ..describe("x") };
    let unknown = client.describe(request).await.expect_err("no checkpoint");
    let part = r#"none for "libero_10""#;
    assert!(unknown.message().contains(part), "{unknown}");
}

#[tokio::test]
async fn a_reload_applies_to_new_sessions_only() {
    let old = server_answering(stateful(), 0.1).await;
    let new = server_answering(stateful(), 0.2).await;
    let (running, gateway) = reloadable(vec![route(&replicas(&[&old]))]).await;
    let mut client = running.client().await;
    client.reset(reset("x", "before")).await.expect("an episode");
    assert_eq!(number(&mut client, "before", 0).await, 0.1);

    let config = Config::new(vec![route(&replicas(&[&new]))]).expect("routes");
    gateway.reload(&config).expect("addresses");
    assert_eq!(number(&mut client, "before", 1).await, 0.1);
    client.reset(reset("x", "after")).await.expect("an episode");
    assert_eq!(number(&mut client, "after", 0).await, 0.2);

    // A policy that is removed from the configuration serves its open sessions to their end.
    let without_x = Config::new(vec![route("y=builtin:noop")]).expect("routes");
    gateway.reload(&without_x).expect("addresses");
    assert_eq!(number(&mut client, "before", 2).await, 0.1);
    assert_refused(client.reset(reset("x", "late")).await, Code::Unavailable, &[]);
    assert!(client.describe(describe("")).await.is_ok());
}

#[tokio::test]
async fn a_deterministic_policy_sends_each_seed_to_one_replica() {
    let servers = [
        server_answering(description("p", 1), 0.0).await,
        server_answering(description("p", 1), 1.0).await,
        server_answering(description("p", 1), 2.0).await,
    ];
    let spec = RouteSpec {
        batching: Batching::Deterministic,
        ..route(&replicas(&[&servers[0], &servers[1], &servers[2]]))
    };
    let (gateway, _) = reloadable(vec![spec]).await;
    let mut client = gateway.client().await;
    let mut replica_numbers = BTreeSet::new();
    for seed in 0..24 {
        let mut replicas_of_seed = BTreeSet::new();
        for attempt in 0..3 {
            let session = format!("{seed} {attempt}");
            let request = ResetRequest { seed, ..reset("x", &session) };
            client.reset(request).await.expect("an episode");
            replicas_of_seed.insert(number(&mut client, &session, 0).await as u32);
        }
        assert_eq!(replicas_of_seed.len(), 1);
        replica_numbers.extend(replicas_of_seed);
    }
    assert_eq!(replica_numbers.len(), 3, "24 seeds use all three replicas");
}

#[tokio::test]
async fn a_replica_that_is_down_from_the_start_is_skipped() {
    let nowhere = unused_address().await;
    let first = server_answering(description("p", 1), 0.1).await;
    let route = format!("x=grpc://{nowhere},grpc://{}", first.address);
    let gateway = gateway(&[&route]).await;
    let mut client = gateway.client().await;
    client.describe(describe("x")).await.expect("the other replica");
    client.reset(reset("x", "s")).await.expect("an episode");
    assert_eq!(number(&mut client, "s", 0).await, 0.1);
}
