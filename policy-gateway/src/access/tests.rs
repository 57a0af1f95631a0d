//! Exhaustive access test, like the coordinator's.

use tonic::codegen::http::Request;

use super::*;

#[path = "../../../crates/transport/tests/walk/mod.rs"]
mod walk;

use walk::{Credentials, OPERATOR, Table, calls_of, guarded, is_call, open, walk};

/// The gateway's access table; the gateway has no log-in page.
const TABLE: Table = (resource, None);

/// Returns paths, each with true if its calls need no token.
fn paths() -> Vec<(String, bool)> {
    let proto = include_str!("../../../proto/rollout/policy/v1/policy.proto");
    let calls = calls_of(proto).into_iter();
    let policy =
        calls.map(|(service, name)| (format!("/rollout.policy.v1.{service}/{name}"), false));
    let health = ["Check", "Watch"].map(|name| (format!("/grpc.health.v1.Health/{name}"), true));
    let other_paths = [
        "/",
        "/metrics",
        "/grpc.health.v1.Health",
        "/grpc.health.v1.HealthAdmin/Stop",
        "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
        "/rollout.coordinator.v1.OperatorService/ListCampaigns",
    ];
    let other_paths = other_paths.map(|path| (path.to_owned(), false));
    let paths: Vec<_> = policy.chain(health).chain(other_paths).collect();
    assert_eq!(paths.len(), 13, "five calls, two health checks and six other paths");
    paths
}

#[tokio::test]
async fn no_combination_of_headers_calls_a_policy_without_a_token_of_a_worker_or_operator() {
    let (_file, guarded) = guarded();
    let cookie = guarded.log_in(OPERATOR, &[Role::Operator]);
    let cookie = cookie.expect("an operator");
    let cookie = cookie.split(';').next().expect("a pair").to_owned();
    let mut combinations = 0;
    for (security, cookie) in [(&open(), None), (&guarded, Some(cookie.as_str()))] {
        for (path, is_public) in paths() {
            let table = |request: &Request<()>, sender, content: Option<&str>, credentials| {
                let is_allowed =
                    matches!(credentials, Credentials::Token(Role::Worker | Role::Operator));
                is_call(request, sender, content) && (cookie.is_none() || is_public || is_allowed)
            };
            combinations += walk(&path, TABLE, security, cookie, table).await;
        }
    }
    assert!(combinations > 100_000, "only {combinations} combinations were checked");
}
