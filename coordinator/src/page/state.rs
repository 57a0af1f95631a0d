//! Shared state of all pages, and their caches: a page is rendered once for all requests within a
//! second.

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use ::report::{Comparison, Document, Unpairable};
use axum::http::{HeaderMap, Uri};
use axum::response::{IntoResponse, Redirect, Response};
use queue::Queue;
use queue::ids::{CampaignName, shortened};
use queue::read::{Campaign, Edition, View};
use transport::Security;

use super::answer::Rendered;
use super::changes::Changes;
use super::layout::{self, Sheet};
use super::problem::Problem;
use super::single_flight::{CachedValue, SingleFlightCache};
use crate::gauges::Gauges;
use crate::report;
use crate::storage::Storage;

/// Longest accepted path and query, bytes.
const MAX_ADDRESS_BYTES: usize = 1_024;
/// Longest time for which a rendered page is served from the cache.
pub(super) const PAGE_AGE: Duration = Duration::from_secs(1);
/// Most cached pages, one per address.
const MAX_PAGES: usize = 256;
/// Most campaigns whose statistics are cached, and most cached comparisons.
const MAX_DOCUMENTS: usize = 16;
/// Cache time of statistics as a multiple of their computation time: recomputing the statistics of
/// a large, much-watched campaign takes at most a twentieth of a core.
const DOCUMENT_AGE_PER_COST: u32 = 20;

/// Comparison of two campaigns, or the reasons why they cannot be paired.
pub(super) type Compared = Result<Comparison, Unpairable>;

/// Editions on which a campaign's statistics depend: the edition of the campaign and, if it is
/// derived, that of its source campaign.
type Editions = (Edition, Option<Edition>);

/// Requested address and headers.
pub(super) type RequestedPage = (Uri, HeaderMap);

/// Shared state of the pages' handlers.
#[derive(Debug)]
pub(crate) struct Page {
    pub(super) queue: Arc<Queue>,
    pub(super) security: Security,
    pub(super) gauges: Arc<Gauges>,
    pub(super) changes: Changes,
    pub(super) storage: Option<Arc<Storage>>,
    pages: SingleFlightCache<Arc<Rendered>>,
    documents: SingleFlightCache<(Editions, Arc<Document>)>,
    comparisons: SingleFlightCache<([Edition; 2], Arc<Compared>)>,
    pub(super) metrics: SingleFlightCache<Arc<str>>,
}

/// Returns the cache time of statistics whose computation took `cost`.
fn cache_time(cost: Duration) -> Duration {
    (cost * DOCUMENT_AGE_PER_COST).max(PAGE_AGE)
}

impl Page {
    /// Creates the pages of a queue, with empty caches.
    pub(crate) fn new(
        queue: &Arc<Queue>,
        security: &Security,
        gauges: &Arc<Gauges>,
        storage: Option<Arc<Storage>>,
    ) -> Arc<Page> {
        Arc::new(Page {
            queue: queue.clone(),
            security: security.clone(),
            gauges: gauges.clone(),
            changes: Changes::new(),
            storage,
            pages: SingleFlightCache::new(MAX_PAGES),
            documents: SingleFlightCache::new(MAX_DOCUMENTS),
            comparisons: SingleFlightCache::new(MAX_DOCUMENTS),
            metrics: SingleFlightCache::new(1),
        })
    }

    /// Notifies open streams of changes until the future is dropped.
    pub(crate) async fn poll_changes(&self) {
        self.changes.poll(&self.queue).await;
    }

    /// Closes all event streams, so that the server can shut down.
    pub(crate) fn close(&self) {
        self.changes.close();
    }

    /// Renders a page, or serves the cached page of the same address and version; 304 Not Modified
    /// if the browser's copy of the page is the same.
    pub(super) async fn show(
        &self,
        (uri, headers): RequestedPage,
        sheet: impl Future<Output = Result<Sheet, Problem>>,
    ) -> Response {
        let address = uri.path_and_query().map_or("/", |address| address.as_str());
        if address.len() > MAX_ADDRESS_BYTES {
            return Problem::Address.into_response();
        }
        let version = self.changes.version();
        let is_fresh = |cached: &CachedValue<Arc<Rendered>>| {
            cached.started.elapsed() < PAGE_AGE && cached.value.version == version
        };
        let make = async {
            let sheet = sheet.await?;
            let html = layout::live_page(&sheet, self.security.asks_for_tokens());
            Ok::<_, Problem>(Arc::new(Rendered::new(html.into_string(), version)))
        };
        match self.pages.get(address, is_fresh, make).await {
            Ok(rendered) => rendered.answer(&headers),
            // Redirects bookmarks with the campaign's former name.
            Err(Problem::Renamed { former, now }) => {
                let former_path = format!("/campaigns/{former}");
                let new_path = format!("/campaigns/{now}");
                Redirect::temporary(&address.replacen(&former_path, &new_path, 1)).into_response()
            }
            Err(problem) => problem.into_response(),
        }
    }

    /// Returns a campaign's statistics. They may lag behind its results by the cache time, see
    /// [`cache_time`].
    pub(super) async fn document(
        &self,
        campaign: &Campaign,
        view: &mut View,
    ) -> Result<Arc<Document>, Problem> {
        let source = match view.source(campaign.id).await? {
            Some(source) => Some(view.edition(source.id).await?),
            None => None,
        };
        let editions = (view.edition(campaign.id).await?, source);
        let is_fresh = |cached: &CachedValue<(Editions, Arc<Document>)>| {
            cached.value.0 == editions
                || (cached.value.0.0.is_of_same_campaign(&editions.0)
                    && cached.started.elapsed() < cache_time(cached.cost))
        };
        let computed_editions = editions.clone();
        let read = async {
            let subject = report::subject(view, campaign).await?;
            Ok::<_, Problem>(move || {
                let document = Document::new(vec![subject]);
                let document = document.map_err(|error| Problem::failed(&error))?;
                Ok((computed_editions, Arc::new(document)))
            })
        };
        let (_, document) = self
            .documents
            .compute(campaign.name.as_str(), is_fresh, read, |error| Problem::failed(error))
            .await?;
        Ok(document)
    }

    /// Returns the comparison of two campaigns, which may lag behind their results like
    /// [`Page::document`].
    pub(super) async fn comparison(
        &self,
        [a, b]: [&Campaign; 2],
        view: &mut View,
    ) -> Result<Arc<Compared>, Problem> {
        let editions = [view.edition(a.id).await?, view.edition(b.id).await?];
        let is_fresh = |cached: &CachedValue<([Edition; 2], Arc<Compared>)>| {
            let mut pairs = cached.value.0.iter().zip(&editions);
            cached.value.0 == editions
                || (pairs.all(|(cached, now)| cached.is_of_same_campaign(now))
                    && cached.started.elapsed() < cache_time(cached.cost))
        };
        let computed_editions = editions.clone();
        let read = async {
            let documents = [self.document(a, view).await?, self.document(b, view).await?];
            let setups = [report::setups(view, a).await?, report::setups(view, b).await?];
            Ok::<_, Problem>(move || {
                let [a, b] = documents.each_ref().map(|document| &document.analyses[0]);
                let compared = Comparison::of([a, b], setups.each_ref());
                Ok((computed_editions, Arc::new(compared)))
            })
        };
        // Campaign names contain no spaces, so the key is unambiguous.
        let key = format!("{} {}", a.name, b.name);
        let compared =
            self.comparisons.compute(&key, is_fresh, read, |error| Problem::failed(error));
        let (_, compared) = compared.await?;
        Ok(compared)
    }

    /// Looks a campaign up by the name in an address. The whole page reads from the returned view,
    /// so that it takes only one database connection.
    pub(super) async fn campaign(&self, name: &str) -> Result<(Campaign, View), Problem> {
        let unknown = || Problem::Campaign(shortened(name, 80).to_owned());
        let name = CampaignName::parse(name).map_err(|_| unknown())?;
        let mut view = self.queue.view().await?;
        let campaign = view.campaign(&name).await?;
        Ok((campaign, view))
    }
}
