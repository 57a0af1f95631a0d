//! Exhaustive access test: the server must admit exactly the requests that the expectations below
//! allow.

use tonic::codegen::http::{Method, Request};

use super::*;
use crate::page;

#[path = "../../../crates/transport/tests/walk/mod.rs"]
mod walk;

use walk::{Credentials, OPERATOR, Sender, Table, calls_of, guarded, is_call, open, walk};

const TABLE: Table = (resource, Some(LOG_IN));

/// Returns all calls of the proto file, and three calls that it lacks, with the roles that may make
/// them.
fn calls() -> Vec<(String, Vec<Role>)> {
    let proto = include_str!("../../../proto/rollout/coordinator/v1/coordinator.proto");
    let mut calls = Vec::new();
    for (service, name) in calls_of(proto) {
        let is_read_only = ["Get", "List", "Report", "Export", "Forecast"]
            .iter()
            .any(|prefix| name.starts_with(prefix));
        let roles = match (service.as_str(), is_read_only) {
            ("WorkerService", _) => vec![Role::Worker],
            (_, true) => vec![Role::Viewer, Role::Operator],
            (_, false) => vec![Role::Operator],
        };
        calls.push((format!("/rollout.coordinator.v1.{service}/{name}"), roles));
    }
    assert!(calls.len() > 20, "the proto file yields too few calls");
    for unlisted in [
        "/rollout.coordinator.v1.OperatorService/Added",
        "/rollout.policy.v1.Policy/Infer",
        "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
    ] {
        calls.push((unlisted.to_owned(), vec![Role::Operator]));
    }
    calls
}

#[tokio::test]
async fn access_follows_the_table_for_every_combination_of_headers() {
    let (_file, guarded) = guarded();
    let cookie = guarded.log_in(OPERATOR, &READERS).expect("an operator");
    let cookie = cookie.split(';').next().expect("a pair").to_owned();
    let open = open();
    let mut requests = 0;
    for (security, cookie) in [(&open, None), (&guarded, Some(cookie.as_str()))] {
        for (path, roles) in calls() {
            let is_admitted =
                |request: &Request<()>, sender, content: Option<&str>, credentials| {
                    let is_allowed = match credentials {
                        Credentials::Token(role) => roles.contains(&role),
                        _ => false,
                    };
                    is_call(request, sender, content) && (cookie.is_none() || is_allowed)
                };
            requests += walk(&path, TABLE, security, cookie, is_admitted).await;
        }
        for (path, _) in page::routes() {
            let public_paths = ["/login", "/logout", "/style.css", "/page.js", "/icon.svg"];
            let is_public = public_paths.contains(&path);
            let is_admitted = |request: &Request<()>, sender, _: Option<&str>, credentials| {
                let is_trusted_sender =
                    matches!(sender, Sender::Program | Sender::OwnPage | Sender::Person)
                        || (sender == Sender::Link
                            && matches!(*request.method(), Method::GET | Method::HEAD));
                let may_read = matches!(
                    credentials,
                    Credentials::Token(Role::Operator | Role::Viewer) | Credentials::Session
                );
                is_trusted_sender && (cookie.is_none() || is_public || may_read)
            };
            let path = path.replace("{name}", "a.b").replace("{*rollout}", "c/d.e");
            requests += walk(&path, TABLE, security, cookie, is_admitted).await;
        }
    }
    assert!(requests > 200_000, "only {requests} combinations were tested");
}
