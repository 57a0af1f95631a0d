//! Streams a database backup in chunks.

use proto::coordinator as wire;
use queue::Backup;
use tokio::fs::File;
use tokio_stream::StreamExt;
use tokio_util::io::ReaderStream;
use tonic::Status;

use super::streams::Large;

/// Size of a chunk, bytes.
const CHUNK_BYTES: usize = 1 << 20;

/// Chunks of a backup. The backup file is deleted when the stream is dropped: after the last chunk
/// or when the client disconnects.
pub(super) async fn chunks(backup: Backup) -> Result<Large<wire::BackupChunk>, Status> {
    let file = File::open(backup.path()).await.map_err(unreadable)?;
    let chunks = ReaderStream::with_capacity(file, CHUNK_BYTES);
    Ok(Box::pin(chunks.map(move |chunk| {
        let _until_read = &backup;
        let data = chunk.map_err(unreadable)?.into();
        Ok(wire::BackupChunk { data })
    })))
}

fn unreadable(error: std::io::Error) -> Status {
    tracing::error!("failed to read the copy of the database: {error}");
    Status::unavailable(format!("read the copy of the database: {error}"))
}
