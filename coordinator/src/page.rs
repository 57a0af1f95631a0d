//! The live page: what the coordinator knows, for browsers, on the port that
//! its calls are on. Responsible for addresses, words and pictures; not for who
//! may look (`transport`), nor for what is true (`queue`, `report`). It reads
//! only: whatever changes a campaign is a call.
//!
//! However many look, a page is made at most once a second, and the statistics
//! of a campaign only when its results changed.

mod answer;
mod bar;
mod campaign;
mod campaigns;
mod card;
mod changes;
mod compare;
mod configuration;
mod films;
mod kept;
mod known;
mod layout;
mod log_in;
mod metrics;
mod perturbation;
mod problem;
mod rollouts;
mod speed;
mod standing;
mod state;
mod subsets;
mod trace;
mod video;

use std::sync::Arc;

use axum::Router;
use axum::extract::{Path, Request, State};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get, post};
use tonic::Status;

use crate::access::{self, LOG_IN};
use problem::Problem;
use state::Asked;
pub(crate) use state::Page;

/// Adds the pages to the calls.
pub(crate) fn beside(page: Arc<Page>, calls: Router) -> Router {
    let pages = routes().into_iter();
    let pages = pages.fold(Router::new(), |pages, (path, answer)| {
        pages.route(path, answer)
    });
    calls.merge(pages.with_state(page)).fallback(unknown)
}

/// All pages and the files that they load, by their paths.
pub(crate) fn routes() -> [(&'static str, MethodRouter<Arc<Page>>); 16] {
    [
        ("/", get(all_campaigns)),
        (compare::ADDRESS, get(two_campaigns)),
        ("/campaigns/{name}", get(one_campaign)),
        ("/campaigns/{name}/rollouts", get(rollouts_of)),
        (
            "/campaigns/{name}/configurations/{*rollout}",
            get(one_configuration),
        ),
        ("/campaigns/{name}/videos/{*rollout}", get(one_video)),
        ("/workers", get(all_workers)),
        ("/policies", get(all_policies)),
        ("/quarantine", get(the_quarantine)),
        ("/events", get(events)),
        ("/metrics", get(metrics::get)),
        (LOG_IN, get(log_in::form).post(log_in::submit)),
        ("/logout", post(log_in::log_out)),
        ("/style.css", get(answer::style)),
        ("/page.js", get(answer::script)),
        ("/icon.svg", get(answer::icon)),
    ]
}

type At = State<Arc<Page>>;
/// A campaign's name and a rollout's id.
type Of = (String, String);

async fn all_campaigns(State(page): At, asked: Asked) -> Response {
    page.show(asked, campaigns::sheet(&page)).await
}

async fn two_campaigns(State(page): At, asked: Asked) -> Response {
    let query = asked.0.query().unwrap_or_default().to_owned();
    page.show(asked, compare::sheet(&page, &query)).await
}

async fn one_campaign(State(page): At, Path(name): Path<String>, asked: Asked) -> Response {
    page.show(asked, campaign::sheet(&page, &name)).await
}

async fn rollouts_of(State(page): At, Path(name): Path<String>, asked: Asked) -> Response {
    let query = asked.0.query().unwrap_or_default().to_owned();
    let sheet = rollouts::sheet(&page, &name, &query);
    page.show(asked, sheet).await
}

async fn one_configuration(State(page): At, Path(of): Path<Of>, asked: Asked) -> Response {
    let query = asked.0.query().unwrap_or_default().to_owned();
    let sheet = configuration::sheet(&page, &of.0, &of.1, &query);
    page.show(asked, sheet).await
}

async fn one_video(State(page): At, Path(of): Path<Of>, request: Request) -> Response {
    let video = video::answer(&page, &of.0, &of.1, request).await;
    video.unwrap_or_else(IntoResponse::into_response)
}

async fn all_workers(State(page): At, asked: Asked) -> Response {
    page.show(asked, standing::workers(&page)).await
}

async fn all_policies(State(page): At, asked: Asked) -> Response {
    page.show(asked, standing::policies(&page)).await
}

async fn the_quarantine(State(page): At, asked: Asked) -> Response {
    page.show(asked, standing::quarantine(&page)).await
}

async fn events(State(page): At) -> Response {
    page.changes
        .stream()
        .unwrap_or_else(IntoResponse::into_response)
}

/// Answers for paths that nothing is at: a call that this server does not have, or no page.
async fn unknown(request: Request) -> Response {
    match access::is_call(request.uri().path()) {
        true => Status::unimplemented("").into_http(),
        false => Problem::Page.into_response(),
    }
}
