//! Login and logout: a valid token starts a session, whose id the browser keeps in a cookie.
//! `transport` decides which pages a session may read.

use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use maud::html;

use super::state::Page;
use super::{answer, layout};
use crate::access::{LOG_IN, READERS};

/// Longest accepted form, bytes.
const MAX_FORM_BYTES: usize = 4_096;

/// Serves the login form, or redirects if the server requires no tokens.
pub(super) async fn form(State(page): State<Arc<Page>>, uri: Uri) -> Response {
    let next = next(uri.query().unwrap_or_default().as_bytes());
    match page.security.asks_for_tokens() {
        true => show(StatusCode::OK, &next, ""),
        false => redirect(&next, None),
    }
}

/// Checks the token and redirects to the page that was requested before the login; shows the form
/// again if the token is invalid.
pub(super) async fn submit(State(page): State<Arc<Page>>, body: Bytes) -> Response {
    if body.len() > MAX_FORM_BYTES {
        let message = "This text is longer than any token.";
        return show(StatusCode::PAYLOAD_TOO_LARGE, "/", message);
    }
    let next = next(&body);
    let token = field(&body, "token");
    match page.security.log_in(token.trim(), &READERS) {
        Some(cookie) => redirect(&next, Some(cookie)),
        None => {
            let message = "This is no token of a viewer or an operator of this coordinator.";
            show(StatusCode::UNAUTHORIZED, &next, message)
        }
    }
}

/// Ends the browser's session.
pub(super) async fn log_out(State(page): State<Arc<Page>>, headers: HeaderMap) -> Response {
    redirect(LOG_IN, Some(page.security.log_out(&headers)))
}

/// Renders the login form with an error message, which may be empty.
fn show(code: StatusCode, next: &str, message: &str) -> Response {
    let main = html! {
        h1 { "Log in" }
        form.log-in method="post" action=(LOG_IN) {
            input type="hidden" name="next" value=(next);
            label for="token" { "Token of a viewer or an operator" }
            input #token type="password" name="token" required autocomplete="current-password"
                autofocus aria-describedby="why";
            p #why role="alert" { (message) }
            button { "Log in" }
        }
        p.muted {
            "A token is the second word of a line of the coordinator's token file. If you are \
            logged in already and followed another site's link: " a href=(next) { "Continue" } "."
        }
    };
    answer::page(code, layout::static_page("Log in", &main).into_string())
}

fn redirect(address: &str, cookie: Option<String>) -> Response {
    let cookie = cookie.map(|cookie| [(header::SET_COOKIE, cookie)]);
    let headers = [(header::LOCATION, address), (header::CACHE_CONTROL, "no-store")];
    (StatusCode::SEE_OTHER, headers, cookie, ()).into_response()
}

/// Returns the `next` address of a form or query if it is a path on this server, otherwise `/`. A
/// redirect to another server would be an open redirect.
fn next(form: &[u8]) -> String {
    let next = field(form, "next");
    let mut bytes = next.bytes();
    let is_local_path = next.starts_with('/')
        && !next.starts_with("//")
        && bytes.all(|byte| byte.is_ascii_graphic() && byte != b'\\');
    if is_local_path { next } else { "/".to_owned() }
}

/// Returns a form field; empty if absent.
fn field(form: &[u8], name: &str) -> String {
    let mut fields = form_urlencoded::parse(form);
    let field = fields.find(|(key, _)| key == name);
    field.map_or_else(String::new, |(_, value)| value.into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn login_redirects_only_within_this_server() {
        assert_eq!(next(b"next=%2Fcampaigns%2Fdemo%3Fa%3Db"), "/campaigns/demo?a=b");
        for foreign in ["//evil.example", "https://evil.example", "/%5Cevil.example", "/a%0Ab", ""]
        {
            assert_eq!(next(format!("next={foreign}").as_bytes()), "/", "{foreign}");
        }
    }
}
