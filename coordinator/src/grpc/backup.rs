//! A copy of the database as a stream of pieces.

use std::pin::Pin;

use proto::coordinator as wire;
use tokio::io::AsyncReadExt;
use tokio_stream::Stream;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;

use crate::queue::BackupInHand;

/// Size of a piece, bytes.
const CHUNK_BYTES: usize = 1 << 20;
/// Pieces that wait for a slow reader.
const CHUNKS_AHEAD: usize = 2;

/// The pieces of a backup, which is removed when the last one was sent or the
/// reader has gone.
pub(super) type Chunks = Pin<Box<dyn Stream<Item = Result<wire::BackupChunk, Status>> + Send>>;

pub(super) async fn chunks(backup: BackupInHand) -> Result<Chunks, Status> {
    let unreadable = |error: std::io::Error| {
        tracing::error!("failed to read the backup that was made: {error}");
        Status::unavailable(format!("read the backup that was made: {error}"))
    };
    let path = backup.path();
    let mut file = tokio::fs::File::open(path).await.map_err(unreadable)?;
    let (pieces, stream) = tokio::sync::mpsc::channel(CHUNKS_AHEAD);
    let mut reading = tokio::task::JoinSet::new();
    reading.spawn(async move {
        let _until_read = backup;
        loop {
            let mut data = Vec::with_capacity(CHUNK_BYTES);
            let mut rest = (&mut file).take(CHUNK_BYTES as u64);
            let piece = match rest.read_to_end(&mut data).await {
                Ok(0) => return,
                Ok(_) => Ok(wire::BackupChunk { data }),
                Err(error) => Err(unreadable(error)),
            };
            if pieces.send(piece).await.is_err() {
                return;
            }
        }
    });
    Ok(Box::pin(Owned {
        stream: ReceiverStream::new(stream),
        _reading: reading,
    }))
}

/// A stream and the task that feeds it, which ends with it.
struct Owned {
    stream: ReceiverStream<Result<wire::BackupChunk, Status>>,
    _reading: tokio::task::JoinSet<()>,
}

impl Stream for Owned {
    type Item = Result<wire::BackupChunk, Status>;

    fn poll_next(
        mut self: Pin<&mut Self>,
        cx: &mut std::task::Context<'_>,
    ) -> std::task::Poll<Option<Self::Item>> {
        Pin::new(&mut self.stream).poll_next(cx)
    }
}
