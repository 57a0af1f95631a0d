//! What goes wrong with a request, as a page that says what to do.

use std::error::Error;

use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use maud::{Markup, html};
use queue::{QueueError, StoreError};
use transport::chain;

use super::{answer, layout};
use crate::report::ReportError;

/// A request that is not met.
#[derive(Debug)]
pub(super) enum Problem {
    /// No page has this address.
    Page,
    /// The address is too long to be one of this program's.
    Address,
    /// A part of the query is no value that it can have.
    Query(&'static str),
    /// There is no such campaign, or no longer.
    Campaign(String),
    /// The campaign has no such rollout.
    Rollout {
        /// The campaign.
        campaign: String,
        /// What was asked for.
        rollout: String,
    },
    /// No video is kept of the rollout.
    Video,
    /// Too many pages are open.
    TooManyStreams,
    /// The database, or something that should not fail, failed; in words.
    Failed(String),
}

impl Problem {
    /// Something failed that the operator must know of.
    pub(super) fn failed(error: &(dyn Error + 'static)) -> Problem {
        let text = chain(error);
        tracing::error!("failed to {text}");
        Problem::Failed(text)
    }

    fn code(&self) -> StatusCode {
        match self {
            Problem::Page | Problem::Campaign(_) | Problem::Rollout { .. } | Problem::Video => {
                StatusCode::NOT_FOUND
            }
            Problem::Address | Problem::Query(_) => StatusCode::BAD_REQUEST,
            Problem::TooManyStreams | Problem::Failed(_) => StatusCode::SERVICE_UNAVAILABLE,
        }
    }

    fn title(&self) -> &'static str {
        match self {
            Problem::Page => "There is no such page",
            Problem::Address | Problem::Query(_) => "This address is wrong",
            Problem::Campaign(_) => "There is no such campaign",
            Problem::Rollout { .. } => "There is no such rollout",
            Problem::Video => "There is no such video",
            Problem::TooManyStreams => "Too many pages are open",
            Problem::Failed(_) => "This cannot be shown now",
        }
    }

    fn words(&self) -> Markup {
        match self {
            Problem::Page => html! { "Nothing is at this address." },
            Problem::Address => html! { "It is longer than any address of this program." },
            Problem::Query(what) => html! { (what) },
            Problem::Campaign(name) => html! {
                "No campaign is called " code { (name) } " here. If there was one, it has been \
                deleted, with its results and files."
            },
            Problem::Rollout { campaign, rollout } => html! {
                "Campaign " code { (campaign) } " has no rollout " code { (rollout) } ". "
                a href={ "/campaigns/" (campaign) "/rollouts" } { "Its rollouts" } "."
            },
            Problem::Video => html! {
                "No video is kept of this rollout: what a campaign records is said when it is \
                created (" code { "--record" } ")."
            },
            Problem::TooManyStreams => html! {
                "This page looks again by itself now and then, instead of at once."
            },
            Problem::Failed(text) => html! {
                "The coordinator failed to " (text) ". Nothing is lost by that; its log says more. \
                Reload to try again."
            },
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let title = self.title();
        let main = html! {
            h1 { (title) }
            p { (self.words()) }
            p { a href="/" { "All campaigns" } }
        };
        answer::page(self.code(), layout::still(title, &main).into_string())
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Problem {
        Problem::failed(&error)
    }
}

impl From<QueueError> for Problem {
    fn from(error: QueueError) -> Problem {
        match error {
            QueueError::UnknownCampaign { campaign } => Problem::Campaign(campaign.to_string()),
            error => Problem::failed(&error),
        }
    }
}

impl From<ReportError> for Problem {
    fn from(error: ReportError) -> Problem {
        match error {
            ReportError::Queue(error) => error.into(),
            error => Problem::failed(&error),
        }
    }
}
