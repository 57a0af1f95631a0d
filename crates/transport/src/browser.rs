//! Gate rules for browsers: session ids in cookies, because browsers do not send `Authorization` on
//! their own; refusals as redirects and text instead of gRPC statuses; and protection against
//! cross-site requests from other pages in the same browser.
//!
//! A browser sends requests on behalf of any page that its user visits, with cookies and from
//! inside the firewall. `Origin` and `Sec-Fetch-…` headers, which no page can omit or forge,
//! distinguish such requests from a program's. A page also cannot, without the server's consent,
//! use HTTP/2 without TLS, a content type like gRPC's, or a header like `Authorization`. Calls
//! require HTTP/2 and gRPC's content type, and no `Origin` or `Sec-Fetch-Site` header, so that
//! no page can make a call.

use std::net::IpAddr;

use tonic::body::Body;
use tonic::codegen::http::{
    HeaderMap, HeaderName, Method, Request, Response, StatusCode, Version, header,
};
use tonic::{Code, Status};

/// Longest path that a log-in redirects to, bytes.
const MAX_NEXT_BYTES: usize = 512;
/// Longest session id that is looked up, bytes.
const MAX_SESSION_BYTES: usize = 64;
/// Headers that report how the requesting page's origin relates to the server's, and the mode and
/// the destination of the request. Browsers send these three with every request to a trustworthy
/// address, loopback included.
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");
const FETCH_MODE: HeaderName = HeaderName::from_static("sec-fetch-mode");
const FETCH_DEST: HeaderName = HeaderName::from_static("sec-fetch-dest");

/// Session cookie of one server. Browsers share cookies between the ports of a host, so each server
/// draws a cookie name at its start; otherwise two servers would log each other's users out.
#[derive(Clone, Debug)]
pub(crate) struct SessionCookie {
    name: String,
    is_encrypted: bool,
}

impl SessionCookie {
    /// Creates the cookie of a server, whose name ends with `suffix`. Over TLS, the name's prefix
    /// `__Host-` makes browsers reject a cookie set by another host or over plain HTTP.
    pub(crate) fn new(suffix: &str, is_encrypted: bool) -> SessionCookie {
        let prefix = if is_encrypted { "__Host-" } else { "" };
        SessionCookie { name: format!("{prefix}rollout_session_{suffix}"), is_encrypted }
    }

    /// Returns the `Set-Cookie` value that stores a session id for `secs` seconds. The cookie is
    /// inaccessible to scripts and other sites, and is sent only over TLS if this server uses TLS.
    pub(crate) fn set(&self, session: &str, secs: u64) -> String {
        let secure = if self.is_encrypted { "; Secure" } else { "" };
        let name = &self.name;
        format!("{name}={session}; Path=/; Max-Age={secs}; HttpOnly; SameSite=Strict{secure}")
    }

    pub(crate) fn session<'a>(&self, headers: &'a HeaderMap) -> Option<&'a str> {
        let cookies = headers.get_all(header::COOKIE).iter();
        let pairs = cookies.filter_map(|cookies| cookies.to_str().ok());
        let mut pairs = pairs.flat_map(|cookies| cookies.split(';'));
        let found = pairs.find_map(|pair| pair.trim().strip_prefix(&self.name)?.strip_prefix('='));
        found.filter(|session| session.len() <= MAX_SESSION_BYTES)
    }
}

/// Returns true if a request's content type is gRPC's: `application/grpc`, alone or with a suffix
/// or parameters. `application/grpc-web`, which pages can send, does not count.
pub(crate) fn is_grpc(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE).map(|kind| kind.as_bytes());
    let rest = kind.and_then(|kind| kind.strip_prefix(b"application/grpc"));
    rest.is_some_and(|rest| matches!(rest.first(), None | Some(b'+' | b';' | b' ')))
}

/// Refuses a call that is not gRPC over HTTP/2, or that a browser sends for a page.
pub(crate) fn check_call<B>(request: &Request<B>) -> Result<(), Status> {
    let headers = request.headers();
    if headers.contains_key(header::ORIGIN) || headers.contains_key(FETCH_SITE) {
        return Err(Status::permission_denied(
            "accept a call from a page in a browser: use `coordinator` or the Python client",
        ));
    }
    if request.version() != Version::HTTP_2 {
        return Err(Status::invalid_argument("accept a call over HTTP/1: gRPC is HTTP/2"));
    }
    match is_grpc(headers) && request.method() == Method::POST {
        true => Ok(()),
        false => Err(Status::invalid_argument(
            "accept a call that is not gRPC: it must be a POST of application/grpc",
        )),
    }
}

/// Refuses a cross-site request for a page, unless the user followed a link. If no token is
/// required, also refuses a host name that somebody could own on the Internet: a page could rebind
/// its own DNS name to an address of this machine, and the browser would treat this server as
/// same-origin with that page.
pub(crate) fn check_page<B>(request: &Request<B>, asks_for_tokens: bool) -> Result<(), Status> {
    let host = host(request);
    // Browsers use HTTP/2 only over TLS, where the certificate covers the name.
    let may_be_rebound = request.version() < Version::HTTP_2 && !asks_for_tokens;
    if may_be_rebound && !is_private_name(host) {
        return Err(Status::permission_denied(
            "answer under this host name without requiring tokens: use the numeric address or a \
             name without dots, or give the server a --token-file",
        ));
    }
    match is_own_origin(request.headers(), host) && !is_foreign_fetch(request) {
        true => Ok(()),
        false => Err(Status::permission_denied(
            "answer the page of another site: open this server's own pages",
        )),
    }
}

fn host<B>(request: &Request<B>) -> &str {
    let named = request.headers().get(header::HOST);
    let named = named.and_then(|host| host.to_str().ok());
    let authority = request.uri().authority().map(|authority| authority.as_str());
    named.or(authority).unwrap_or_default()
}

/// Returns false if the request's `Origin` is another site. Schemes are not compared, since a
/// server behind a TLS proxy does not know the scheme of its address.
fn is_own_origin(headers: &HeaderMap, host: &str) -> bool {
    let mut origins = headers.get_all(header::ORIGIN).iter();
    origins.all(|origin| {
        let origin = origin.to_str().unwrap_or_default();
        let authority = origin.split_once("://").map(|(_, authority)| authority);
        authority.is_some_and(|authority| authority.eq_ignore_ascii_case(host))
    })
}

/// Returns true if the browser reports that a page of another origin caused the request, unless the
/// user followed a link. Another port of the same host is another origin.
fn is_foreign_fetch<B>(request: &Request<B>) -> bool {
    let has_value = |name: HeaderName, value: &str| {
        let sent = request.headers().get(name);
        sent.is_some_and(|sent| sent.as_bytes() == value.as_bytes())
    };
    let is_foreign = request.headers().contains_key(FETCH_SITE)
        && !has_value(FETCH_SITE, "same-origin")
        && !has_value(FETCH_SITE, "none");
    let is_link = matches!(*request.method(), Method::GET | Method::HEAD)
        && has_value(FETCH_MODE, "navigate")
        && has_value(FETCH_DEST, "document");
    is_foreign && !is_link
}

/// Returns true if a `Host` is a numeric address or a name without dots.
fn is_private_name(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    name.parse::<IpAddr>().is_ok() || (!name.is_empty() && !name.contains('.'))
}

/// Returns the HTTP response that refuses a request other than a gRPC call: a redirect to the
/// log-in form at `log_in` if a browser's user must log in first, otherwise a line of text.
pub(crate) fn refusal<B>(
    status: &Status,
    request: &Request<B>,
    log_in: Option<&str>,
) -> Response<Body> {
    let headers = request.headers();
    let accepts = headers.get(header::ACCEPT);
    let reads_pages = accepts.is_some_and(|kinds| {
        let kinds = String::from_utf8_lossy(kinds.as_bytes());
        kinds.contains("text/html")
    });
    let must_log_in = status.code() == Code::Unauthenticated;
    if let Some(log_in) = log_in
        && must_log_in
        && reads_pages
        && request.method() == Method::GET
    {
        let next = request.uri().path_and_query().map_or("/", |next| next.as_str());
        let target = match next.len() {
            ..=MAX_NEXT_BYTES => format!("{log_in}?next={}", escaped(next)),
            _ => log_in.to_owned(),
        };
        return answer(StatusCode::SEE_OTHER, &[(header::LOCATION, &target)], "");
    }
    let code = match status.code() {
        Code::Unauthenticated => StatusCode::UNAUTHORIZED,
        Code::PermissionDenied => StatusCode::FORBIDDEN,
        Code::ResourceExhausted => StatusCode::TOO_MANY_REQUESTS,
        _ => StatusCode::BAD_REQUEST,
    };
    let text = format!("The server refused to {}.\n", status.message());
    match must_log_in {
        true => answer(code, &[(header::WWW_AUTHENTICATE, "Bearer")], &text),
        false => answer(code, &[], &text),
    }
}

fn answer(code: StatusCode, headers: &[(HeaderName, &str)], text: &str) -> Response<Body> {
    let mut answer = Response::new(Body::new(text.to_owned()));
    *answer.status_mut() = code;
    let kind = (header::CONTENT_TYPE, "text/plain; charset=utf-8");
    let store = (header::CACHE_CONTROL, "no-store");
    for (name, value) in [kind, store].iter().chain(headers) {
        if let Ok(value) = value.parse() {
            answer.headers_mut().insert(name, value);
        }
    }
    answer
}

/// Percent-encodes text for a query value: everything but letters, digits and `/-_.`.
fn escaped(text: &str) -> String {
    let mut escaped = String::new();
    for byte in text.bytes() {
        match byte.is_ascii_alphanumeric() || b"/-_.".contains(&byte) {
            true => escaped.push(char::from(byte)),
            false => escaped.push_str(&format!("%{byte:02X}")),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use std::future::poll_fn;
    use std::pin::Pin;

    use tonic::codegen::Body as _;

    use super::*;
    use crate::gate::{NO_TOKEN, OTHER_USER, UNKNOWN_TOKEN};

    fn request(version: Version, headers: &[(HeaderName, &str)]) -> Request<()> {
        let mut request = Request::builder().version(version).uri("/campaigns/a?b=c&d");
        for (name, value) in headers {
            request = request.header(name, *value);
        }
        request.body(()).expect("a request")
    }

    #[test]
    fn a_session_id_is_read_only_from_this_servers_cookie() {
        let cookie = SessionCookie::new("aa", true);
        let set = cookie.set("0123", 60);
        assert_eq!(
            set,
            "__Host-rollout_session_aa=0123; Path=/; Max-Age=60; HttpOnly; SameSite=Strict; Secure"
        );
        let pair = set.split(';').next().expect("a pair");
        let sent = format!("theme=dark; {pair}; other=1");
        let sent = request(Version::HTTP_11, &[(header::COOKIE, &sent)]);
        assert_eq!(cookie.session(sent.headers()), Some("0123"));
        for other in [("ab", true), ("aa", false)] {
            let other = SessionCookie::new(other.0, other.1);
            assert_eq!(other.session(sent.headers()), None);
        }
        let long = format!("__Host-rollout_session_aa={}", "0".repeat(65));
        let sent = request(Version::HTTP_11, &[(header::COOKIE, &long)]);
        assert_eq!(cookie.session(sent.headers()), None);
    }

    #[test]
    fn without_tokens_a_public_host_name_is_refused() {
        let refused = |host: &str| {
            let request = request(Version::HTTP_11, &[(header::HOST, host)]);
            assert!(check_page(&request, true).is_ok(), "{host}");
            check_page(&request, false).is_err()
        };
        for private in ["127.0.0.1:7411", "localhost", "[::1]:7411", "10.0.0.7", "keeper:7411"] {
            assert!(!refused(private), "{private}");
        }
        for public in ["evil.example:7411", "127.0.0.1.evil.example", "", "keeper.lab"] {
            assert!(refused(public), "{public}");
        }
    }

    #[test]
    fn an_origin_is_own_if_its_host_is_the_requested_host() {
        let is_own = |origin: &str| {
            let headers = [(header::HOST, "Keeper:7411"), (header::ORIGIN, origin)];
            check_page(&request(Version::HTTP_11, &headers), true).is_ok()
        };
        assert!(is_own("http://keeper:7411") && is_own("https://keeper:7411"));
        for foreign in ["http://keeper:8888", "http://keeper", "null", "", "keeper:7411"] {
            assert!(!is_own(foreign), "{foreign}");
        }
    }

    #[tokio::test]
    async fn browsers_are_redirected_to_the_log_in_and_programs_get_text() {
        let status = Status::unauthenticated(NO_TOKEN);
        let browser = request(Version::HTTP_11, &[(header::ACCEPT, "text/html,*/*")]);
        let answer = refusal(&status, &browser, Some("/login"));
        assert_eq!(answer.status(), StatusCode::SEE_OTHER);
        let target = &answer.headers()[header::LOCATION];
        assert_eq!(target, "/login?next=/campaigns/a%3Fb%3Dc%26d");
        let program = refusal(&status, &request(Version::HTTP_11, &[]), Some("/login"));
        assert_eq!(program.status(), StatusCode::UNAUTHORIZED);
        assert_eq!(program.headers()[header::WWW_AUTHENTICATE], "Bearer");
        let without_log_in = refusal(&status, &browser, None);
        assert_eq!(without_log_in.status(), StatusCode::UNAUTHORIZED);
        for message in [NO_TOKEN, UNKNOWN_TOKEN, OTHER_USER] {
            let refused = refusal(&Status::unauthenticated(message), &browser, None);
            let mut body = refused.into_body();
            let frame = poll_fn(|context| Pin::new(&mut body).poll_frame(context)).await;
            let bytes = frame.expect("a text").expect("whole").into_data();
            let text = String::from_utf8(bytes.expect("data").to_vec()).expect("UTF-8");
            let expected = "The server refused to let the caller in";
            assert!(text.starts_with(expected), "{text}");
        }
    }
}
