//! Export and import of campaigns as archives, streamed in chunks.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use proto::coordinator as wire;
use queue::ids::{CampaignName, shortened};
use queue::read::Counts;
use queue::{AdoptError, CopyError, FilmFile, MOVING_PREFIX, PortableError, Queue};
use tempfile::TempDir;
use tokio::io::AsyncWriteExt;
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tonic::{Code, Status, Streaming};
use transport::chain;

use super::detached::Detached;
use super::failure::{check_room, failed, invalid};
use super::streams::Large;
use crate::archive::{ArchiveError, Package, package, unpack};
use crate::storage::Storage;

/// Size of a chunk, bytes.
const CHUNK_BYTES: usize = 1 << 20;
/// Most chunks buffered for a slow reader.
const MAX_BUFFERED_CHUNKS: usize = 4;
/// Longest wait for the next chunk of an upload.
const MAX_CHUNK_WAIT: Duration = Duration::from_secs(30);
/// Longest file name quoted in a message, bytes.
const MAX_FILE_NAME_BYTES: usize = 200;

pub(super) async fn archive(
    queue: &Arc<Queue>,
    storage: Option<&Storage>,
    name: &CampaignName,
) -> Result<Large<wire::ArchiveChunk>, Status> {
    let data = queue.store().folder();
    let folder = moving_folder(data)?;
    let (copy, films) = queue.copy_campaign(name, folder.path()).await.map_err(copy_failed)?;
    let source = queue.source_outcomes(&copy.spec).await.map_err(failed)?;
    let mut files = Vec::new();
    for film in films {
        let mut path = data.join(&film.path);
        if let (Some(storage), false) = (storage, path.is_file()) {
            path = folder.path().join(&film.name);
            fetch_film(storage, &film, &path).await?;
        }
        files.push((film, path));
    }
    let package = package(copy, files, source).await;
    let package = package.map_err(archive_failed)?;
    Ok(chunks(package, folder, name))
}

/// Downloads a film that was moved from the data folder to the storage. One that is missing there,
/// too, is left out of the archive; any other error fails the export.
async fn fetch_film(storage: &Storage, film: &FilmFile, into: &Path) -> Result<(), Status> {
    let folder = into.parent().unwrap_or(into);
    std::fs::create_dir_all(folder).map_err(|error| folder_failed(folder, &error))?;
    let fetched = storage.fetch(&film.path, Some(film.size_bytes), into).await;
    fetched.map(drop).map_err(|error| unavailable(&error))
}

/// Streams an archive, which a blocking thread writes as fast as the client reads.
fn chunks(package: Package, folder: TempDir, name: &CampaignName) -> Large<wire::ArchiveChunk> {
    let (sender, receiver) = mpsc::channel(MAX_BUFFERED_CHUNKS);
    let archive = format!("of campaign {name}");
    let writing = tokio::task::spawn_blocking(move || {
        // Keeps the temporary folder until the last chunk is sent.
        let _until_written = &folder;
        let mut out = ChunkWriter { buffer: Vec::with_capacity(CHUNK_BYTES), sender };
        package.write(&mut out, Path::new(&archive))
    });
    let state = (receiver, Some(writing));
    Box::pin(futures_util::stream::unfold(state, |(mut receiver, writing)| async move {
        if let Some(data) = receiver.recv().await {
            return Some((Ok(wire::ArchiveChunk { data }), (receiver, writing)));
        }
        // The writer's result is awaited: a failure must end the stream with an error, or the
        // client would take a truncated archive for complete.
        let status = match writing?.await {
            Ok(Ok(())) => return None,
            Ok(Err(error)) => archive_failed(error),
            Err(_) => Status::internal("write the archive: a thread panicked"),
        };
        Some((Err(status), (receiver, None)))
    }))
}

/// Writer that sends its data into a channel in chunks.
struct ChunkWriter {
    buffer: Vec<u8>,
    sender: mpsc::Sender<Vec<u8>>,
}

impl Write for ChunkWriter {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        let room = CHUNK_BYTES - self.buffer.len();
        let accepted = &data[..data.len().min(room)];
        self.buffer.extend_from_slice(accepted);
        if self.buffer.len() == CHUNK_BYTES {
            self.flush()?;
        }
        Ok(accepted.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        let next = Vec::with_capacity(CHUNK_BYTES);
        let chunk = std::mem::replace(&mut self.buffer, next);
        let sent = self.sender.blocking_send(chunk);
        sent.map_err(|_| io::Error::other("the client has disconnected"))
    }
}

/// Receives an uploaded archive, verifies it and adds its campaign to the queue. Returns the
/// campaign's name, its counts and the number of its films.
pub(super) async fn import(
    queue: &Arc<Queue>,
    changes: &Detached,
    mut chunks: Streaming<wire::ImportChunk>,
    min_free_bytes: u64,
) -> Result<(String, Counts, u64), Status> {
    let first = next_chunk(&mut chunks).await?;
    let first = first.ok_or_else(|| invalid("import the archive: the upload is empty"))?;
    let name = match first.name.as_str() {
        "" => None,
        name => Some(CampaignName::parse(name).map_err(invalid)?),
    };
    let archive = match shortened(&first.archive, MAX_FILE_NAME_BYTES) {
        "" => "without a name",
        archive => archive,
    };
    let folder = moving_folder(queue.store().folder())?;
    let file = folder.path().join("archive");
    receive(&file, &first.data, &mut chunks, min_free_bytes).await?;
    let unpack_folder = folder.path().join("unpacked");
    let unpacked = unpack(&file, archive, &unpack_folder, min_free_bytes).await;
    let unpacked = unpacked.map_err(archive_failed)?;
    let films = unpacked.campaign.films();
    let queue = queue.clone();
    let adopted = async move {
        // Keeps the temporary folder until the films have been moved out of it.
        let _until_adopted = folder;
        let source = unpacked.contents.source.as_ref();
        queue.adopt(&unpacked.campaign, source, name.as_ref()).await
    };
    let (campaign, counts) = changes.run(adopted).await?.map_err(adopt_failed)?;
    Ok((campaign.to_string(), counts, films))
}

async fn receive(
    path: &Path,
    first: &[u8],
    chunks: &mut Streaming<wire::ImportChunk>,
    min_free_bytes: u64,
) -> Result<(), Status> {
    let unwritable = |error: io::Error| {
        tracing::error!("failed to write {}: {error}", path.display());
        Status::unavailable(format!(
            "write the archive into the coordinator's data folder: {error}; make room on its disk"
        ))
    };
    let folder = path.parent().unwrap_or(path);
    let mut file = tokio::fs::File::create(path).await.map_err(unwritable)?;
    file.write_all(first).await.map_err(unwritable)?;
    while let Some(chunk) = next_chunk(chunks).await? {
        check_room(folder, min_free_bytes, "receive the archive")?;
        file.write_all(&chunk.data).await.map_err(unwritable)?;
    }
    file.flush().await.map_err(unwritable)
}

async fn next_chunk(
    chunks: &mut Streaming<wire::ImportChunk>,
) -> Result<Option<wire::ImportChunk>, Status> {
    match tokio::time::timeout(MAX_CHUNK_WAIT, chunks.next()).await {
        Ok(chunk) => chunk.transpose(),
        Err(_) => Err(Status::deadline_exceeded(format!(
            "receive the archive: no chunk arrived within {MAX_CHUNK_WAIT:?}"
        ))),
    }
}

/// Creates a temporary folder in the data folder, deleted on drop or, after a crash, at the next
/// start. It is on the data folder's disk, so that films can be renamed instead of copied.
fn moving_folder(data: &Path) -> Result<TempDir, Status> {
    let folder = tempfile::Builder::new().prefix(MOVING_PREFIX).tempdir_in(data);
    folder.map_err(|error| folder_failed(data, &error))
}

/// Logs that a folder cannot be made and returns a status upon which the client retries.
fn folder_failed(folder: &Path, error: &io::Error) -> Status {
    tracing::error!("failed to make a folder in {}: {error}", folder.display());
    Status::unavailable(format!(
        "make a folder in the coordinator's data folder: {error}; make room on its disk"
    ))
}

fn copy_failed(error: CopyError) -> Status {
    match error {
        CopyError::Queue(error) => failed(error),
        CopyError::Portable(error) => unavailable(&error),
    }
}

fn adopt_failed(error: AdoptError) -> Status {
    let code = match error {
        AdoptError::Queue(error) => return failed(error),
        AdoptError::Exists { .. } => Code::AlreadyExists,
        AdoptError::Ahead { .. }
        | AdoptError::NoSource { .. }
        | AdoptError::OtherSource { .. }
        | AdoptError::OtherBudgets { .. } => Code::FailedPrecondition,
        AdoptError::Film { .. } | AdoptError::Portable(_) => return unavailable(&error),
    };
    Status::new(code, chain(&error))
}

fn archive_failed(error: ArchiveError) -> Status {
    match error {
        ArchiveError::Foreign { .. }
        | ArchiveError::OtherVersion { .. }
        | ArchiveError::Damaged { .. }
        | ArchiveError::Altered { .. }
        | ArchiveError::Differs { .. } => invalid(chain(&error)),
        ArchiveError::Content { ref source, .. }
            if !matches!(**source, PortableError::Store(_) | PortableError::Open(_)) =>
        {
            invalid(chain(&error))
        }
        ArchiveError::Results(error) => failed(error),
        // The code is not Unavailable, upon which clients would retry.
        ArchiveError::NoRoom { .. } => Status::resource_exhausted(chain(&error)),
        error => unavailable(&error),
    }
}

/// Logs the error for the operator and returns a status upon which the client retries.
fn unavailable(error: &(dyn std::error::Error + 'static)) -> Status {
    tracing::error!("failed to {}", chain(error));
    Status::unavailable(chain(error))
}
