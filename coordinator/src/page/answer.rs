//! Answers to browsers: a page with its headers, and the few files that pages need. No page may
//! load anything from elsewhere, or run a script that is not this program's.

use std::sync::LazyLock;

use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};

/// The pages' style, after the report's.
const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("page.js");
const ICON: &str = include_str!("icon.svg");

/// Sources that a page may load from, and targets of its forms.
const CONTENT_POLICY: &str = "default-src 'none'; style-src 'self'; script-src 'self'; \
    img-src 'self'; media-src 'self'; connect-src 'self'; form-action 'self'; base-uri 'none'; \
    frame-ancestors 'none'";

/// Headers of every page.
const HEADERS: [(HeaderName, &str); 5] = [
    (header::CONTENT_TYPE, "text/html; charset=utf-8"),
    (header::CONTENT_SECURITY_POLICY, CONTENT_POLICY),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "same-origin"),
    (header::CACHE_CONTROL, "no-store"),
];

/// Changes with this program's style and script, so that browsers may keep them
/// for long and never mix two versions.
pub(super) static FILES_VERSION: LazyLock<String> =
    LazyLock::new(|| short_digest(&[report::STYLE, STYLE, SCRIPT, ICON].concat()));

/// A page that was made.
#[derive(Debug)]
pub(super) struct Rendered {
    html: Bytes,
    /// Its digest, as an entity tag.
    tag: String,
    /// The edition of everything that it was made from.
    pub(super) version: u64,
}

impl Rendered {
    pub(super) fn new(html: String, version: u64) -> Rendered {
        Rendered {
            tag: format!("\"{}\"", short_digest(&html)),
            html: html.into(),
            version,
        }
    }

    /// The page, unless the browser has it already.
    pub(super) fn answer(&self, headers: &HeaderMap) -> Response {
        let known = headers.get(header::IF_NONE_MATCH);
        if known.is_some_and(|known| known.as_bytes() == self.tag.as_bytes()) {
            return (StatusCode::NOT_MODIFIED, HEADERS).into_response();
        }
        let tag = [(header::ETAG, self.tag.clone())];
        (HEADERS, tag, self.html.clone()).into_response()
    }
}

/// A page that is made for one browser.
pub(super) fn page(code: StatusCode, html: String) -> Response {
    (code, HEADERS, html).into_response()
}

pub(super) async fn style() -> Response {
    file("text/css; charset=utf-8", [report::STYLE, STYLE].concat())
}

pub(super) async fn script() -> Response {
    file("text/javascript; charset=utf-8", SCRIPT.to_owned())
}

pub(super) async fn icon() -> Response {
    file("image/svg+xml", ICON.to_owned())
}

fn file(kind: &'static str, text: String) -> Response {
    let headers = [
        (header::CONTENT_TYPE, kind),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::CACHE_CONTROL, "public, max-age=31536000, immutable"),
    ];
    (headers, text).into_response()
}

/// The first 16 hex digits of a text's SHA-256.
fn short_digest(text: &str) -> String {
    let digest = Sha256::digest(text);
    digest[..8]
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the selectors of a style sheet's rules.
    fn selectors(style: &str) -> impl Iterator<Item = &str> {
        let heads = style.lines().filter_map(|line| line.split_once('{'));
        heads.flat_map(|(selectors, _)| selectors.split(','))
    }

    /// A page's `.bar{width:100%}` once drew every bar of the figures from edge to edge.
    #[test]
    fn no_rule_of_the_pages_reaches_into_a_figure() {
        let of_figures = |class: &str| {
            let within = format!(".panel .{class}");
            selectors(report::figures::STYLE).any(|it| it == within)
        };
        let classes = selectors(STYLE).filter_map(|it| it.strip_prefix('.'));
        let alone = classes.filter(|it| it.chars().all(|c| c.is_alphanumeric() || c == '-'));
        let mut reaching = alone.filter(|class| of_figures(class));
        assert_eq!(reaching.next(), None);
        assert!(of_figures("bar"), "the figures' rules are not found");
    }
}
