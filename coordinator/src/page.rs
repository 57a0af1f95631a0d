//! The live page: what the coordinator knows, for browsers, on the port that
//! its calls are on. Responsible for addresses, words and pictures; not for who
//! may look (`transport`), nor for what is true (`queue`, `store`, `report`).
//! It reads only: whatever changes a campaign is a call.
//!
//! However many look, a page is made at most once a second, and the statistics
//! of a campaign only when its results changed.

mod answer;
mod bar;
mod campaign;
mod campaigns;
mod card;
mod changes;
mod configuration;
mod kept;
mod layout;
mod log_in;
mod metrics;
mod perturbation;
mod problem;
mod rollouts;
mod standing;
mod trace;
mod video;

use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use tonic::Status;
use transport::Security;

use crate::ids::CampaignName;
use crate::queue::Queue;
use crate::report;
use crate::store::campaigns::CampaignRow;
use crate::store::page::{Edition, edition};
use crate::store::{View, campaigns as stored};
use answer::Rendered;
use changes::Changes;
use kept::{Kept, Made};
use layout::Sheet;
use problem::Problem;

/// Where browsers log in.
pub(crate) const LOG_IN: &str = "/login";

/// Longest address that is looked at, path and query, bytes.
const MAX_ADDRESS_BYTES: usize = 1_024;
/// A page is shown again for so long before it is made anew.
const PAGE_AGE: Duration = Duration::from_secs(1);
/// Pages that are kept at a time, one for each address.
const MAX_PAGES: usize = 256;
/// Campaigns whose statistics are kept at a time.
const MAX_DOCUMENTS: usize = 16;
/// Statistics that took long are shown again for so many times as long, so that
/// a large campaign with many eyes on it takes no more than a twentieth of a
/// core.
const DOCUMENT_AGE_PER_COST: u32 = 20;

/// Everything that the pages are made from.
#[derive(Debug)]
pub(crate) struct Page {
    queue: Arc<Queue>,
    security: Security,
    gauges: Arc<Gauges>,
    changes: Changes,
    pages: Kept<Arc<Rendered>>,
    documents: Kept<(Edition, Arc<::report::Document>)>,
    metrics: Kept<Arc<str>>,
}

/// What is counted while it happens, for the metrics.
#[derive(Debug, Default)]
pub(crate) struct Gauges {
    claims: AtomicUsize,
}

/// A claim that is being answered; no more when it is dropped.
#[derive(Debug)]
pub(crate) struct ClaimInHand<'a>(&'a Gauges);

impl Gauges {
    /// Counts a claim for as long as what is returned lives.
    pub(crate) fn claim(&self) -> ClaimInHand<'_> {
        self.claims.fetch_add(1, Ordering::Relaxed);
        ClaimInHand(self)
    }

    fn claims(&self) -> usize {
        self.claims.load(Ordering::Relaxed)
    }
}

impl Drop for ClaimInHand<'_> {
    fn drop(&mut self) {
        self.0.claims.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Page {
    /// The pages on a queue.
    pub(crate) fn new(queue: &Arc<Queue>, security: &Security, gauges: &Arc<Gauges>) -> Arc<Page> {
        Arc::new(Page {
            queue: queue.clone(),
            security: security.clone(),
            gauges: gauges.clone(),
            changes: Changes::new(),
            pages: Kept::new(MAX_PAGES),
            documents: Kept::new(MAX_DOCUMENTS),
            metrics: Kept::new(1),
        })
    }

    /// Tells those who look what changed, until it is dropped.
    pub(crate) async fn tell_changes(&self) {
        self.changes.tell(self.queue.store()).await;
    }

    /// Ends the streams of those who look, so that the server can end.
    pub(crate) fn close(&self) {
        self.changes.close();
    }

    /// Adds the pages to the calls.
    pub(crate) fn beside(self: Arc<Page>, calls: Router) -> Router {
        let pages = Router::new()
            .route("/", get(all_campaigns))
            .route("/campaigns/{name}", get(one_campaign))
            .route("/campaigns/{name}/rollouts", get(rollouts_of))
            .route(
                "/campaigns/{name}/configurations/{*rollout}",
                get(one_configuration),
            )
            .route("/campaigns/{name}/videos/{*rollout}", get(one_video))
            .route("/workers", get(all_workers))
            .route("/policies", get(all_policies))
            .route("/quarantine", get(the_quarantine))
            .route("/events", get(events))
            .route("/metrics", get(metrics::get))
            .route(LOG_IN, get(log_in::form).post(log_in::submit))
            .route("/logout", post(log_in::log_out))
            .route("/style.css", get(answer::style))
            .route("/page.js", get(answer::script))
            .route("/icon.svg", get(answer::icon))
            .with_state(self);
        calls.merge(pages).fallback(unknown)
    }

    /// Makes a page, or shows again what was made for this address a moment
    /// ago. A browser that has the same already is told so.
    async fn show(
        &self,
        (uri, headers): (Uri, HeaderMap),
        sheet: impl Future<Output = Result<Sheet, Problem>>,
    ) -> Response {
        let address = uri.path_and_query().map_or("/", |address| address.as_str());
        if address.len() > MAX_ADDRESS_BYTES {
            return Problem::Address.into_response();
        }
        let version = self.changes.version();
        let is_fresh = |made: &Made<Arc<Rendered>>| {
            made.at.elapsed() < PAGE_AGE && made.value.version == version
        };
        let make = async {
            let sheet = sheet.await?;
            let html = layout::whole(&sheet, self.security.asks_for_tokens());
            Ok::<_, Problem>(Arc::new(Rendered::new(html.into_string(), version)))
        };
        match self.pages.get(address, is_fresh, make).await {
            Ok(rendered) => rendered.answer(&headers),
            Err(problem) => problem.into_response(),
        }
    }

    /// A campaign's statistics, from results as they are or as they were a
    /// moment ago.
    async fn document(
        &self,
        name: &CampaignName,
        row: &CampaignRow,
        view: &mut View,
    ) -> Result<Arc<::report::Document>, Problem> {
        let edition = edition(view, row.id).await?;
        let is_fresh = |made: &Made<(Edition, Arc<::report::Document>)>| {
            let patience = (made.cost * DOCUMENT_AGE_PER_COST).max(PAGE_AGE);
            made.value.0 == edition
                || (made.value.0.is_of_same_campaign(&edition) && made.at.elapsed() < patience)
        };
        let wanted = edition.clone();
        let make = async {
            let subject = report::subject(&self.queue, name).await?;
            // Thousands of resamplings: not on a thread that answers others.
            let document = tokio::task::spawn_blocking(|| ::report::Document::new(vec![subject]));
            let document = document.await.map_err(|error| Problem::failed(&error))?;
            let document = document.map_err(|error| Problem::failed(&error))?;
            Ok::<_, Problem>((wanted, Arc::new(document)))
        };
        let (_, document) = self.documents.get(name.as_str(), is_fresh, make).await?;
        Ok(document)
    }

    /// A campaign by the name in an address.
    async fn campaign(&self, name: &str) -> Result<(CampaignName, CampaignRow, View), Problem> {
        let unknown = || Problem::Campaign(crate::ids::shortened(name, 80).to_owned());
        let name = CampaignName::parse(name).map_err(|_| unknown())?;
        let mut view = self.queue.store().read().await?;
        let row = stored::by_name(&mut view, &name).await?;
        let row = row.ok_or_else(unknown)?;
        Ok((name, row, view))
    }
}

type At = State<Arc<Page>>;

async fn all_campaigns(State(page): At, uri: Uri, headers: HeaderMap) -> Response {
    page.show((uri, headers), campaigns::sheet(&page)).await
}

async fn one_campaign(
    State(page): At,
    Path(name): Path<String>,
    uri: Uri,
    headers: HeaderMap,
) -> Response {
    page.show((uri, headers), campaign::sheet(&page, &name))
        .await
}

async fn rollouts_of(
    State(page): At,
    Path(name): Path<String>,
    uri: Uri,
    headers: HeaderMap,
) -> Response {
    let query = uri.query().unwrap_or_default().to_owned();
    let sheet = rollouts::sheet(&page, &name, &query);
    page.show((uri, headers), sheet).await
}

async fn one_configuration(
    State(page): At,
    Path((name, rollout)): Path<(String, String)>,
    uri: Uri,
    headers: HeaderMap,
) -> Response {
    let query = uri.query().unwrap_or_default().to_owned();
    let sheet = configuration::sheet(&page, &name, &rollout, &query);
    page.show((uri, headers), sheet).await
}

async fn one_video(
    State(page): At,
    Path((name, rollout)): Path<(String, String)>,
    uri: Uri,
    headers: HeaderMap,
) -> Response {
    let query = uri.query().unwrap_or_default();
    let video = video::answer(&page, &name, &rollout, query, &headers).await;
    video.unwrap_or_else(IntoResponse::into_response)
}

async fn all_workers(State(page): At, uri: Uri, headers: HeaderMap) -> Response {
    page.show((uri, headers), standing::workers(&page)).await
}

async fn all_policies(State(page): At, uri: Uri, headers: HeaderMap) -> Response {
    page.show((uri, headers), standing::policies(&page)).await
}

async fn the_quarantine(State(page): At, uri: Uri, headers: HeaderMap) -> Response {
    page.show((uri, headers), standing::quarantine(&page)).await
}

async fn events(State(page): At) -> Response {
    page.changes
        .stream()
        .unwrap_or_else(IntoResponse::into_response)
}

/// What has no address: a call that nobody answers, or a page that is not there.
async fn unknown(request: Request) -> Response {
    let kind = request.headers().get(header::CONTENT_TYPE);
    match kind.is_some_and(|kind| kind.as_bytes().starts_with(b"application/grpc")) {
        true => Status::unimplemented("").into_http(),
        false => Problem::Page.into_response(),
    }
}
