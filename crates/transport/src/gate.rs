//! The gate before a server's calls and pages. It limits the request rate of each connection,
//! checks access by the server's table of paths, and logs refusals. Refusals by the calls behind
//! the gate are logged too, and long status messages are truncated. The path alone decides whether
//! a request is a call; headers do not, because another site's page can choose them. Message bodies
//! are not inspected.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};

use tokio::time::Instant;
use tonic::body::Body;
use tonic::codegen::http::{HeaderMap, Request, Response, StatusCode, header};
use tonic::codegen::{BoxFuture, Service};
use tonic::transport::server::TlsConnectInfo;
use tonic::{Code, Status};
use tower_layer::Layer;

use crate::browser;
use crate::browser_sessions::BrowserSessions;
use crate::rate::{MAX_REQUESTS_PER_SEC, Rates};
use crate::refusals::Refusals;
use crate::token::{Role, Tokens};
use crate::users::{Caller, Users};

// Refusals of the gate. Each says what the server did not do: clients and the log put "failed to"
// before it, and answers to browsers "The server refused to".
pub(crate) const OTHER_USER: &str = "let the caller in: this server accepts only the user that \
     started it, and another user of this machine has sent the call; start the server with \
     --token-file, or with --insecure-loopback if all users of the machine may do everything";
pub(crate) const NO_TOKEN: &str = "let the caller in without a token: name a --token-file (the \
     token is sent only over https:// or to this machine)";
pub(crate) const UNKNOWN_TOKEN: &str = "let the caller in: this server does not know the token";

/// Kind of the resource at a path, and the callers that are admitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resource {
    /// A gRPC call, made by programs over HTTP/2 and never by a page in a browser.
    Call(Allowed),
    /// A page, or a file that pages load. Reading it changes nothing but the log-in state.
    Page(Allowed),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Allowed {
    /// Everybody: the resource reveals nothing and changes nothing.
    Everybody,
    OneOf(&'static [Role]),
}

/// Middleware that puts a gate before a server's calls.
#[derive(Clone, Debug)]
pub struct Gate {
    shared: Arc<Shared>,
}

/// A server's calls behind a gate.
#[derive(Clone, Debug)]
pub struct Gated<S> {
    inner: S,
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    /// Accepted tokens; `None` requires no token, because only this machine can connect or because
    /// the operator chose `--insecure`.
    tokens: Option<Tokens>,
    users: Users,
    resource: fn(&str) -> Resource,
    /// Path of the log-in page; `None` for a server without pages.
    log_in: Option<&'static str>,
    sessions: BrowserSessions,
    rates: Mutex<Rates>,
    refusals: Mutex<Refusals>,
}

impl Gate {
    /// Creates a gate that accepts connections of `users` and, if there are tokens, requires one.
    pub(crate) fn new(
        tokens: Option<Tokens>,
        users: Users,
        resource: fn(&str) -> Resource,
        log_in: Option<&'static str>,
        sessions: BrowserSessions,
    ) -> Gate {
        Gate {
            shared: Arc::new(Shared {
                tokens,
                users,
                resource,
                log_in,
                sessions,
                rates: Mutex::default(),
                refusals: Mutex::default(),
            }),
        }
    }
}

impl<S> Layer<S> for Gate {
    type Service = Gated<S>;

    fn layer(&self, inner: S) -> Gated<S> {
        Gated { inner, shared: Arc::clone(&self.shared) }
    }
}

impl<S, B> Service<Request<B>> for Gated<S>
where
    S: Service<Request<B>, Response = Response<Body>>,
    S::Future: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = BoxFuture<Response<Body>, S::Error>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: Request<B>) -> Self::Future {
        let caller = address(&request);
        let shared = Arc::clone(&self.shared);
        let path = request.uri().path().to_owned();
        if let Err(status) = shared.admit(caller, &request) {
            shared.log_refusal(caller, &path, status.code(), status.message());
            let answer = match (shared.resource)(&path) {
                Resource::Page(_) => browser::refusal(&status, &request, shared.log_in),
                Resource::Call(_) if browser::is_grpc(request.headers()) => status.into_http(),
                Resource::Call(_) => browser::refusal(&status, &request, None),
            };
            return Box::pin(async move { Ok(answer) });
        }
        let answer = self.inner.call(request);
        Box::pin(async move {
            let answer = answer.await?;
            if answer.status() == StatusCode::UNAUTHORIZED {
                let reason = "log in: this server does not know the token";
                shared.log_refusal(caller, &path, Code::Unauthenticated, reason);
            }
            let Some(status) = Status::from_header_map(answer.headers()) else {
                return Ok(answer);
            };
            if is_refusal(status.code()) {
                shared.log_refusal(caller, &path, status.code(), status.message());
            }
            Ok(match truncated(status.message()) {
                Some(message) => Status::new(status.code(), message).into_http(),
                None => answer,
            })
        })
    }
}

impl Shared {
    fn admit<B>(&self, caller: SocketAddr, request: &Request<B>) -> Result<(), Status> {
        if !lock(&self.rates).admit(caller, Instant::now()) {
            return Err(Status::resource_exhausted(format!(
                "answer more than {MAX_REQUESTS_PER_SEC} requests per second over one connection"
            )));
        }
        if self.users == Users::Own && !self::caller(request).is_some_and(Caller::is_own) {
            return Err(Status::permission_denied(OTHER_USER));
        }
        let resource = (self.resource)(request.uri().path());
        let allowed = match resource {
            Resource::Call(allowed) => {
                browser::check_call(request)?;
                allowed
            }
            Resource::Page(allowed) => {
                browser::check_page(request, self.tokens.is_some())?;
                allowed
            }
        };
        if let Some(tokens) = &self.tokens {
            // A resource for everybody admits nobody.
            let Allowed::OneOf(roles) = allowed else { return Ok(()) };
            self.check_role(
                tokens,
                roles,
                matches!(resource, Resource::Page(_)),
                request.headers(),
            )?;
        }
        if let Some(caller) = self::caller(request) {
            caller.admit();
        }
        Ok(())
    }

    fn check_role(
        &self,
        tokens: &Tokens,
        roles: &[Role],
        is_page: bool,
        headers: &HeaderMap,
    ) -> Result<(), Status> {
        if is_page && roles.contains(&Role::Viewer) && self.sessions.has_session(headers) {
            return Ok(());
        }
        let token = bearer(headers).ok_or_else(|| Status::unauthenticated(NO_TOKEN))?;
        match tokens.role_of(token) {
            None => Err(Status::unauthenticated(UNKNOWN_TOKEN)),
            Some(role) if roles.contains(&role) => Ok(()),
            Some(role) => Err(Status::permission_denied(format!(
                "answer a {role}: this path requires the token of {}",
                roles.iter().map(|role| role.name()).collect::<Vec<_>>().join(" or ")
            ))),
        }
    }

    fn log_refusal(&self, caller: SocketAddr, path: &str, code: Code, reason: &str) {
        if lock(&self.refusals).must_log(caller.ip(), code, Instant::now()) {
            let path = path.escape_debug().take(MAX_LOGGED_CHARS);
            let reason = reason.escape_debug().take(MAX_LOGGED_CHARS);
            let (path, reason) = (path.collect::<String>(), reason.collect::<String>());
            let reason = match reason.is_empty() {
                // The router's own status, which has no message.
                true => "find this call".to_owned(),
                false => reason,
            };
            tracing::warn!(
                "a request from {} for `{path}` was refused: failed to {reason} (further refusals of \
                 this kind to this address are not logged for ten minutes)",
                caller.ip()
            );
        }
    }
}

/// Longest part of a caller's text in the log, characters.
const MAX_LOGGED_CHARS: usize = 300;
/// Longest message of a status, characters. The message is sent in a header, so one that quotes a
/// megabyte of the request would break the connection.
const MAX_STATUS_CHARS: usize = 2_000;

/// Returns the start of a message that is too long for a status; `None` if it is not too long.
fn truncated(message: &str) -> Option<String> {
    let (end, _) = message.char_indices().nth(MAX_STATUS_CHARS)?;
    Some(format!("{}…", &message[..end]))
}

fn caller<B>(request: &Request<B>) -> Option<&Caller> {
    let extensions = request.extensions();
    let plain = extensions.get::<Caller>();
    let tls = extensions.get::<TlsConnectInfo<Caller>>();
    plain.or_else(|| tls.map(TlsConnectInfo::get_ref))
}

fn address<B>(request: &Request<B>) -> SocketAddr {
    let address = caller(request).and_then(Caller::address);
    address.unwrap_or((IpAddr::from(Ipv4Addr::UNSPECIFIED), 0).into())
}

fn bearer(headers: &HeaderMap) -> Option<&str> {
    let value = headers.get(header::AUTHORIZATION)?.to_str().ok()?;
    value.strip_prefix("Bearer ")
}

/// Returns true if the caller caused a call to fail. Faults of the server are logged where they
/// occur.
fn is_refusal(code: Code) -> bool {
    matches!(
        code,
        Code::InvalidArgument
            | Code::OutOfRange
            | Code::PermissionDenied
            | Code::Unauthenticated
            | Code::Unimplemented
    )
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // No thread panics while it holds one of these locks.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_messages_of_more_than_the_longest_number_of_characters_are_truncated() {
        let longest = "é".repeat(MAX_STATUS_CHARS);
        assert_eq!(truncated(&longest), None);
        assert_eq!(truncated(&format!("{longest}x")), Some(longest + "…"));
    }
}
