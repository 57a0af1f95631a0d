//! Exhaustive access test: the gate must admit exactly the requests that the tables below allow.

use tonic::codegen::http::{Method, Request};

use super::*;
use crate::page;

#[path = "../../../crates/service/transport/tests/walk/mod.rs"]
mod walk;

use walk::{Credentials, OPERATOR, Sender, Table, calls_of, guarded, is_call, open, walk};

const TABLE: Table = (resource, Some(LOG_IN));

/// Returns all calls with the roles that may make them, from the proto file and unknown services.
fn calls() -> Vec<(String, Vec<Role>)> {
    let proto = include_str!("../../../proto/rollout/coordinator/v1/coordinator.proto");
    let mut calls = Vec::new();
    for (service, name) in calls_of(proto) {
        let reads = ["Get", "List", "Report", "Export", "Forecast"]
            .iter()
            .any(|start| name.starts_with(start));
        let roles = match (service.as_str(), reads) {
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
            let table = |request: &Request<()>, sender, content: Option<&str>, credentials| {
                let is_allowed = match credentials {
                    Credentials::Token(role) => roles.contains(&role),
                    _ => false,
                };
                is_call(request, sender, content) && (cookie.is_none() || is_allowed)
            };
            requests += walk(&path, TABLE, security, cookie, table).await;
        }
        for (path, _) in page::routes() {
            let is_open = ["/login", "/logout", "/style.css", "/page.js", "/icon.svg"];
            let is_open = is_open.contains(&path);
            let table = |request: &Request<()>, sender, _: Option<&str>, credentials| {
                let is_trusted_sender =
                    matches!(sender, Sender::Program | Sender::OwnPage | Sender::Person)
                        || (sender == Sender::Link
                            && matches!(*request.method(), Method::GET | Method::HEAD));
                let may_read = matches!(
                    credentials,
                    Credentials::Token(Role::Operator | Role::Viewer) | Credentials::Session
                );
                is_trusted_sender && (cookie.is_none() || is_open || may_read)
            };
            let path = path.replace("{name}", "a.b").replace("{*rollout}", "c/d.e");
            requests += walk(&path, TABLE, security, cookie, table).await;
        }
    }
    assert!(
        requests > 200_000,
        "only {requests} combinations were tested"
    );
}
