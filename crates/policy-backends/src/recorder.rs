//! Back-end that records the queries and answers of another back-end. Decides when a recording
//! starts and ends, and limits the size of all recordings together; a session whose recording fails
//! continues unrecorded.

use std::collections::HashMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use proto::policy::{DescribeResponse, InferRequest, InferResponse, ResetRequest};

use crate::backend::{Backend, BackendError};
use crate::recording::{Pair, Writer};

/// Time without a query after which a session counts as ended.
pub const ENDED_AFTER: Duration = Duration::from_secs(120);
/// Default limit of written bytes: about 400 sessions of 100 observations.
pub const DEFAULT_MAX_BYTES: u64 = 16 << 30;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordInto {
    pub folder: PathBuf,
    pub max_bytes: u64,
}

pub struct Recorder {
    inner: Arc<dyn Backend>,
    /// Open recordings, shared with the blocking threads that write them.
    shared: Arc<Mutex<OpenRecordings>>,
}

struct OpenRecordings {
    folder: PathBuf,
    bytes_left: u64,
    described: DescribeResponse,
    sessions: HashMap<String, (Instant, Writer)>,
}

impl Recorder {
    pub fn new(inner: Arc<dyn Backend>, into: RecordInto) -> Self {
        let RecordInto { folder, max_bytes } = into;
        Self {
            inner,
            shared: Arc::new(Mutex::new(OpenRecordings {
                folder,
                bytes_left: max_bytes,
                described: DescribeResponse::default(),
                sessions: HashMap::new(),
            })),
        }
    }

    /// Runs `writing` on a blocking thread, so that it does not block the threads of the runtime.
    async fn write(&self, writing: impl FnOnce(&mut OpenRecordings) + Send + 'static) {
        let shared = Arc::clone(&self.shared);
        let written = tokio::task::spawn_blocking(move || {
            let mut open = shared.lock().unwrap_or_else(PoisonError::into_inner);
            writing(&mut open);
        });
        if let Err(error) = written.await {
            tracing::error!("a recording failed: {error}");
        }
    }
}

impl OpenRecordings {
    fn begin(&mut self, reset: &ResetRequest) {
        self.end_idle();
        if let Some((_, earlier)) = self.sessions.remove(&reset.session) {
            earlier.discard();
        }
        if self.bytes_left == 0 {
            return;
        }
        match Writer::begin(&self.folder, &self.described, reset) {
            Ok(writer) => {
                let session = reset.session.clone();
                self.sessions.insert(session, (Instant::now(), writer));
            }
            Err(error) => tracing::error!("session {:?} is not recorded: {error}", reset.session),
        }
    }

    fn add(&mut self, session: &str, pair: &Pair) {
        let Some((_, mut writer)) = self.sessions.remove(session) else {
            return;
        };
        match writer.add(pair) {
            Ok(bytes) if bytes < self.bytes_left => {
                self.bytes_left -= bytes;
                let now = Instant::now();
                self.sessions.insert(session.to_owned(), (now, writer));
            }
            Ok(_) => {
                writer.discard();
                self.bytes_left = 0;
                tracing::error!(
                    "the recordings have reached their size limit: session {session:?} and later \
                     ones are not recorded; give a larger --max-mib"
                );
            }
            Err(error) => {
                writer.discard();
                tracing::error!("session {session:?} is not recorded: {error}");
            }
        }
    }

    fn end(&mut self, session: &str) {
        if let Some((_, writer)) = self.sessions.remove(session) {
            end(session, writer);
        }
    }

    fn end_idle(&mut self) {
        let is_idle = |(last, _): &(Instant, Writer)| last.elapsed() > ENDED_AFTER;
        let ended = self.sessions.extract_if(|_, session| is_idle(session));
        ended.for_each(|(session, (_, writer))| end(&session, writer));
    }
}

impl Drop for OpenRecordings {
    fn drop(&mut self) {
        for (session, (_, writer)) in self.sessions.drain() {
            end(&session, writer);
        }
    }
}

fn end(session: &str, writer: Writer) {
    match writer.finish() {
        Ok(path) => tracing::info!("recorded session {session:?} in {}", path.display()),
        Err(error) => tracing::error!("session {session:?} is not recorded: {error}"),
    }
}

#[tonic::async_trait]
impl Backend for Recorder {
    async fn describe(&self, suite: &str) -> Result<DescribeResponse, BackendError> {
        let described = self.inner.describe(suite).await?;
        let mut open = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        open.described.clone_from(&described);
        Ok(described)
    }

    async fn reset(&self, request: ResetRequest) -> Result<(), BackendError> {
        self.inner.reset(request.clone()).await?;
        self.write(move |open| open.begin(&request)).await;
        Ok(())
    }

    async fn end(&self, session: &str) {
        self.inner.end(session).await;
        let session = session.to_owned();
        self.write(move |open| open.end(&session)).await;
    }

    async fn infer(&self, query: InferRequest) -> Result<InferResponse, BackendError> {
        let answer = self.inner.infer(query.clone()).await?;
        let pair = Pair { query, answer: answer.clone() };
        self.write(move |open| open.add(&pair.query.session, &pair)).await;
        Ok(answer)
    }

    async fn infer_batch(
        &self,
        queries: Vec<InferRequest>,
    ) -> Result<Vec<Result<InferResponse, BackendError>>, BackendError> {
        let answers = self.inner.infer_batch(queries.clone()).await?;
        let pairs = queries.into_iter().zip(&answers);
        let pairs: Vec<_> = pairs
            .filter_map(|(query, answer)| {
                let answer = answer.as_ref().ok()?.clone();
                Some(Pair { query, answer })
            })
            .collect();
        self.write(move |open| {
            for pair in &pairs {
                open.add(&pair.query.session, pair);
            }
        })
        .await;
        Ok(answers)
    }
}

impl fmt::Display for Recorder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.inner.fmt(f)
    }
}
