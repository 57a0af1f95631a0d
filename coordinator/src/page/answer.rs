//! HTTP responses: pages with their security headers, and static files. The content security policy
//! forbids loading anything from other origins, and running scripts other than `page.js`.

use std::sync::LazyLock;

use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use sha2::{Digest, Sha256};

/// Style sheet of the pages, appended to the style sheet of reports.
const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("page.js");
const ICON: &str = include_str!("icon.svg");

/// Content security policy of every page.
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

/// Digest of the static files, part of their URLs: browsers may cache them for a year and never mix
/// two versions.
pub(super) static FILES_VERSION: LazyLock<String> =
    LazyLock::new(|| short_digest(&[report::STYLE, STYLE, SCRIPT, ICON].concat()));

/// Rendered page with its entity tag.
#[derive(Debug)]
pub(super) struct Rendered {
    html: Bytes,
    /// Entity tag: the quoted digest of the HTML.
    tag: String,
    /// Change counter (`Changes::version`) at the time of rendering.
    pub(super) version: u64,
}

impl Rendered {
    pub(super) fn new(html: String, version: u64) -> Rendered {
        Rendered { tag: format!("\"{}\"", short_digest(&html)), html: html.into(), version }
    }

    /// Returns the page, or 304 Not Modified if the browser has the same entity tag.
    pub(super) fn answer(&self, headers: &HeaderMap) -> Response {
        let entity_tag = headers.get(header::IF_NONE_MATCH);
        if entity_tag.is_some_and(|entity_tag| entity_tag.as_bytes() == self.tag.as_bytes()) {
            return (StatusCode::NOT_MODIFIED, HEADERS).into_response();
        }
        let tag = [(header::ETAG, self.tag.clone())];
        (HEADERS, tag, self.html.clone()).into_response()
    }
}

/// Returns a page that is rendered for one request and not cached.
pub(super) fn page(code: StatusCode, html: String) -> Response {
    (code, HEADERS, html).into_response()
}

pub(super) async fn style() -> Response {
    static_file("text/css; charset=utf-8", [report::STYLE, STYLE].concat())
}

pub(super) async fn script() -> Response {
    static_file("text/javascript; charset=utf-8", SCRIPT.to_owned())
}

pub(super) async fn icon() -> Response {
    static_file("image/svg+xml", ICON.to_owned())
}

fn static_file(media_type: &'static str, text: String) -> Response {
    let headers = [
        (header::CONTENT_TYPE, media_type),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::CACHE_CONTROL, "public, max-age=31536000, immutable"),
    ];
    (headers, text).into_response()
}

/// Returns the first 16 hex digits of a text's SHA-256.
fn short_digest(text: &str) -> String {
    hex::encode(&Sha256::digest(text)[..8])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the selectors of a style sheet's rules.
    fn selectors(style: &str) -> impl Iterator<Item = &str> {
        let rules = style.lines().filter_map(|line| line.split_once('{'));
        rules.flat_map(|(selectors, _)| selectors.split(','))
    }

    /// Regression: the page's `.bar{width:100%}` stretched every bar of the report's figures.
    #[test]
    fn page_styles_do_not_apply_to_figures() {
        let is_in_figures = |class: &str| {
            let within = format!(".panel .{class}");
            selectors(report::figures::STYLE).any(|selector| selector == within)
        };
        let classes = selectors(STYLE).filter_map(|selector| selector.strip_prefix('.'));
        let single_classes =
            classes.filter(|selector| selector.chars().all(|c| c.is_alphanumeric() || c == '-'));
        let mut conflicting = single_classes.filter(|class| is_in_figures(class));
        assert_eq!(conflicting.next(), None);
        assert!(is_in_figures("emergent"), "the figures' rules are not found");
    }
}
