//! The conformance check fails servers on exactly the points that they violate. The gateway's tests
//! show that it passes conforming servers.

use policy_gateway::doctor::check::Point::{
    self, Batch, Isolation, Order, OtherSeed, Range, Restart, Retry, SameSeed, Shape, Unopened,
    Version,
};
use proto::policy::{DescribeResponse, InferResponse};
use tonic::Status;

use crate::scripted::{Query, Scripted, chunk, description, failures, proper, serve, stochastic};

async fn check<F>(described: DescribeResponse, answer: F, expected: &[Point])
where
    F: Fn(Query) -> Result<InferResponse, Status> + Send + Sync + 'static,
{
    let server = serve(Scripted::new(described, answer)).await;
    let mut found = failures(&server.address.to_string()).await;
    // A scripted policy does not check versions.
    assert_eq!(found.remove(0), Version);
    assert_eq!(found, expected);
}

#[tokio::test]
async fn a_policy_that_ignores_the_version_fails_only_on_the_version() {
    check(stochastic(), |query| proper(&query), &[]).await;
}

#[tokio::test]
async fn answers_that_are_no_actions_fail_on_their_shape_or_range() {
    let answering = |number: f32, width: u32| {
        move |query: Query| proper(&query).map(|_| chunk(&vec![number; width as usize], width))
    };
    check(description("p", 1), answering(f32::NAN, 7), &[Shape]).await;
    check(description("p", 1), answering(0.0, 6), &[Shape]).await;
    check(description("p", 1), answering(0.0, 0), &[Shape]).await;
    check(description("p", 1), answering(1e9, 7), &[Shape, Range]).await;
}

#[tokio::test]
async fn noise_that_depends_on_the_order_of_requests_fails_on_points_that_demand_equal_answers() {
    let drawing = |query: Query| {
        proper(&query).map(|_| chunk(&[query.earlier_queries as f32 / 1000.0; 7], 7))
    };
    check(stochastic(), drawing, &[Retry, SameSeed, Order, Isolation, Restart]).await;
}

#[tokio::test]
async fn a_seed_that_is_ignored_or_undeclared_fails_on_seeds() {
    let ignoring = |query: Query| proper(&query).map(|_| chunk(&[0.5; 7], 7));
    check(stochastic(), ignoring, &[OtherSeed]).await;
    check(description("p", 1), |query| proper(&query), &[OtherSeed]).await;
}

#[tokio::test]
async fn batches_that_are_declared_must_be_served() {
    let described = DescribeResponse { max_batch: 4, ..stochastic() };
    check(described, |query| proper(&query), &[Batch]).await;
}

#[tokio::test]
async fn a_session_that_was_never_opened_must_not_be_answered() {
    let answering_without_reset =
        |query: Query| proper(&Query { seed: query.seed.or(Some(0)), ..query });
    check(stochastic(), answering_without_reset, &[Unopened]).await;
}
