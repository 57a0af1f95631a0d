//! Coordinator process: the server, its background tasks and the shutdown.

use std::future::Future;
use std::io;
use std::path::PathBuf;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use queue::clock::Clock;
use queue::{
    OpenError, Queue, QueueError, RemoteStorage, Store, StoreError, Tasks, Timing,
    remove_partial_files,
};
use rand_chacha::ChaCha8Rng;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::time::{MissedTickBehavior, timeout};
use tonic::service::Routes;
use transport::{Incoming, Security, SecurityError};

use crate::access;
use crate::disk::Room;
use crate::gauges::Gauges;
use crate::grpc;
use crate::mirror;
use crate::page::{self, Page};
use crate::storage::Storage;

/// Time that requests in progress have to finish at shutdown.
const SHUTDOWN_GRACE: Duration = Duration::from_secs(10);
/// HTTP/2 flow-control windows. With the default of 64 KiB, an upload would stall 16 times per
/// chunk of an archive (1 MiB), and four times per chunk of a video (256 KiB).
const STREAM_WINDOW_BYTES: u32 = 4 << 20;
const CONNECTION_WINDOW_BYTES: u32 = 16 << 20;

pub struct Config {
    pub data: PathBuf,
    /// Durations of leases, heartbeats and timeouts.
    pub timing: Timing,
    /// Clock; tests inject their own.
    pub clock: Arc<dyn Clock>,
    /// Random generator of attempt ids and backoff jitter.
    pub rng: ChaCha8Rng,
    /// Access: TLS and tokens.
    pub security: Security,
    /// Free space on the data folder's disk below which no jobs are leased, bytes.
    pub min_free_bytes: u64,
    /// Storage to which films are moved; `None` keeps them in the data folder.
    pub storage: Option<Arc<Storage>>,
}

/// Error that stops a coordinator or keeps it from starting.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    #[error(transparent)]
    Open(#[from] OpenError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("keep serving: the listening socket failed ({problem})")]
    Socket { problem: String },
    #[error(transparent)]
    Security(#[from] SecurityError),
    #[error("keep serving: {what} panicked (the log says where); start the coordinator again")]
    Panicked { what: &'static str },
    #[error("remove partial files in {}", folder.display())]
    Tidy { folder: PathBuf, source: io::Error },
}

/// An open coordinator that does not listen yet.
#[derive(Debug)]
pub struct Coordinator {
    queue: Arc<Queue>,
    security: Security,
    min_free_bytes: u64,
    storage: Option<Arc<Storage>>,
}

impl Coordinator {
    pub async fn open(config: Config) -> Result<Coordinator, ServeError> {
        let store = Store::open(&config.data).await?;
        remove_partial_files(&config.data)
            .map_err(|source| ServeError::Tidy { folder: config.data.clone(), source })?;
        let artifact_store = config.storage.clone();
        let artifact_store = artifact_store.map(|storage| storage as Arc<dyn RemoteStorage>);
        let (clock, rng) = (config.clock, config.rng);
        let queue = Queue::start_with(store, clock, rng, config.timing, artifact_store).await?;
        Ok(Coordinator {
            queue,
            security: config.security,
            min_free_bytes: config.min_free_bytes,
            storage: config.storage,
        })
    }

    /// Returns the queue, for tests and benchmarks that call it directly.
    pub fn queue(&self) -> &Arc<Queue> {
        &self.queue
    }

    /// Returns the gRPC services, to be called without a socket.
    pub fn services(&self) -> Routes {
        let storage = self.storage.as_ref();
        Routes::from(grpc::services(&self.queue, &Arc::default(), storage, self.min_free_bytes))
    }

    /// Serves workers, operators and browsers on `listener` until `shutdown` is ready; then stops
    /// leasing, finishes requests in progress and closes the database.
    pub async fn serve(
        self,
        listener: TcpListener,
        shutdown: impl Future<Output = ()> + Send + 'static,
    ) -> Result<(), ServeError> {
        self.serve_boxed(listener, Box::pin(shutdown)).await
    }

    /// Boxes the future of [`Coordinator::serve`], so that the server is compiled once in this
    /// crate instead of in every program and test that starts one.
    fn serve_boxed(
        self,
        listener: TcpListener,
        shutdown: Pin<Box<dyn Future<Output = ()> + Send>>,
    ) -> Pin<Box<dyn Future<Output = Result<(), ServeError>> + Send>> {
        Box::pin(self.serve_until(listener, shutdown))
    }

    async fn serve_until(
        self,
        listener: TcpListener,
        shutdown: Pin<Box<dyn Future<Output = ()> + Send>>,
    ) -> Result<(), ServeError> {
        let queue = self.queue;
        let (stop, stopped) = oneshot::channel::<()>();
        let gauges = Arc::new(Gauges::default());
        let storage = self.storage;
        let page = Page::new(&queue, &self.security, &gauges, storage.clone());
        // Background tasks, aborted when this function returns.
        let mut background = Tasks::default();
        let notifier = page.clone();
        background.spawn("the polling of changes for pages", async move {
            notifier.poll_changes().await
        });
        let calls = grpc::services(&queue, &gauges, storage.as_ref(), self.min_free_bytes);
        if let Some(storage) = storage {
            background.spawn("the task that moves films", mirror::run(queue.clone(), storage));
        }
        // The sweep is a separate task, since it waits for the database writer, for which the
        // handling of connections and signals must not wait.
        background.spawn("the sweep", sweep(queue.clone(), self.min_free_bytes));
        let routes = Routes::from(page::merge_routes(page.clone(), calls));
        let server = server(routes, &self.security, listener, async {
            // A dropped sender stops the server, too.
            let _ = stopped.await;
        });
        let mut server = std::pin::pin!(server);
        let mut shutdown = shutdown;
        tokio::select! {
            served = &mut server => {
                served?;
            }
            task = queue.broken() => return Err(ServeError::Panicked { what: task }),
            task = background.next_ended() => return Err(ServeError::Panicked { what: task }),
            () = &mut shutdown => {
                tracing::info!("stopping: no further leases; finishing requests in progress");
                queue.drain();
                page.close();
                let _ = stop.send(());
                if timeout(SHUTDOWN_GRACE, &mut server).await.is_err() {
                    tracing::warn!("requests were still open after {SHUTDOWN_GRACE:?}");
                }
            }
        }
        background.shutdown().await;
        queue.close().await?;
        Ok(())
    }
}

/// Periodically takes back expired leases, and suspends leasing while the disk is full or the
/// database cannot be written.
async fn sweep(queue: Arc<Queue>, min_free_bytes: u64) {
    let mut due = tokio::time::interval(queue.timing().sweep);
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        due.tick().await;
        let folder = queue.store().folder();
        let shortage = match queue.sweep().await {
            Ok(()) => Room::measure(folder, min_free_bytes).shortage(folder),
            Err(QueueError::Store(StoreError::Gone { folder })) => Some(format!(
                "the data folder {} is gone, or another database is in its place: \
                 `coordinator backup --output FILE` saves what was committed",
                folder.display()
            )),
            Err(error) => Some(format!(
                "the database cannot be written (failed to {})",
                transport::chain(&error)
            )),
        };
        queue.hold_leasing(shortage);
    }
}

async fn server(
    routes: Routes,
    security: &Security,
    listener: TcpListener,
    stopped: impl Future<Output = ()>,
) -> Result<(), ServeError> {
    security
        .server_with_pages(access::resource, access::LOG_IN)?
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .add_routes(routes)
        .serve_with_incoming_shutdown(Incoming::new(listener), stopped)
        .await
        .map_err(|error| ServeError::Socket { problem: transport::innermost(&error) })?;
    Ok(())
}
