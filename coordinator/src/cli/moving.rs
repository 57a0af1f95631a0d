//! `coordinator campaign archive|import` and `coordinator merge`: campaigns as archive files.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use clap::Args;
use coordinator::archive::{ArchiveError, MOVING_PREFIX, MergedArchive, Unpacked, package, unpack};
use coordinator::client::Service;
use coordinator::storage::Storage;
use proto::coordinator::{ArchiveCampaignRequest, ImportCampaignResponse, ImportChunk};
use queue::ids::CampaignName;
use queue::{DATABASE_FILE, MergeError, Merged, merge as merge_campaigns};
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

#[derive(Args, Debug)]
pub(super) struct MergeArguments {
    /// Archives of parts of one design, two or more.
    #[arg(required = true, num_args = 2.., value_name = "ARCHIVE")]
    archives: Vec<PathBuf>,
    /// Archive to write.
    #[arg(long, value_name = "FILE")]
    output: PathBuf,
    /// Name of the merged campaign. [default: the name in the first archive]
    #[arg(long = "as", alias = "name", value_name = "NAME", value_parser = campaign_name)]
    name: Option<CampaignName>,
}

fn campaign_name(name: &str) -> Result<CampaignName, String> {
    CampaignName::parse(name).map_err(|error| error.to_string())
}

pub(super) async fn archive(arguments: ArchiveArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let request = ArchiveCampaignRequest { campaign: arguments.campaign.clone() };
    let mut chunks = client.call(request, Service::archive_campaign).await?;
    let remote = RemoteObject::from_argument(&arguments.output)?;
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
    let imported = client.call(first_chunk, send).await?;
    Ok(print_line(&format!(
        "campaign {} imported: {}, {} and {}",
        imported.campaign,
        counted(imported.jobs, "rollout"),
        counted(imported.results, "result"),
        counted(imported.films, "film"),
    ))?)
}

pub(super) async fn merge(arguments: MergeArguments) -> Result<(), CommandError> {
    let output = &arguments.output;
    // The archives are unpacked beside the output file, since its disk needs free space for the
    // merged archive anyway.
    let parent_folder = match output.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    let folder = tempfile::Builder::new()
        .prefix(MOVING_PREFIX)
        .tempdir_in(parent_folder)
        .with_context(|| format!("make a folder in {}", parent_folder.display()))?;
    let mut archives = arguments.archives.iter().enumerate();
    let Some((_, first)) = archives.next() else {
        return Ok(());
    };
    let mut combined = read_archive(first, &folder, 0).await?;
    let mut inputs = vec![describe_input(&combined)];
    let mut merged = Merged::default();
    let mut repeated = 0;
    for (number, path) in archives {
        let next = read_archive(path, &folder, number).await?;
        inputs.push(describe_input(&next));
        let into = folder.path().join(format!("merged-{number}"));
        let name = arguments.name.as_ref();
        let result = merge_campaigns(&combined.campaign, &next.campaign, &into, name).await;
        let (campaign, counts) = result.map_err(|error| merge_error(error, first, path))?;
        repeated += counts.both;
        merged = counts;
        move_films(&into, &campaign, [&combined, &next]).await?;
        combined = Unpacked { campaign, contents: combined.contents };
    }
    let folder_of_films = combined.campaign.folder().to_owned();
    let artifacts = folder_of_films.join(queue::ARTIFACTS_FOLDER);
    let films = artifacts.join(combined.campaign.campaign.name.as_str());
    let name = combined.campaign.campaign.name.clone();
    let package = package(combined.campaign, |film| films.join(film), None, inputs).await;
    let package = package.map_err(failure)?;
    let mut file = AtomicFile::create(output)?;
    package.write(file.writer(), output).map_err(failure)?;
    file.finish()?;
    let Merged { quarantined, open, .. } = merged;
    Ok(print_line(&format!(
        "merged {} archives into campaign {name}: {} with an outcome, {repeated} outcomes \
         repeated by later archives; {quarantined} in quarantine, {open} still to run; \
         wrote {}",
        arguments.archives.len(),
        counted(merged.first + merged.second + merged.both, "rollout"),
        output.display()
    ))?)
}

/// Uploads an archive after `first_chunk`, which holds the campaign's new name and the archive's
/// name, but no data. Every retry of the call starts from the beginning of the file.
async fn send(
    service: &mut Service,
    path: &Path,
    first_chunk: ImportChunk,
) -> Result<Response<ImportCampaignResponse>, Status> {
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

async fn read_archive(
    path: &Path,
    folder: &TempDir,
    number: usize,
) -> Result<Unpacked, CommandError> {
    let into = folder.path().join(format!("archive-{number}"));
    let unpacked = unpack(path, &path.display().to_string(), &into).await;
    unpacked.map_err(|error| match error {
        ArchiveError::Read { .. } => usage(error),
        error => failure(error),
    })
}

/// Describes an input archive for the table of contents of the merged archive.
fn describe_input(archive: &Unpacked) -> MergedArchive {
    let members = &archive.contents.members;
    let database = members.iter().find(|member| member.name == DATABASE_FILE);
    MergedArchive {
        campaign: archive.contents.campaign.clone(),
        program: archive.contents.program.clone(),
        database: database.map_or_else(String::new, |member| member.sha256.clone()),
    }
}

/// Moves the films of two archives to their paths in the merged campaign.
async fn move_films(
    into: &Path,
    campaign: &queue::Portable,
    inputs: [&Unpacked; 2],
) -> anyhow::Result<()> {
    for film in campaign.films().await? {
        let path = into.join(&film.path);
        let name = path.file_name().unwrap_or_default();
        let folder = path.parent().unwrap_or(into);
        std::fs::create_dir_all(folder).with_context(|| format!("make {}", folder.display()))?;
        for input in inputs {
            let artifacts = input.campaign.folder().join(queue::ARTIFACTS_FOLDER);
            let from = artifacts.join(input.campaign.campaign.name.as_str()).join(name);
            if from.is_file() {
                let moved = std::fs::rename(&from, &path);
                moved.with_context(|| format!("move film {}", from.display()))?;
                break;
            }
        }
    }
    Ok(())
}

fn merge_error(error: MergeError, first: &Path, second: &Path) -> CommandError {
    let error = anyhow::Error::from(error);
    let (first, second) = (first.display(), second.display());
    failure(error.context(format!("merge {second} with the archives from {first} on")))
}
