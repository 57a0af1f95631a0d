//! The conformance check passes servers that keep to the protocol, and fails other servers on
//! exactly the points that they violate.

use policy_gateway::conformance::{
    self,
    Point::{
        self, Batch, Isolation, Order, OtherSeed, Range, Restart, Retry, SameSeed, Shape, Unopened,
        Version,
    },
    Target,
    verdict::Verdict,
};
use proto::policy::{DescribeResponse, InferResponse};
use tonic::Status;

use crate::support::{Query, Running, Scripted, chunk, description, gateway, serve};

/// Returns the points on which a server fails.
async fn failures(server: &Running, policy: &str) -> Vec<Point> {
    let target = Target {
        url: format!("grpc://{}", server.address),
        policy: policy.to_owned(),
        suite: "libero_object".to_owned(),
        access: transport::Access::none(),
    };
    let mut failed = vec![];
    let conforms = conformance::check(&target, &mut |finding| {
        if let Verdict::Fail { .. } = finding.verdict {
            failed.push(finding.point);
        }
    })
    .await
    .expect("the server can be checked");
    assert_eq!(conforms, failed.is_empty());
    failed
}

/// Asserts that a scripted policy fails on exactly these points.
async fn check<F>(described: DescribeResponse, answer: F, expected: &[Point])
where
    F: Fn(Query) -> Result<InferResponse, Status> + Send + Sync + 'static,
{
    let server = serve(Scripted::new(described, answer)).await;
    let mut found = failures(&server, "").await;
    // A scripted policy does not check versions.
    assert_eq!(found.remove(0), Version);
    assert_eq!(found, expected);
}

/// Answers like a well-behaved policy: a function of seed and query alone.
fn proper(query: &Query) -> Result<InferResponse, Status> {
    let seed = query
        .seed
        .ok_or_else(|| Status::unavailable("the session is not open"))?;
    Ok(chunk(
        &[(seed as f32 + query.query_index as f32 / 10.0) / 100.0; 7],
        7,
    ))
}

fn stochastic() -> DescribeResponse {
    DescribeResponse {
        stochastic: true,
        ..description("p", 1)
    }
}

#[tokio::test]
async fn the_builtin_policies_conform() {
    let gateway = gateway(&["noop=builtin:noop", "expert=builtin:expert"]).await;
    assert_eq!(failures(&gateway, "noop").await, []);
    assert_eq!(failures(&gateway, "expert").await, []);
}

#[tokio::test]
async fn a_policy_that_ignores_the_version_fails_on_that_alone_and_not_behind_a_gateway() {
    check(stochastic(), |query| proper(&query), &[]).await;

    let server = serve(Scripted::new(stochastic(), |query| proper(&query))).await;
    let gateway = gateway(&[&format!("x=grpc://{}", server.address)]).await;
    assert_eq!(failures(&gateway, "").await, []);
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
async fn noise_that_depends_on_the_order_of_requests_fails_wherever_it_shows() {
    let drawing =
        |query: Query| proper(&query).map(|_| chunk(&[query.asked_before as f32 / 1000.0; 7], 7));
    check(
        stochastic(),
        drawing,
        &[Retry, SameSeed, Order, Isolation, Restart],
    )
    .await;
}

#[tokio::test]
async fn a_seed_that_is_ignored_or_undeclared_fails_on_seeds() {
    let ignoring = |query: Query| proper(&query).map(|_| chunk(&[0.5; 7], 7));
    check(stochastic(), ignoring, &[OtherSeed]).await;
    check(description("p", 1), |query| proper(&query), &[OtherSeed]).await;
}

#[tokio::test]
async fn batches_that_are_declared_must_be_served() {
    let described = DescribeResponse {
        max_batch: 4,
        ..stochastic()
    };
    check(described, |query| proper(&query), &[Batch]).await;
}

#[tokio::test]
async fn a_session_that_was_never_opened_must_not_be_answered() {
    let obliging = |query: Query| {
        proper(&Query {
            seed: query.seed.or(Some(0)),
            ..query
        })
    };
    check(stochastic(), obliging, &[Unopened]).await;
}
