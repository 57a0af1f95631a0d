//! Errors of a page request, rendered as a page with a remedy.

use std::error::Error;

use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use maud::{Markup, html};
use queue::QueueError;
use transport::chain;

use super::{answer, layout};
use crate::reading::ReadError;

#[derive(Clone, Debug)]
pub(super) enum Problem {
    /// No page has this address.
    Page,
    /// The address is longer than any address of this program.
    Address,
    Query(&'static str),
    /// The campaign does not exist or was deleted.
    Campaign(String),
    Renamed {
        /// The requested name.
        former: String,
        now: String,
    },
    /// The campaign has no such rollout.
    Rollout {
        campaign: String,
        /// The requested id.
        rollout: String,
    },
    /// The rollout has no video.
    Video,
    TooManyStreams,
    /// Internal error, such as a failure of the database; the text is shown and logged.
    Failed(String),
}

impl Problem {
    /// Logs an internal error and wraps its text.
    pub(super) fn failed(error: &(dyn Error + 'static)) -> Problem {
        let text = chain(error);
        tracing::error!("failed to {text}");
        Problem::Failed(text)
    }

    fn code_and_title(&self) -> (StatusCode, &'static str) {
        match self {
            Problem::Page => (StatusCode::NOT_FOUND, "There is no such page"),
            Problem::Address | Problem::Query(_) => {
                (StatusCode::BAD_REQUEST, "This address is wrong")
            }
            Problem::Campaign(_) => (StatusCode::NOT_FOUND, "There is no such campaign"),
            Problem::Renamed { .. } => (StatusCode::NOT_FOUND, "This campaign was renamed"),
            Problem::Rollout { .. } => (StatusCode::NOT_FOUND, "There is no such rollout"),
            Problem::Video => (StatusCode::NOT_FOUND, "There is no such video"),
            Problem::TooManyStreams => (StatusCode::SERVICE_UNAVAILABLE, "Too many pages are open"),
            Problem::Failed(_) => (StatusCode::SERVICE_UNAVAILABLE, "This cannot be shown now"),
        }
    }

    fn description(&self) -> Markup {
        match self {
            Problem::Page => html! { "Nothing is at this address." },
            Problem::Address => {
                html! { "This address is longer than any address of this program." }
            }
            Problem::Query(explanation) => html! { (explanation) },
            Problem::Campaign(name) => html! {
                "No campaign is called " code { (name) } " here. If there was one, it has been \
                deleted, with its results and files."
            },
            Problem::Renamed { former, now } => html! {
                "Campaign " code { (former) } " is called "
                a href={ "/campaigns/" (now) } { (now) } " now."
            },
            Problem::Rollout { campaign, rollout } => html! {
                "Campaign " code { (campaign) } " has no rollout " code { (rollout) } ". "
                a href={ "/campaigns/" (campaign) "/rollouts" } { "Its rollouts" } "."
            },
            Problem::Video => html! {
                "This rollout has no video: a campaign films the rollouts that "
                code { "--record" } " selected at its creation. With "
                code { "--record transitions" } ", " code { "worker film" }
                " makes the films afterwards."
            },
            Problem::TooManyStreams => html! {
                "Too many pages are open. This page polls for changes instead."
            },
            Problem::Failed(text) => html! {
                "The coordinator failed to " (text) ". No result is lost; the coordinator's log has the \
                details. Reload the page to try again."
            },
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let (code, title) = self.code_and_title();
        let main = html! {
            h1 { (title) }
            p { (self.description()) }
            p { a href="/" { "All campaigns" } }
        };
        answer::page(code, layout::static_page(title, &main).into_string())
    }
}

impl<E: Into<ReadError>> From<E> for Problem {
    fn from(error: E) -> Problem {
        match error.into() {
            ReadError::Queue(QueueError::UnknownCampaign { campaign }) => {
                Problem::Campaign(campaign.to_string())
            }
            ReadError::Queue(QueueError::Renamed { campaign, now }) => {
                Problem::Renamed { former: campaign.to_string(), now: now.to_string() }
            }
            error => Problem::failed(&error),
        }
    }
}
