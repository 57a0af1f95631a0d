//! What browsers need of a gate: a token in a cookie, because a browser sends no
//! `Authorization` by itself; refusals as pages and texts instead of gRPC
//! statuses; and the rules that keep another site's page, open in the same
//! browser, away from a server that requires no token. What a page shows is its
//! server's business.

use std::net::IpAddr;

use tonic::body::Body;
use tonic::codegen::http::{HeaderMap, Method, Request, Response, StatusCode, Version, header};
use tonic::{Code, Status};

use crate::token::MAX_TOKEN_BYTES;

/// The cookie that holds a token.
const COOKIE: &str = "rollout_token";
/// How long a browser keeps it, seconds: a month.
const COOKIE_SECS: u32 = 30 * 24 * 3600;
/// Longest path that a log-in leads back to, bytes.
const MAX_NEXT_BYTES: usize = 512;

/// The `Set-Cookie` that keeps a token in a browser: out of reach of scripts
/// and of other sites, and over TLS sent over TLS only.
pub(crate) fn cookie(token: &str, is_encrypted: bool) -> String {
    // In hex, because tokens may hold what a cookie may not.
    let hex: String = token.bytes().map(|byte| format!("{byte:02x}")).collect();
    set_cookie(&hex, COOKIE_SECS, is_encrypted)
}

/// The `Set-Cookie` that makes a browser forget its token.
pub(crate) fn forgotten(is_encrypted: bool) -> String {
    set_cookie("", 0, is_encrypted)
}

/// The token in a request's cookies.
pub(crate) fn token(headers: &HeaderMap) -> Option<String> {
    let cookies = headers.get_all(header::COOKIE).iter();
    let pairs = cookies.filter_map(|cookies| cookies.to_str().ok());
    let mut pairs = pairs.flat_map(|cookies| cookies.split(';'));
    let hex = pairs.find_map(|pair| pair.trim().strip_prefix(COOKIE)?.strip_prefix('='))?;
    if hex.len() > 2 * MAX_TOKEN_BYTES || !hex.is_ascii() {
        return None;
    }
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    let bytes = hex.as_bytes().chunks(2).map(byte).collect::<Option<_>>()?;
    String::from_utf8(bytes).ok()
}

/// Whether a request is a gRPC call.
pub(crate) fn is_grpc(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE);
    kind.is_some_and(|kind| kind.as_bytes().starts_with(b"application/grpc"))
}

/// Refuses what another site's page could make a browser send. Browsers speak
/// HTTP/1 without TLS, and a page on the Internet can let its own name lead to
/// an address of this machine or network: then the browser takes this server
/// for that page's own. So calls take HTTP/2, which is what gRPC is, and where
/// no token is required, the name that the browser used must be one that cannot
/// be owned on the Internet.
pub(crate) fn check<B>(request: &Request<B>, asks_for_tokens: bool) -> Result<(), Status> {
    if request.version() >= Version::HTTP_2 {
        return Ok(());
    }
    if is_grpc(request.headers()) {
        return Err(Status::invalid_argument(
            "take a call over HTTP/1: gRPC is HTTP/2",
        ));
    }
    let host = request.headers().get(header::HOST);
    let host = host.and_then(|host| host.to_str().ok()).unwrap_or_default();
    match asks_for_tokens || is_private_name(host) {
        true => Ok(()),
        false => Err(Status::permission_denied(
            "answer under this name without asking for tokens: use the address in numbers or a \
             name without dots, or give the server a --token-file",
        )),
    }
}

/// Whether a `Host` is an address in numbers or a name without dots.
fn is_private_name(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    name.parse::<IpAddr>().is_ok() || (!name.is_empty() && !name.contains('.'))
}

/// A refusal for a caller that does not speak gRPC: a browser that must log in is
/// redirected to the form, any other caller gets a line of text.
pub(crate) fn refusal<B>(status: &Status, request: &Request<B>, log_in: &str) -> Response<Body> {
    let headers = request.headers();
    let accepts = headers.get(header::ACCEPT);
    let reads_pages = accepts.is_some_and(|kinds| {
        let kinds = String::from_utf8_lossy(kinds.as_bytes());
        kinds.contains("text/html")
    });
    let must_log_in = status.code() == Code::Unauthenticated;
    if must_log_in && reads_pages && request.method() == Method::GET {
        let next = request
            .uri()
            .path_and_query()
            .map_or("/", |next| next.as_str());
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

fn answer(code: StatusCode, headers: &[(header::HeaderName, &str)], text: &str) -> Response<Body> {
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

/// As the value of a query: everything but letters, digits and `/-_.` in
/// percent.
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

fn set_cookie(value: &str, secs: u32, is_encrypted: bool) -> String {
    let secure = if is_encrypted { "; Secure" } else { "" };
    format!("{COOKIE}={value}; Path=/; Max-Age={secs}; HttpOnly; SameSite=Strict{secure}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(version: Version, headers: &[(header::HeaderName, &str)]) -> Request<()> {
        let mut request = Request::builder()
            .version(version)
            .uri("/campaigns/a?b=c&d");
        for (name, value) in headers {
            request = request.header(name, *value);
        }
        request.body(()).expect("a request")
    }

    #[test]
    fn a_token_of_any_characters_comes_back_from_its_cookie() {
        let secret = r#"a;b,"c\d=e0123456789"#;
        let set = cookie(secret, true);
        assert!(
            set.ends_with("; HttpOnly; SameSite=Strict; Secure"),
            "{set}"
        );
        let pair = set.split(';').next().expect("a pair");
        let sent = format!("theme=dark; {pair}; other=1");
        let sent = request(Version::HTTP_11, &[(header::COOKIE, &sent)]);
        assert_eq!(token(sent.headers()).as_deref(), Some(secret));
    }

    #[test]
    fn a_broken_cookie_is_no_token() {
        let long = format!("{COOKIE}={}", "61".repeat(MAX_TOKEN_BYTES + 1));
        for cookie in [
            "",
            "rollout_token",
            "rollout_token=6",
            "rollout_token=+1zz",
            &long,
        ] {
            let sent = request(Version::HTTP_11, &[(header::COOKIE, cookie)]);
            let found = token(sent.headers());
            assert!(found.is_none_or(|token| token.len() <= 1), "{cookie}");
        }
    }

    #[test]
    fn a_name_that_anybody_can_own_is_refused_where_nobody_is_asked_for_a_token() {
        let refused = |host: &str| {
            let request = request(Version::HTTP_11, &[(header::HOST, host)]);
            assert!(check(&request, true).is_ok(), "{host}");
            check(&request, false).is_err()
        };
        for own in [
            "127.0.0.1:7411",
            "localhost",
            "[::1]:7411",
            "10.0.0.7",
            "keeper:7411",
        ] {
            assert!(!refused(own), "{own}");
        }
        for foreign in [
            "evil.example:7411",
            "127.0.0.1.evil.example",
            "",
            "keeper.lab",
        ] {
            assert!(refused(foreign), "{foreign}");
        }
    }

    #[test]
    fn a_browser_cannot_make_a_call() {
        let call = [
            (header::HOST, "127.0.0.1:7411"),
            (header::CONTENT_TYPE, "application/grpc+proto"),
        ];
        assert!(check(&request(Version::HTTP_11, &call), true).is_err());
        assert!(check(&request(Version::HTTP_2, &call), false).is_ok());
    }

    #[test]
    fn people_are_led_to_the_log_in_and_programs_are_told() {
        let status = Status::unauthenticated("let you in");
        let person = request(Version::HTTP_11, &[(header::ACCEPT, "text/html,*/*")]);
        let answer = refusal(&status, &person, "/login");
        assert_eq!(answer.status(), StatusCode::SEE_OTHER);
        let target = &answer.headers()[header::LOCATION];
        assert_eq!(target, "/login?next=/campaigns/a%3Fb%3Dc%26d");
        let program = refusal(&status, &request(Version::HTTP_11, &[]), "/login");
        assert_eq!(program.status(), StatusCode::UNAUTHORIZED);
        assert_eq!(program.headers()[header::WWW_AUTHENTICATE], "Bearer");
    }
}
