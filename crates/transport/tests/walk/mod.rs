//! Exhaustive walk over a server's access table: requests a path with every combination of sender,
//! credentials, method and content type, and asserts which of them the gate admits. Shared by the
//! tests of all servers.

use std::convert::Infallible;
use std::future::{Ready, ready};
use std::task::{Context, Poll};

use tonic::body::Body;
use tonic::codegen::Service;
use tonic::codegen::http::{Method, Request, Response, Version};
use tower_layer::Layer;
use transport::{Resource, Role, Security, ServerArguments};

const WORKER: &str = "worker-secret-0123456789";
pub(crate) const OPERATOR: &str = "operator-secret-0123456789";
const VIEWER: &str = "viewer-secret-0123456789";
const HOST: &str = "127.0.0.1:7411";

/// Access table of a server, and the path of its log-in page, if it has one.
pub(crate) type Table = (fn(&str) -> Resource, Option<&'static str>);

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
pub(crate) enum Sender {
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
    OtherSite,
    /// Another site's page in a browser that sends no `Sec-Fetch-Site`.
    OtherSiteOldBrowser,
    /// A page without an origin: a sandboxed frame, or a file.
    NoOrigin,
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
        Sender::OtherSite,
        Sender::OtherSiteOldBrowser,
        Sender::NoOrigin,
        Sender::Frame,
    ];

    fn headers(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Sender::Program => &[],
            Sender::OwnPage => {
                &[("origin", "http://127.0.0.1:7411"), ("sec-fetch-site", "same-origin")]
            }
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
            Sender::OtherSite => &[("sec-fetch-site", "cross-site"), ("sec-fetch-mode", "no-cors")],
            Sender::OtherSiteOldBrowser => &[("origin", "https://evil.example")],
            Sender::NoOrigin => &[("origin", "null"), ("sec-fetch-site", "cross-site")],
            Sender::Frame => &[
                ("sec-fetch-site", "cross-site"),
                ("sec-fetch-mode", "navigate"),
                ("sec-fetch-dest", "iframe"),
            ],
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Credentials {
    Nothing,
    WrongToken,
    Token(Role),
    /// The cookie of a browser in which an operator logged in.
    Session,
    /// An operator's token in place of the session id in the cookie.
    TokenInCookie,
}

impl Credentials {
    const ALL: [Credentials; 7] = [
        Credentials::Nothing,
        Credentials::WrongToken,
        Credentials::Token(Role::Worker),
        Credentials::Token(Role::Operator),
        Credentials::Token(Role::Viewer),
        Credentials::Session,
        Credentials::TokenInCookie,
    ];
}

const METHODS: [Method; 5] =
    [Method::GET, Method::POST, Method::HEAD, Method::PUT, Method::OPTIONS];

const CONTENTS: [Option<&str>; 7] = [
    None,
    Some("text/plain"),
    Some("application/x-www-form-urlencoded"),
    Some("application/grpc"),
    Some("application/grpc+proto"),
    Some("application/grpc-web"),
    Some("application/grpc-web-text+proto"),
];

pub(crate) fn guarded() -> (tempfile::NamedTempFile, Security) {
    let file = tempfile::NamedTempFile::new().expect("a file");
    let tokens = format!("worker {WORKER}\noperator {OPERATOR}\nviewer {VIEWER}\n");
    std::fs::write(file.path(), tokens).expect("written");
    let arguments =
        ServerArguments { token_file: Some(file.path().to_owned()), ..ServerArguments::default() };
    let security = arguments.security(HOST.parse().expect("an address"));
    (file, security.expect("tokens"))
}

/// Returns the rules of a server without tokens. A request of these tests has no connection whose
/// user could be checked, so every user is admitted.
pub(crate) fn open() -> Security {
    let arguments = ServerArguments { insecure_loopback: true, ..ServerArguments::default() };
    let security = arguments.security(HOST.parse().expect("an address"));
    security.expect("no tokens")
}

/// Returns true if a request is a gRPC call of a program.
pub(crate) fn is_call(request: &Request<()>, sender: Sender, content: Option<&str>) -> bool {
    request.version() == Version::HTTP_2
        && request.method() == Method::POST
        && matches!(content, Some("application/grpc" | "application/grpc+proto"))
        && sender == Sender::Program
}

/// Returns the calls of a proto file, each as its service and its name.
pub(crate) fn calls_of(proto: &str) -> Vec<(String, String)> {
    let mut service = "";
    let mut calls = Vec::new();
    for line in proto.lines() {
        let mut words = line.trim().split([' ', '(']);
        match (words.next(), words.next()) {
            (Some("service"), Some(name)) => service = name,
            (Some("rpc"), Some(name)) => calls.push((service.to_owned(), name.to_owned())),
            _ => {}
        }
    }
    calls
}

fn credential_header(
    credentials: Credentials,
    cookie: Option<&str>,
) -> Option<(&'static str, String)> {
    let bearer = |token: &str| Some(("authorization", format!("Bearer {token}")));
    match credentials {
        Credentials::Nothing => None,
        Credentials::WrongToken => bearer("wrong-secret-0123456789"),
        Credentials::Token(Role::Worker) => bearer(WORKER),
        Credentials::Token(Role::Operator) => bearer(OPERATOR),
        Credentials::Token(Role::Viewer) => bearer(VIEWER),
        Credentials::Session => Some(("cookie", cookie?.to_owned())),
        Credentials::TokenInCookie => {
            let (name, _) = cookie?.split_once('=')?;
            Some(("cookie", format!("{name}={OPERATOR}")))
        }
    }
}

/// Requests a path with every combination of headers and asserts that the gate admits exactly the
/// requests for which `expected` returns true. Returns the number of requests.
pub(crate) async fn walk(
    path: &str,
    (table, log_in): Table,
    security: &Security,
    cookie: Option<&str>,
    expected: impl Fn(&Request<()>, Sender, Option<&str>, Credentials) -> bool,
) -> usize {
    let mut requests = 0;
    for version in [Version::HTTP_11, Version::HTTP_2] {
        for method in METHODS {
            // Each method gets a new gate: a gate limits the request rate of a connection, and to
            // it all requests of this test come from one connection.
            let mut gate = security.gate(table, log_in).layer(Reached);
            for content in CONTENTS {
                for sender in Sender::ALL {
                    for credentials in Credentials::ALL {
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
                        if let Some((name, value)) = credential_header(credentials, cookie) {
                            request = request.header(name, value);
                        }
                        let request = request.body(()).expect("a request");
                        let expected = expected(&request, sender, content, credentials);
                        let answer = gate.call(request).await.expect("an answer");
                        let is_admitted = answer.headers().contains_key("x-reached");
                        assert_eq!(
                            is_admitted,
                            expected,
                            "{version:?} {method} {path} of {content:?} by {sender:?}, with \
                             credentials {credentials:?}, to a server {} tokens",
                            if cookie.is_some() { "with" } else { "without" }
                        );
                        requests += 1;
                    }
                }
            }
        }
    }
    requests
}
