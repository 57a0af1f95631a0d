//! Exhaustive access test: every path of every service and page is requested with every combination
//! of sender, credentials, method and content type, and the gate must admit exactly the requests
//! that the tables below allow.

use std::convert::Infallible;
use std::future::{Ready, ready};
use std::task::{Context, Poll};

use tonic::body::Body;
use tonic::codegen::Service;
use tonic::codegen::http::{Method, Request, Response, Version};
use tower_layer::Layer;
use transport::{Security, ServerArguments};

use super::*;
use crate::page;

const WORKER: &str = "worker-secret-0123456789";
const OPERATOR: &str = "operator-secret-0123456789";
const VIEWER: &str = "viewer-secret-0123456789";
const HOST: &str = "127.0.0.1:7411";

/// A service behind the gate: answers that it was reached.
#[derive(Clone)]
struct Reached;

impl Service<Request<()>> for Reached {
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = Ready<Result<Response<Body>, Infallible>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, _: Request<()>) -> Self::Future {
        let mut answer = Response::new(Body::empty());
        answer.headers_mut().insert("x-reached", 1.into());
        ready(Ok(answer))
    }
}

/// Sender of a request, as inferred from its headers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sender {
    /// `coordinator`, a worker, curl.
    Program,
    /// One of this server's pages.
    OwnPage,
    /// A person who types the address.
    Person,
    /// A person who follows another site's link.
    Link,
    /// A page of another port of this machine.
    OtherPort,
    /// Another site's page, in a browser that sends `Sec-Fetch-Site`.
    Stranger,
    /// Another site's page in a browser that sends no `Sec-Fetch-Site`.
    OldStranger,
    /// A page without an origin: a sandboxed frame, or a file.
    Nowhere,
    /// Another site's page that shows this server in a frame.
    Frame,
}

impl Sender {
    const ALL: [Sender; 9] = [
        Sender::Program,
        Sender::OwnPage,
        Sender::Person,
        Sender::Link,
        Sender::OtherPort,
        Sender::Stranger,
        Sender::OldStranger,
        Sender::Nowhere,
        Sender::Frame,
    ];

    fn headers(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Sender::Program => &[],
            Sender::OwnPage => &[
                ("origin", "http://127.0.0.1:7411"),
                ("sec-fetch-site", "same-origin"),
            ],
            Sender::Person => &[
                ("sec-fetch-site", "none"),
                ("sec-fetch-mode", "navigate"),
                ("sec-fetch-dest", "document"),
            ],
            Sender::Link => &[
                ("sec-fetch-site", "cross-site"),
                ("sec-fetch-mode", "navigate"),
                ("sec-fetch-dest", "document"),
            ],
            Sender::OtherPort => &[
                ("origin", "http://127.0.0.1:8888"),
                ("sec-fetch-site", "same-site"),
                ("sec-fetch-mode", "no-cors"),
            ],
            Sender::Stranger => &[
                ("sec-fetch-site", "cross-site"),
                ("sec-fetch-mode", "no-cors"),
            ],
            Sender::OldStranger => &[("origin", "https://evil.example")],
            Sender::Nowhere => &[("origin", "null"), ("sec-fetch-site", "cross-site")],
            Sender::Frame => &[
                ("sec-fetch-site", "cross-site"),
                ("sec-fetch-mode", "navigate"),
                ("sec-fetch-dest", "iframe"),
            ],
        }
    }
}

/// The credentials of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shown {
    Nothing,
    WrongToken,
    Token(Role),
    /// The cookie of a browser in which an operator logged in.
    Session,
    /// An operator's token in place of the session id in the cookie.
    TokenInCookie,
}

impl Shown {
    const ALL: [Shown; 7] = [
        Shown::Nothing,
        Shown::WrongToken,
        Shown::Token(Role::Worker),
        Shown::Token(Role::Operator),
        Shown::Token(Role::Viewer),
        Shown::Session,
        Shown::TokenInCookie,
    ];
}

const CONTENTS: [Option<&str>; 7] = [
    None,
    Some("text/plain"),
    Some("application/x-www-form-urlencoded"),
    Some("application/grpc"),
    Some("application/grpc+proto"),
    Some("application/grpc-web"),
    Some("application/grpc-web-text+proto"),
];

/// Returns all calls with the roles that may make them, from the proto file and unknown services.
fn calls() -> Vec<(String, Vec<Role>)> {
    let proto = include_str!("../../../proto/rollout/coordinator/v1/coordinator.proto");
    let mut service = "";
    let mut calls = Vec::new();
    for line in proto.lines() {
        let mut words = line.trim().split([' ', '(']);
        match (words.next(), words.next()) {
            (Some("service"), Some(name)) => service = name,
            (Some("rpc"), Some(name)) => {
                let reads = ["Get", "List", "Report", "Export", "Forecast"]
                    .iter()
                    .any(|start| name.starts_with(start));
                let roles = match (service, reads) {
                    ("WorkerService", _) => vec![Role::Worker],
                    (_, true) => vec![Role::Viewer, Role::Operator],
                    (_, false) => vec![Role::Operator],
                };
                calls.push((format!("/rollout.coordinator.v1.{service}/{name}"), roles));
            }
            _ => {}
        }
    }
    assert!(
        calls.len() > 20,
        "the services' definition is not understood"
    );
    for elsewhere in [
        "/rollout.coordinator.v1.OperatorService/Added",
        "/rollout.policy.v1.Policy/Infer",
        "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
    ] {
        calls.push((elsewhere.to_owned(), vec![Role::Operator]));
    }
    calls
}

fn guarded() -> (tempfile::NamedTempFile, Security) {
    let file = tempfile::NamedTempFile::new().expect("a file");
    let tokens = format!("worker {WORKER}\noperator {OPERATOR}\nviewer {VIEWER}\n");
    std::fs::write(file.path(), tokens).expect("written");
    let arguments = ServerArguments {
        token_file: Some(file.path().to_owned()),
        ..ServerArguments::default()
    };
    let security = arguments.security(HOST.parse().expect("an address"));
    (file, security.expect("tokens"))
}

fn credentials(shown: Shown, cookie: Option<&str>) -> Option<(&'static str, String)> {
    let bearer = |token: &str| Some(("authorization", format!("Bearer {token}")));
    match shown {
        Shown::Nothing => None,
        Shown::WrongToken => bearer("wrong-secret-0123456789"),
        Shown::Token(Role::Worker) => bearer(WORKER),
        Shown::Token(Role::Operator) => bearer(OPERATOR),
        Shown::Token(Role::Viewer) => bearer(VIEWER),
        Shown::Session => Some(("cookie", cookie?.to_owned())),
        Shown::TokenInCookie => {
            let (name, _) = cookie?.split_once('=')?;
            Some(("cookie", format!("{name}={OPERATOR}")))
        }
    }
}

/// Requests a path with every combination of headers and asserts that the gate admits exactly the
/// requests for which `expected` returns true. Returns the number of requests.
async fn walk(
    path: &str,
    security: &Security,
    cookie: Option<&str>,
    expected: impl Fn(&Request<()>, Sender, Option<&str>, Shown) -> bool,
) -> usize {
    // A new gate for each path, since a gate counts the requests of its connection.
    let mut gate = security.gate(resource, Some(LOG_IN)).layer(Reached);
    let mut asked = 0;
    for version in [Version::HTTP_11, Version::HTTP_2] {
        for method in [Method::GET, Method::POST] {
            for content in CONTENTS {
                for sender in Sender::ALL {
                    for shown in Shown::ALL {
                        let mut request = Request::builder()
                            .version(version)
                            .method(method.clone())
                            .uri(path)
                            .header("host", HOST);
                        if let Some(content) = content {
                            request = request.header("content-type", content);
                        }
                        for (name, value) in sender.headers() {
                            request = request.header(*name, *value);
                        }
                        if let Some((name, value)) = credentials(shown, cookie) {
                            request = request.header(name, value);
                        }
                        let request = request.body(()).expect("a request");
                        let expected = expected(&request, sender, content, shown);
                        let answer = gate.call(request).await.expect("an answer");
                        let came_through = answer.headers().contains_key("x-reached");
                        assert_eq!(
                            came_through,
                            expected,
                            "{version:?} {method} {path} of {content:?} by {sender:?}, showing \
                             {shown:?}, to a server {} tokens",
                            if cookie.is_some() { "with" } else { "without" }
                        );
                        asked += 1;
                    }
                }
            }
        }
    }
    asked
}

#[tokio::test]
async fn no_combination_of_headers_opens_more_than_the_table_says() {
    let (_file, guarded) = guarded();
    let cookie = guarded.log_in(OPERATOR, &READERS).expect("an operator");
    let cookie = cookie.split(';').next().expect("a pair").to_owned();
    // Without a real connection, the peer's user cannot be checked.
    let open = ServerArguments {
        insecure_loopback: true,
        ..ServerArguments::default()
    };
    let open = open.security(HOST.parse().expect("an address"));
    let open = open.expect("no tokens");
    let mut asked = 0;
    for (security, cookie) in [(&open, None), (&guarded, Some(cookie.as_str()))] {
        for (path, roles) in calls() {
            let table = |request: &Request<()>, sender, content: Option<&str>, shown| {
                let is_call = request.version() == Version::HTTP_2
                    && request.method() == Method::POST
                    && matches!(content, Some("application/grpc" | "application/grpc+proto"));
                let is_allowed = match shown {
                    Shown::Token(role) => roles.contains(&role),
                    _ => false,
                };
                is_call && sender == Sender::Program && (cookie.is_none() || is_allowed)
            };
            asked += walk(&path, security, cookie, table).await;
        }
        for (path, _) in page::routes() {
            let is_open = ["/login", "/logout", "/style.css", "/page.js", "/icon.svg"];
            let is_open = is_open.contains(&path);
            let table = |request: &Request<()>, sender, _: Option<&str>, shown| {
                let is_own = matches!(sender, Sender::Program | Sender::OwnPage | Sender::Person)
                    || (sender == Sender::Link && request.method() == Method::GET);
                let may_read = matches!(
                    shown,
                    Shown::Token(Role::Operator | Role::Viewer) | Shown::Session
                );
                is_own && (cookie.is_none() || is_open || may_read)
            };
            let path = path.replace("{name}", "a.b").replace("{*rollout}", "c/d.e");
            asked += walk(&path, security, cookie, table).await;
        }
    }
    assert!(asked > 50_000, "only {asked} combinations were asked for");
}
