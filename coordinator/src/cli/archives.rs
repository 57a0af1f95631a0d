//! `coordinator campaign archive|import`: campaigns as archive files.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use coordinator::archive::ArchiveError;
use coordinator::client::Service;
use coordinator::storage::Storage;
use proto::coordinator::{Answer, ArchiveCampaignRequest, ImportChunk};
use queue::ids::CampaignName;
use queue::read::Counts;
use tempfile::TempDir;
use terminal::counted;
use tokio::fs::File;
use tokio_stream::StreamExt;
use tokio_util::io::ReaderStream;
use tonic::{Response, Status};

use super::command::{CommandError, Connection, failure, print_line, usage};
use super::files::AtomicFile;

/// Chunk size of an uploaded archive, bytes.
const CHUNK_BYTES: usize = 1 << 20;

/// Writes a snapshot of a campaign, with its results, films and report, to one file while the
/// coordinator runs. The campaign is not removed: pause or cancel it first if only the imported
/// copy is to continue.
#[derive(Args, Debug)]
pub(super) struct ArchiveArguments {
    /// Name of the campaign.
    campaign: String,
    /// File to write, on this machine or at s3://BUCKET/…, as NAME.tar.gz; an existing file is
    /// replaced only by a complete archive.
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    #[command(flatten)]
    connection: Connection,
}

/// Verifies an archive and adds its campaign to a coordinator, which runs the remaining rollouts. A
/// campaign that was paused stays paused until it is resumed.
#[derive(Args, Debug)]
pub(super) struct ImportArguments {
    /// The archive, on this machine or at s3://BUCKET/….
    file: PathBuf,
    /// New name of the campaign, if this coordinator already has a campaign of the archived name.
    #[arg(long = "as", alias = "name", value_name = "NAME", value_parser = campaign_name)]
    name: Option<CampaignName>,
    #[command(flatten)]
    connection: Connection,
}

fn campaign_name(name: &str) -> Result<CampaignName, String> {
    CampaignName::parse(name).map_err(|error| error.to_string())
}

pub(super) async fn archive(arguments: ArchiveArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let request = ArchiveCampaignRequest { campaign: arguments.campaign.clone() };
    let remote = RemoteObject::from_argument(&arguments.output)?;
    let mut chunks = client.call(request, Service::archive_campaign).await?;
    let output = remote.as_ref().map_or(&arguments.output, |object| &object.file);
    let mut file = AtomicFile::create(output)?;
    let mut size_bytes = 0;
    while let Some(chunk) = client.next(&mut chunks).await? {
        let written = file.writer().write_all(&chunk.data);
        written.with_context(|| format!("write {}", output.display()))?;
        size_bytes += chunk.data.len();
    }
    file.finish()?;
    if let Some(remote) = &remote {
        let put = remote.storage.put(&remote.name, &remote.file).await;
        put.map_err(failure)?;
    }
    let (name, path) = (&arguments.campaign, arguments.output.display());
    Ok(print_line(&format!("wrote campaign {name} to {path}: {size_bytes} bytes"))?)
}

pub(super) async fn import(arguments: ImportArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let remote = RemoteObject::from_argument(&arguments.file)?;
    if let Some(remote) = &remote {
        let fetched = remote.storage.fetch(&remote.name, None, &remote.file).await;
        if !fetched.map_err(failure)? {
            let (name, location) = (&remote.name, remote.storage.location());
            let error = anyhow!("there is no such object");
            return Err(usage(error.context(format!("fetch {name} from {location}"))));
        }
    }
    let path = remote.as_ref().map_or(&arguments.file, |object| &object.file);
    // An unreadable file is a usage error; it is detected before the coordinator is contacted.
    File::open(path).await.map_err(|error| {
        usage(ArchiveError::Read { archive: path.display().to_string(), source: error })
    })?;
    let first_chunk = ImportChunk {
        name: arguments.name.map_or_else(String::new, |name| name.to_string()),
        archive: arguments.file.display().to_string(),
        data: Vec::new(),
    };
    let send = async |service: &mut Service, first_chunk| send(service, path, first_chunk).await;
    let (campaign, counts, films): (String, Counts, u64) = client.ask(first_chunk, send).await?;
    Ok(print_line(&format!(
        "campaign {campaign} imported: {}, {} and {}",
        counted(counts.total(), "rollout"),
        counted(counts.committed, "result"),
        counted(films, "film"),
    ))?)
}

/// Uploads an archive after `first_chunk`, which holds the campaign's new name and the archive's
/// name, but no data. Every retry of the call starts from the beginning of the file.
async fn send(
    service: &mut Service,
    path: &Path,
    first_chunk: ImportChunk,
) -> Result<Response<Answer>, Status> {
    let file = File::open(path).await?;
    let chunks = ReaderStream::with_capacity(file, CHUNK_BYTES);
    // A read error ends the stream early; the coordinator then rejects the archive as truncated.
    let chunks = chunks
        .map_while(Result::ok)
        .map(|data| ImportChunk { data: data.into(), ..ImportChunk::default() });
    let chunks = tokio_stream::iter([first_chunk]).chain(chunks);
    service.import_campaign(chunks).await
}

/// Object in remote storage, with the local temporary file that is uploaded to it or downloaded
/// from it.
struct RemoteObject {
    storage: Storage,
    name: String,
    file: PathBuf,
    _folder: TempDir,
}

impl RemoteObject {
    /// Returns the remote object that an argument names; `None` if it names a local file.
    fn from_argument(argument: &Path) -> Result<Option<RemoteObject>, CommandError> {
        let address = argument.to_string_lossy();
        if !Storage::is_remote(&address) {
            return Ok(None);
        }
        let (storage, name) = Storage::of_object(&address).map_err(usage)?;
        let folder = tempfile::tempdir().context("make a temporary folder")?;
        Ok(Some(RemoteObject {
            storage,
            name,
            file: folder.path().join("archive.tar.gz"),
            _folder: folder,
        }))
    }
}
