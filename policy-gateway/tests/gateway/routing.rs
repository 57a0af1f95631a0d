//! Routing of requests to policies, and the gateway's description of itself.

use policy_backends::builtin::noop::NOOP_ACTION;
use policy_backends::builtin::{self};
use policy_backends::description::MAX_BATCH_QUERIES;
use proto::policy::{
    DescribeRequest, DescribeResponse, Image, InferBatchRequest, InferRequest, Observation,
    infer_result,
};
use tonic::Code;
use tonic::transport::Endpoint;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use crate::assertions::assert_refused;
use crate::support::{client, describe, gateway, infer, reset};

#[tokio::test]
async fn a_builtin_policy_answers_an_episode() {
    let gateway = gateway(&["noop=builtin:noop"]).await;
    let mut client = gateway.client().await;

    let described = client.describe(describe("noop")).await.expect("a description").into_inner();
    assert_eq!((described.name.as_str(), described.horizon), ("noop", 1));
    assert!(described.cameras.is_empty());

    client.reset(reset("noop", "s")).await.expect("an episode");
    for query_index in 0..3 {
        let answer = client.infer(infer("noop", "s", query_index)).await.expect("an answer");
        assert_eq!(answer.get_ref().action_width, 7);
        assert_eq!(answer.get_ref().actions, NOOP_ACTION);
    }
}

#[tokio::test]
async fn a_gateway_behind_a_gateway_looks_like_a_policy() {
    let inner = gateway(&["noop=builtin:noop", "expert=builtin:expert"]).await;
    let route = format!("outer=grpc://{}/expert", inner.address);
    let outer = gateway(&[&route]).await;
    let mut client = outer.client().await;

    let described = client.describe(describe("outer")).await.expect("a description").into_inner();
    assert_eq!(described.batch_mode, "single");
    let expected =
        DescribeResponse { batch_mode: "single".to_owned(), ..builtin::expert::describe() };
    assert_eq!(described, expected);

    let route = format!("x=grpc://{}/noop", inner.address);
    let outer = gateway(&[&route]).await;
    let mut client = outer.client().await;
    client.reset(reset("x", "s")).await.expect("an episode");
    let answer = client.infer(infer("x", "s", 0)).await.expect("an answer");
    assert_eq!(answer.get_ref().actions, NOOP_ACTION);
}

#[tokio::test]
async fn the_only_policy_needs_no_name_and_several_are_listed() {
    let with_one_policy = gateway(&["noop=builtin:noop"]).await;
    let described =
        with_one_policy.client().await.describe(describe("")).await.expect("the only policy");
    assert_eq!(described.get_ref().name, "noop");

    let with_two_policies = gateway(&["stand=builtin:noop", "work=builtin:expert"]).await;
    let mut client = with_two_policies.client().await;
    assert_refused(
        client.describe(describe("")).await,
        Code::InvalidArgument,
        &["several policies (stand, work)", "`--policy NAME`", "/NAME`"],
    );
    assert_refused(
        client.infer(infer("pi05", "s", 0)).await,
        Code::NotFound,
        &["\"pi05\"", "stand, work"],
    );
}

#[tokio::test]
async fn a_caller_of_another_protocol_version_is_refused_naming_both_versions() {
    let gateway = gateway(&["noop=builtin:noop"]).await;
    let request = DescribeRequest { protocol_version: 99, ..DescribeRequest::default() };
    let refused = gateway.client().await.describe(request).await.expect_err("version 99");
    assert_eq!(refused.code(), Code::FailedPrecondition);
    assert!(refused.message().contains("version 99"), "{refused}");
    let own_version = format!("version {};", proto::PROTOCOL_VERSION);
    assert!(refused.message().contains(&own_version), "{refused}");
}

#[tokio::test]
async fn the_health_service_says_that_policies_are_served() {
    let gateway = gateway(&["noop=builtin:noop"]).await;
    let endpoint = Endpoint::from_shared(format!("http://{}", gateway.address)).expect("a URL");
    let mut health = HealthClient::new(endpoint.connect().await.expect("a server at the address"));
    for service in ["", "rollout.policy.v1.Policy"] {
        let request = HealthCheckRequest { service: service.to_owned() };
        let answer = health.check(request).await.expect(service).into_inner();
        assert_eq!(answer.status(), ServingStatus::Serving, "{service:?}");
    }
}

#[tokio::test]
async fn one_query_of_a_batch_fails_alone_and_results_keep_their_order() {
    let gateway = gateway(&["noop=builtin:noop"]).await;
    let mut client = client(gateway.address).await;
    client.reset(reset("", "a")).await.expect("an episode");
    client.reset(reset("", "b")).await.expect("an episode");
    let nameless = infer("", "", 0);
    let queries = vec![infer("", "a", 0), nameless, infer("", "b", 5)];
    let batch = client.infer_batch(InferBatchRequest { queries }).await.expect("three results");
    let results: Vec<_> =
        batch.into_inner().results.into_iter().map(|result| result.result).collect();
    let answered = |result: &_| {
        matches!(result, Some(infer_result::Result::Response(answer))
            if answer.actions == NOOP_ACTION)
    };
    assert!(answered(&results[0]) && answered(&results[2]), "{results:?}");
    assert!(
        matches!(&results[1], Some(infer_result::Result::Error(text)) if text.contains("name")),
        "{results:?}"
    );

    let queries = vec![infer("", "a", 0); MAX_BATCH_QUERIES + 1];
    assert_refused(
        client.infer_batch(InferBatchRequest { queries }).await,
        Code::InvalidArgument,
        &[],
    );
}

#[tokio::test]
async fn a_session_that_was_never_opened_is_an_outage_not_a_fault_of_the_policy() {
    let gateway = gateway(&["noop=builtin:noop"]).await;
    assert_refused(
        gateway.client().await.infer(infer("", "unheard-of", 4)).await,
        Code::Unavailable,
        &["the session is not open here"],
    );
}

#[tokio::test]
async fn a_session_name_of_a_million_characters_is_refused() {
    let gateway = gateway(&["noop=builtin:noop"]).await;
    let name = "s".repeat(1_000_000);
    let refused =
        gateway.client().await.reset(reset("", &name)).await.expect_err("an overlong name");
    assert_eq!(refused.code(), Code::InvalidArgument);
    assert!(refused.message().len() < 200, "{refused}");
}

#[tokio::test]
async fn frames_beyond_the_usual_message_limit_pass_through_a_chain() {
    let inner = gateway(&["noop=builtin:noop"]).await;
    let outer = gateway(&[&format!("x=grpc://{}", inner.address)]).await;
    let mut client =
        client(outer.address).await.max_encoding_message_size(proto::MAX_MESSAGE_BYTES);
    client.reset(reset("x", "s")).await.expect("an episode");
    let side = 2048;
    let frame = Image {
        camera: "agentview".to_owned(),
        width: side,
        height: side,
        rgb: vec![7; (side * side * 3) as usize].into(),
    };
    let observation = Observation { images: vec![frame], ..Observation::default() };
    let query = InferRequest { observation: Some(observation), ..infer("x", "s", 0) };
    client.infer(query).await.expect("an answer to 12 MiB of pixels");
}
