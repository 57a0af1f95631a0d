//! Reception of the files in one parcel, in the order of their positions.

use std::collections::HashMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::ops::ControlFlow;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use flate2::read::DeflateDecoder;
use rustix::fs::OFlags;
use sha2::{Digest, Sha256};

use crate::assets::error::{AssetsError, write_error};
use crate::assets::http::RequestError;
use crate::assets::origin::{Member, Origin, Parcel, Stream};
use crate::assets::progress::{Progress, Report};
use crate::assets::verify::VerifiedFolder;

pub(super) const MAX_TRIES: u32 = 5;
/// Files with gaps up to this size between them are requested together.
const MAX_GAP_BYTES: u64 = 1 << 18;
const BLOCK_BYTES: usize = 1 << 16;

type ProgressCallback<'a> = dyn FnMut(Report) -> ControlFlow<()> + 'a;

pub(super) struct Receiver<'a> {
    origin: &'a Origin,
    parcel: &'a Parcel<'a>,
    into: &'a VerifiedFolder,
    incoming: &'a Path,
    done: usize,
    /// False once the server has answered a range request with the whole parcel.
    supports_ranges: bool,
    received_bytes: u64,
    corruptions: HashMap<&'static str, u32>,
}

impl<'a> Receiver<'a> {
    pub(super) fn new(
        origin: &'a Origin,
        parcel: &'a Parcel<'a>,
        into: &'a VerifiedFolder,
        incoming: &'a Path,
    ) -> Self {
        Self {
            origin,
            parcel,
            into,
            incoming,
            done: 0,
            supports_ranges: true,
            received_bytes: 0,
            corruptions: HashMap::new(),
        }
    }

    pub(super) fn is_done(&self) -> bool {
        self.done == self.parcel.members.len()
    }

    pub(super) fn received_bytes(&self) -> u64 {
        self.received_bytes
    }

    pub(super) fn stream(
        &mut self,
        progress: &mut Progress,
        on_progress: &mut ProgressCallback<'_>,
    ) -> Result<(), RequestError> {
        let first = self.parcel.members[self.done];
        let present = received_size(&self.partial_path(&first));
        if present >= first.stored {
            // An earlier fetch ended between the last byte and the rename.
            return self.finish(&first, progress, on_progress);
        }
        let end = self.end_of_contiguous_range();
        let from = first.offset + present;
        let mut stream = self.origin.open(self.parcel, from..end)?;
        self.supports_ranges &= stream.position == from;
        let end = if self.supports_ranges { end } else { self.parcel.bytes };
        while let Some(member) = self.parcel.members.get(self.done)
            && member.offset + member.stored <= end
        {
            let member = *member;
            self.fill(&member, &mut stream, progress, on_progress)?;
            self.finish(&member, progress, on_progress)?;
        }
        Ok(())
    }

    fn end_of_contiguous_range(&self) -> u64 {
        if !self.supports_ranges {
            return self.parcel.bytes;
        }
        let mut members = self.parcel.members[self.done..].iter();
        let first = members.next().expect("a file is left");
        let mut end = first.offset + first.stored;
        for member in members {
            if member.offset > end + MAX_GAP_BYTES {
                break;
            }
            end = member.offset + member.stored;
        }
        end
    }

    fn fill(
        &mut self,
        member: &Member<'_>,
        stream: &mut Stream,
        progress: &Progress,
        on_progress: &mut ProgressCallback<'_>,
    ) -> Result<(), RequestError> {
        let path = self.partial_path(member);
        let mut present = received_size(&path);
        let failed = |source| RequestError::Permanent(write_error(&path, source));
        let mut block = vec![0; BLOCK_BYTES];
        let skip = (member.offset + present).saturating_sub(stream.position);
        self.read(stream, skip, &mut block, |_| send_progress(on_progress, *progress))?;
        let file =
            OpenOptions::new().create(true).append(true).custom_flags(no_links()).open(&path);
        let mut file = file.map_err(failed)?;
        let missing = member.stored.saturating_sub(present);
        let mut received_bytes = 0;
        let outcome = self.read(stream, missing, &mut block, |bytes| {
            file.write_all(bytes).map_err(failed)?;
            present += bytes.len() as u64;
            received_bytes += bytes.len() as u64;
            let bytes = progress.bytes + present;
            send_progress(on_progress, Progress { bytes, ..*progress })
        });
        self.received_bytes += received_bytes;
        outcome
    }

    fn read(
        &self,
        stream: &mut Stream,
        mut count: u64,
        block: &mut [u8],
        mut take: impl FnMut(&[u8]) -> Result<(), RequestError>,
    ) -> Result<(), RequestError> {
        let transient =
            |problem: String| RequestError::Transient { url: self.parcel.name.clone(), problem };
        while count > 0 {
            let most = usize::try_from(count).map_or(block.len(), |count| count.min(block.len()));
            match stream.reader.read(&mut block[..most]) {
                Ok(0) => {
                    let (at, of) = (stream.position, self.parcel.bytes);
                    return Err(transient(format!("the answer ended after {at} of {of} bytes")));
                }
                Ok(read) => {
                    stream.position += read as u64;
                    count -= read as u64;
                    take(&block[..read])?;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => {
                    let (at, of) = (stream.position, self.parcel.bytes);
                    return Err(transient(format!("{error} after {at} of {of} bytes")));
                }
            }
        }
        Ok(())
    }

    fn finish(
        &mut self,
        member: &Member<'_>,
        progress: &mut Progress,
        on_progress: &mut ProgressCallback<'_>,
    ) -> Result<(), RequestError> {
        let part = self.partial_path(member);
        let whole = part.with_extension("whole");
        let target = self.into.folder().join(member.file.path);
        let unpacked = unpack(member, &part, &whole);
        if unpacked.is_err() {
            // On a full disk, the incomplete file would only take up space.
            let _ = fs::remove_file(&whole);
        }
        if let Some(problem) = unpacked.map_err(RequestError::Permanent)? {
            let removed = fs::remove_file(&part).and_then(|()| fs::remove_file(&whole));
            removed.map_err(|source| RequestError::Permanent(write_error(&part, source)))?;
            return Err(self.count_corruption(member, problem));
        }
        let folder = target.parent().expect("inside the pack");
        let renamed = fs::create_dir_all(folder).and_then(|()| fs::rename(&whole, &target));
        renamed.map_err(|source| RequestError::Permanent(write_error(&target, source)))?;
        let removed = fs::remove_file(&part);
        removed.map_err(|source| RequestError::Permanent(write_error(&part, source)))?;
        self.done += 1;
        progress.files += 1;
        progress.bytes += member.stored;
        send_progress(on_progress, *progress)
    }

    /// Permanent after [`MAX_TRIES`], and at once for a local folder.
    fn count_corruption(&mut self, member: &Member<'_>, problem: String) -> RequestError {
        let tries = self.corruptions.entry(member.file.path).or_default();
        *tries += 1;
        let (tries, url) = (*tries, self.parcel.name.clone());
        if tries < MAX_TRIES && self.origin.is_remote() {
            return RequestError::Transient { url, problem };
        }
        RequestError::Permanent(AssetsError::Altered {
            file: member.file.path.to_owned(),
            url,
            problem,
            tries,
        })
    }

    fn partial_path(&self, member: &Member<'_>) -> PathBuf {
        let kind = if member.is_deflated { "deflated" } else { "plain" };
        self.incoming.join(format!("{}-{kind}.part", member.file.sha256))
    }
}

/// Returns the difference from the table, if there is one.
fn unpack(member: &Member<'_>, part: &Path, whole: &Path) -> Result<Option<String>, AssetsError> {
    let source = OpenOptions::new().read(true).custom_flags(no_links()).open(part);
    let source = source.map_err(|source| AssetsError::Read { path: part.to_owned(), source })?;
    let mut source: Box<dyn Read> = match member.is_deflated {
        true => Box::new(DeflateDecoder::new(source)),
        false => Box::new(source),
    };
    let failed = |source| write_error(whole, source);
    // A fetch that was killed may have left this file, or another user a symbolic link.
    let _ = fs::remove_file(whole);
    let mut file = File::create_new(whole).map_err(failed)?;
    let mut hash = Sha256::new();
    let mut bytes = 0;
    let mut block = vec![0; BLOCK_BYTES];
    // Stops once the expected size is exceeded, since the data may be endless.
    while bytes <= member.file.bytes {
        match source.read(&mut block) {
            Ok(0) => break,
            Ok(read) => {
                file.write_all(&block[..read]).map_err(failed)?;
                hash.update(&block[..read]);
                bytes += read as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Ok(Some(format!("the file cannot be unpacked ({error})"))),
        }
    }
    if bytes != member.file.bytes {
        let expected = member.file.bytes;
        return Ok(Some(format!("the file does not have the expected size of {expected} bytes")));
    }
    let (found, expected) = (hex::encode(hash.finalize()), member.file.sha256);
    let differs = found != expected;
    Ok(differs.then(|| format!("the SHA-256 is {found} and should be {expected}")))
}

fn send_progress(
    on_progress: &mut ProgressCallback<'_>,
    progress: Progress,
) -> Result<(), RequestError> {
    match on_progress(Report::Arriving(progress)) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(RequestError::Permanent(AssetsError::Interrupted)),
    }
}

/// A link by another user could point to a file of this user.
pub(super) fn no_links() -> i32 {
    OFlags::NOFOLLOW.bits() as i32
}

/// Returns the size of a partially received file; 0 if there is none. Removes a symbolic link,
/// since its target was not received, and a pipe, since opening it would block.
fn received_size(path: &Path) -> u64 {
    match fs::symlink_metadata(path) {
        Ok(metadata) if !metadata.is_file() => {
            let _ = fs::remove_file(path);
            0
        }
        metadata => metadata.map_or(0, |metadata| metadata.len()),
    }
}
