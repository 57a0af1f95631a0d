//! The live page: read-only HTML views of the coordinator, on the same port as gRPC. This module
//! owns routes and rendering. Access control is in `transport`, the data in `queue` and `report`;
//! campaigns are changed through gRPC only.
//!
//! A page is rendered at most once a second, however many browsers request it. A campaign's
//! statistics are computed only after its results changed, and no page waits for them longer than
//! half a second.

mod answer;
mod bar;
mod campaign;
mod campaigns;
mod card;
mod changes;
mod compare;
mod configuration;
mod films;
mod lattice_view;
mod layout;
mod log_in;
mod metrics;
mod overviews;
mod problem;
mod rollouts;
mod single_flight;
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
pub(crate) use state::Page;
use state::RequestedPage;

/// Merges the page routes into the gRPC router.
pub(crate) fn merge_routes(page: Arc<Page>, calls: Router) -> Router {
    let pages = routes().into_iter();
    let pages = pages.fold(Router::new(), |pages, (path, answer)| pages.route(path, answer));
    calls.merge(pages.with_state(page)).fallback(unknown)
}

/// Returns the routes of all pages and of their static files.
pub(crate) fn routes() -> [(&'static str, MethodRouter<Arc<Page>>); 16] {
    [
        ("/", get(all_campaigns)),
        (compare::ADDRESS, get(two_campaigns)),
        ("/campaigns/{name}", get(one_campaign)),
        ("/campaigns/{name}/rollouts", get(rollouts_of)),
        ("/campaigns/{name}/configurations/{*rollout}", get(one_configuration)),
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

type PageState = State<Arc<Page>>;
/// Path parameters: campaign name and rollout id.
type CampaignAndRollout = (String, String);

async fn all_campaigns(State(page): PageState, request: RequestedPage) -> Response {
    page.show(request, campaigns::sheet(&page)).await
}

async fn two_campaigns(State(page): PageState, request: RequestedPage) -> Response {
    let query = request.0.query().unwrap_or_default().to_owned();
    page.show(request, compare::sheet(&page, &query)).await
}

async fn one_campaign(
    State(page): PageState,
    Path(name): Path<String>,
    request: RequestedPage,
) -> Response {
    page.show(request, campaign::sheet(&page, &name)).await
}

async fn rollouts_of(
    State(page): PageState,
    Path(name): Path<String>,
    request: RequestedPage,
) -> Response {
    let query = request.0.query().unwrap_or_default().to_owned();
    let sheet = rollouts::sheet(&page, &name, &query);
    page.show(request, sheet).await
}

async fn one_configuration(
    State(page): PageState,
    Path((name, rollout)): Path<CampaignAndRollout>,
    request: RequestedPage,
) -> Response {
    let query = request.0.query().unwrap_or_default().to_owned();
    let sheet = configuration::sheet(&page, &name, &rollout, &query);
    page.show(request, sheet).await
}

async fn one_video(
    State(page): PageState,
    Path((name, rollout)): Path<CampaignAndRollout>,
    request: Request,
) -> Response {
    let video = video::answer(&page, &name, &rollout, request).await;
    video.unwrap_or_else(IntoResponse::into_response)
}

async fn all_workers(State(page): PageState, request: RequestedPage) -> Response {
    page.show(request, overviews::workers(&page)).await
}

async fn all_policies(State(page): PageState, request: RequestedPage) -> Response {
    page.show(request, overviews::policies(&page)).await
}

async fn the_quarantine(State(page): PageState, request: RequestedPage) -> Response {
    page.show(request, overviews::quarantine(&page)).await
}

async fn events(State(page): PageState) -> Response {
    page.changes.stream().unwrap_or_else(IntoResponse::into_response)
}

/// Fallback for unknown paths: gRPC `UNIMPLEMENTED` for calls, a 404 page for everything else.
async fn unknown(request: Request) -> Response {
    match access::is_call(request.uri().path()) {
        true => Status::unimplemented("").into_http(),
        false => Problem::Page.into_response(),
    }
}
