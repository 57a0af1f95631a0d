//! Telling browsers that something changed, by server-sent events: one look at
//! the database a second for all of them. What changed is for the page to ask.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use queue::{Queue, StoreError};
use tokio::sync::{Notify, Semaphore, watch};
use tokio::time::{Instant, sleep};
use tokio_stream::StreamExt;
use tokio_stream::wrappers::WatchStream;

use super::problem::Problem;

/// Streams at a time; who comes later looks again by itself now and then.
pub(super) const MAX_STREAMS: usize = 128;
/// Between two looks at the database.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// Something is told at least so often: ages grow while nothing happens, and a
/// browser that is gone is only noticed when something is sent to it.
const TELL_EVERY: Duration = Duration::from_secs(5);
/// Wait of a browser before it connects again, milliseconds.
const RECONNECT_MS: u32 = 1_000;

/// An event of the streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum News {
    /// The edition of everything; it only rises while the coordinator runs.
    Version(u64),
    /// The coordinator stops.
    Closed,
}

/// The streams, and what they are told.
#[derive(Debug)]
pub(super) struct Changes {
    news: watch::Sender<News>,
    seats: Arc<Semaphore>,
    arrived: Notify,
}

impl Changes {
    pub(super) fn new() -> Changes {
        Changes {
            news: watch::Sender::new(News::Version(0)),
            seats: Arc::new(Semaphore::new(MAX_STREAMS)),
            arrived: Notify::new(),
        }
    }

    /// The edition that a page made now is of.
    pub(super) fn version(&self) -> u64 {
        match *self.news.borrow() {
            News::Version(version) => version,
            News::Closed => 0,
        }
    }

    /// Streams that are open.
    pub(super) fn streams(&self) -> usize {
        MAX_STREAMS - self.seats.available_permits()
    }

    /// A new stream.
    ///
    /// # Errors
    /// When there are too many.
    pub(super) fn stream(&self) -> Result<Response, Problem> {
        let seat = self.seats.clone().try_acquire_owned();
        let seat = seat.map_err(|_| Problem::TooManyStreams)?;
        self.arrived.notify_one();
        let news = WatchStream::new(self.news.subscribe());
        let news = news.take_while(|news| *news != News::Closed);
        let lines = news.map(move |news| {
            // The seat is taken for as long as the stream lives.
            let _taken = &seat;
            let News::Version(version) = news else {
                return Ok(Bytes::new());
            };
            let event = format!("retry: {RECONNECT_MS}\nevent: change\ndata: {version}\n\n");
            Ok::<_, std::convert::Infallible>(Bytes::from(event))
        });
        let headers = [
            (header::CONTENT_TYPE, "text/event-stream"),
            (header::CACHE_CONTROL, "no-store"),
        ];
        Ok((headers, Body::from_stream(lines)).into_response())
    }

    /// Looks for changes while anybody is there, for ever.
    pub(super) async fn tell(&self, queue: &Queue) {
        loop {
            if self.streams() == 0 {
                self.arrived.notified().await;
            }
            if let Err(error) = self.tell_while_watched(queue).await {
                // The pages say what is wrong with the database.
                tracing::debug!("failed to {error}");
                self.rise();
                sleep(TELL_EVERY).await;
            }
        }
    }

    /// Ends all streams.
    pub(super) fn close(&self) {
        self.news.send_replace(News::Closed);
    }

    async fn tell_while_watched(&self, queue: &Queue) -> Result<(), StoreError> {
        let mut changes = queue.changes().await?;
        let mut known = changes.version().await?;
        let mut told = Instant::now();
        while self.streams() > 0 {
            sleep(LOOK_EVERY).await;
            let found = changes.version().await?;
            if found != known || told.elapsed() >= TELL_EVERY {
                self.rise();
                known = found;
                told = Instant::now();
            }
        }
        Ok(())
    }

    fn rise(&self) {
        self.news.send_modify(|news| {
            if let News::Version(version) = news {
                *version += 1;
            }
        });
    }
}
