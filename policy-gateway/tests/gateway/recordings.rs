//! Recorded and replayed sessions: without the server, the same observation gets the same actions,
//! and a different observation is reported.

use std::path::Path;

use policy_backends::recorder::RecordInto;
use policy_backends::recording;
use policy_gateway::config::RouteSpec;
use proto::policy::policy_client::PolicyClient;
use proto::policy::{Image, InferRequest, InferResponse, Observation};
use tonic::transport::Channel;
use tonic::{Code, Status};

use crate::support::{
    Query, Running, Scripted, chunk, description, infer, reloadable, reset, serve,
};

fn observation(query_index: u32) -> Observation {
    let frame = Image {
        camera: "agentview".to_owned(),
        width: 2,
        height: 2,
        rgb: vec![query_index as u8; 12].into(),
    };
    Observation { images: vec![frame], ..Observation::default() }
}

async fn send_query(
    client: &mut PolicyClient<Channel>,
    query_index: u32,
    observation: Observation,
) -> Result<InferResponse, Status> {
    let query = InferRequest { observation: Some(observation), ..infer("x", "s", query_index) };
    client.infer(query).await.map(tonic::Response::into_inner)
}

/// Returns the answers to two queries of one session through a gateway that records up to
/// `max_bytes`.
async fn record(folder: &Path, max_bytes: u64) -> Vec<InferResponse> {
    let answer = |query: Query| Ok(chunk(&[0.1 * query.query_index as f32; 7], 7));
    let server = serve(Scripted::new(description("p", 1), answer)).await;
    let route: RouteSpec = format!("x=grpc://{}", server.address).parse().expect("a route");
    let folder = folder.to_owned();
    let record = Some(RecordInto { folder, max_bytes });
    let (gateway, handle) = reloadable(vec![RouteSpec { record, ..route }]).await;
    let mut client = gateway.client().await;
    client.reset(reset("x", "s")).await.expect("an episode");
    let mut answers = vec![];
    for query in 0..2 {
        answers.push(send_query(&mut client, query, observation(query)).await.expect("an answer"));
    }
    drop((client, handle));
    gateway.stop().await;
    server.stop().await;
    answers
}

async fn replay(folder: &Path) -> Running {
    let name = "x".parse().expect("a name");
    let route = RouteSpec::new(
        name,
        vec![format!("replay:{}", folder.display()).parse().expect("a back-end")],
    );
    reloadable(vec![route]).await.0
}

#[tokio::test]
async fn a_recorded_session_is_answered_again_and_the_first_difference_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let recorded = record(folder.path(), 1 << 20).await;
    let gateway = replay(folder.path()).await;
    let mut client = gateway.client().await;
    client.reset(reset("x", "s")).await.expect("recorded");
    for (query, answer) in (0..).zip(&recorded) {
        let replayed = send_query(&mut client, query, observation(query)).await;
        assert_eq!(&replayed.expect("recorded"), answer);
    }

    client.reset(reset("x", "s")).await.expect("recorded");
    let mut changed = observation(0);
    changed.images[0].rgb = [[0; 3], [0; 3], [0, 9, 9], [0; 3]].concat().into();
    let refused = send_query(&mut client, 0, changed).await.expect_err("another observation");
    assert_eq!(refused.code(), Code::Internal);
    let named = "2 of 12 numbers of \"agentview\" differ, first at column 0 of row 1 (row 0 is at \
                 the bottom; 0 was recorded, 9 was sent)";
    assert!(refused.message().contains(named), "{refused}");

    let third_query = send_query(&mut client, 2, observation(2)).await;
    let third_query = third_query.expect_err("no third query was recorded");
    assert!(
        third_query.message().contains("has 2 queries and none with the number 2"),
        "{third_query}"
    );
    let unrecorded = proto::policy::ResetRequest { seed: 8, ..reset("x", "t") };
    let unrecorded = client.reset(unrecorded).await.expect_err("another seed");
    assert!(unrecorded.message().contains("with seed 8"), "{unrecorded}");
}

#[tokio::test]
async fn sessions_beyond_the_size_limit_are_served_unrecorded() {
    let folder = tempfile::tempdir().expect("a folder");
    assert_eq!(record(folder.path(), 60).await.len(), 2);
    assert!(recording::files(folder.path()).is_err());
    let left = std::fs::read_dir(folder.path()).expect("a folder").count();
    assert_eq!(left, 0, "no part of a recording");
}
