//! Shared state of all pages, and their caches: a page is rendered once for all requests within a
//! second.

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use axum::http::{HeaderMap, Uri};
use axum::response::{IntoResponse, Redirect, Response};
use queue::Queue;
use queue::ids::{CampaignName, shortened};
use queue::read::{Campaign, Edition, View};
use report::{Comparison, Document, Unpairable};
use transport::Security;

use super::answer::Rendered;
use super::changes::Changes;
use super::layout::{self, Sheet};
use super::problem::Problem;
use super::single_flight::{CachedValue, SingleFlightCache};
use crate::gauges::Gauges;
use crate::storage::Storage;
use crate::subject;

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

/// Statistics, or the error of computing them, with the editions on which they depend.
type StatisticsCache<E, V> = SingleFlightCache<(E, Result<Arc<V>, Problem>)>;

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
    documents: StatisticsCache<Editions, Document>,
    comparisons: StatisticsCache<[Edition; 2], Compared>,
    pub(super) metrics: SingleFlightCache<Arc<str>>,
}

/// Returns the cache time of statistics whose computation took `cost`.
fn cache_time(cost: Duration) -> Duration {
    (cost * DOCUMENT_AGE_PER_COST).max(PAGE_AGE)
}

/// Runs a computation on a blocking thread, since it takes thousands of bootstrap resamplings.
async fn on_blocking_thread<T: Send + 'static>(
    compute: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    let computed = tokio::task::spawn_blocking(compute).await;
    computed.map_err(|error| Problem::failed(&error))
}

impl<E: Clone + PartialEq + Send + 'static, V: Send + Sync + 'static> StatisticsCache<E, V> {
    /// Returns the statistics of these editions, or earlier ones of the same campaigns; `None` while
    /// the first ones are computed.
    async fn statistics(
        &self,
        key: &str,
        editions: E,
        is_same: impl Fn(&E) -> bool,
        compute: impl Future<Output = Result<V, Problem>> + Send + 'static,
    ) -> Result<Option<Arc<V>>, Problem> {
        let is_fresh = |cached: &CachedValue<(E, Result<Arc<V>, Problem>)>| {
            let (of, statistics) = &cached.value;
            statistics.is_ok()
                && (*of == editions
                    || is_same(of) && cached.started.elapsed() < cache_time(cached.cost))
        };
        let computed_editions = editions.clone();
        let make = async move { (computed_editions, compute.await.map(Arc::new)) };
        let newest = self.newest(key, is_fresh, make).await;
        let newest = newest.filter(|(of, _)| is_same(of));
        newest.map(|(_, statistics)| statistics).transpose()
    }
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

    /// Returns a campaign's statistics; `None` while they are computed for the first time. They may
    /// lag behind its results by the duration of their computation and the cache time, see
    /// [`cache_time`].
    pub(super) async fn document(
        &self,
        campaign: &Campaign,
        view: &mut View,
    ) -> Result<Option<Arc<Document>>, Problem> {
        let source = match view.source(campaign.id).await? {
            Some(source) => Some(view.edition(source.id).await?),
            None => None,
        };
        let editions = (view.edition(campaign.id).await?, source);
        let is_same = |cached: &Editions| cached.0.is_of_same_campaign(&editions.0);
        let (queue, campaign) = (self.queue.clone(), campaign.clone());
        let name = campaign.name.clone();
        let compute = async move {
            let subject = subject::read(&mut queue.view().await?, &campaign).await?;
            on_blocking_thread(move || Document::new(vec![subject]))
                .await?
                .map_err(|error| Problem::failed(&error))
        };
        self.documents.statistics(name.as_str(), editions.clone(), is_same, compute).await
    }

    /// Returns the comparison of two campaigns, which may be absent or lag behind their results like
    /// [`Page::document`].
    pub(super) async fn comparison(
        &self,
        [a, b]: [&Campaign; 2],
        view: &mut View,
    ) -> Result<Option<Arc<Compared>>, Problem> {
        let documents = [self.document(a, view).await?, self.document(b, view).await?];
        let [Some(of_a), Some(of_b)] = documents else { return Ok(None) };
        let editions = [view.edition(a.id).await?, view.edition(b.id).await?];
        let is_same = |cached: &[Edition; 2]| {
            cached.iter().zip(&editions).all(|(cached, now)| cached.is_of_same_campaign(now))
        };
        // Campaign names contain no spaces, so the key is unambiguous.
        let key = format!("{} {}", a.name, b.name);
        let (queue, campaigns) = (self.queue.clone(), [a.clone(), b.clone()]);
        let compute = async move {
            let mut view = queue.view().await?;
            let [a, b] = &campaigns;
            let setups =
                [subject::setups(&mut view, a).await?, subject::setups(&mut view, b).await?];
            drop(view);
            on_blocking_thread(move || {
                let analyses = [&of_a, &of_b].map(|document| &document.analyses[0]);
                Comparison::of(analyses, setups.each_ref())
            })
            .await
        };
        self.comparisons.statistics(&key, editions.clone(), is_same, compute).await
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
