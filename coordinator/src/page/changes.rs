//! Change notifications for browsers by server-sent events. While streams are open, the database is
//! polled once a second for all of them together. An event carries only the change counter; the
//! page then fetches its new content.

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

/// Most streams at a time; further browsers poll instead.
pub(super) const MAX_STREAMS: usize = 128;
/// Interval between two polls of the database.
const POLL_INTERVAL: Duration = Duration::from_secs(1);
/// Longest interval between two events. Displayed ages grow even without changes, and a browser's
/// disconnection is noticed only when something is sent to it.
const MAX_EVENT_INTERVAL: Duration = Duration::from_secs(5);
/// Reconnection delay of a browser, milliseconds.
const RECONNECT_MS: u32 = 1_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ChangeState {
    /// Change counter; only increases while the coordinator runs.
    Version(u64),
    /// The coordinator is shutting down.
    Closed,
}

/// Broadcast of changes to all open streams.
#[derive(Debug)]
pub(super) struct Changes {
    state: watch::Sender<ChangeState>,
    /// One permit per stream that may still be opened.
    permits: Arc<Semaphore>,
    /// Notified when a stream is opened.
    opened: Notify,
}

impl Changes {
    pub(super) fn new() -> Changes {
        Changes {
            state: watch::Sender::new(ChangeState::Version(0)),
            permits: Arc::new(Semaphore::new(MAX_STREAMS)),
            opened: Notify::new(),
        }
    }

    /// Returns the change counter, which is the version of a page rendered now.
    pub(super) fn version(&self) -> u64 {
        match *self.state.borrow() {
            ChangeState::Version(version) => version,
            ChangeState::Closed => 0,
        }
    }

    /// Returns the number of open streams.
    pub(super) fn streams(&self) -> usize {
        MAX_STREAMS - self.permits.available_permits()
    }

    pub(super) fn stream(&self) -> Result<Response, Problem> {
        let permit = self.permits.clone().try_acquire_owned();
        let permit = permit.map_err(|_| Problem::TooManyStreams)?;
        self.opened.notify_one();
        let state = WatchStream::new(self.state.subscribe());
        let state = state.take_while(|state| *state != ChangeState::Closed);
        let lines = state.map(move |state| {
            // The closure owns the permit, so it is released when the stream is dropped.
            let _taken = &permit;
            let ChangeState::Version(version) = state else {
                return Ok(Bytes::new());
            };
            let event = format!("retry: {RECONNECT_MS}\nevent: change\ndata: {version}\n\n");
            Ok::<_, std::convert::Infallible>(Bytes::from(event))
        });
        let headers =
            [(header::CONTENT_TYPE, "text/event-stream"), (header::CACHE_CONTROL, "no-store")];
        Ok((headers, Body::from_stream(lines)).into_response())
    }

    /// Polls for changes while streams are open; never returns.
    pub(super) async fn poll(&self, queue: &Queue) {
        loop {
            if self.streams() == 0 {
                self.opened.notified().await;
            }
            if let Err(error) = self.poll_while_watched(queue).await {
                // Logged at debug level only: the pages themselves show database errors.
                tracing::debug!("failed to {error}");
                self.increment_version();
                sleep(MAX_EVENT_INTERVAL).await;
            }
        }
    }

    pub(super) fn close(&self) {
        self.state.send_replace(ChangeState::Closed);
    }

    async fn poll_while_watched(&self, queue: &Queue) -> Result<(), StoreError> {
        let mut changes = queue.changes().await?;
        let mut last_version = changes.version().await?;
        let mut last_event = Instant::now();
        while self.streams() > 0 {
            sleep(POLL_INTERVAL).await;
            let version = changes.version().await?;
            if version != last_version || last_event.elapsed() >= MAX_EVENT_INTERVAL {
                self.increment_version();
                last_version = version;
                last_event = Instant::now();
            }
        }
        Ok(())
    }

    fn increment_version(&self) {
        self.state.send_modify(|state| {
            if let ChangeState::Version(version) = state {
                *version += 1;
            }
        });
    }
}
