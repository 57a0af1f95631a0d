//! Writes archives.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use queue::{FilmFile, Portable, ROLLOUTS_FILE, SourceOutcomes};
use sha2::{Digest, Sha256};
use tar::{Builder, EntryType, Header};

use super::computed::{self, Computed};
use super::{ArchiveError, CONTENTS_FILE, Contents, FORMAT, Member};

/// Archive ready to be written: its table of contents and the files of its members.
#[derive(Debug)]
pub struct Package {
    contents: Contents,
    /// Paths of the members, in order.
    files: Vec<PathBuf>,
}

/// Prepares a campaign's archive: computes members from its rows and lists all files. Films are
/// given with the paths of their files; those whose files are missing are left out.
pub async fn package(
    campaign: Portable,
    films: Vec<(FilmFile, PathBuf)>,
    source: Option<SourceOutcomes>,
) -> Result<Package, ArchiveError> {
    let films = films.into_iter().map(|(film, path)| (film.name, path));
    let (members, missing): (Vec<(String, PathBuf)>, Vec<_>) =
        films.partition(|(_, path)| path.is_file());
    if !missing.is_empty() {
        let missing: Vec<String> = missing.into_iter().map(|(name, _)| name).collect();
        tracing::warn!(campaign = %campaign.campaign.name,
            "films left out of the archive because their files are missing: {}",
            missing.join(", "));
    }
    let computed = computed::compute(&campaign).await?;
    let mut contents = Contents {
        format: FORMAT,
        program: format!("coordinator {}", version::version!()),
        campaign: campaign.campaign.name.to_string(),
        spec_digest: campaign.campaign.spec_digest.clone(),
        source,
        members: Vec::new(),
    };
    let folder = campaign.folder().to_owned();
    let name = contents.campaign.clone();
    let listed =
        tokio::task::spawn_blocking(move || list_members(&folder, computed, members)).await;
    let listed = listed.map_err(|_| ArchiveError::Panicked { archive: name })??;
    let (members, files) = listed.into_iter().unzip();
    contents.members = members;
    Ok(Package { contents, files })
}

/// Writes the computed members beside the rollouts. Returns all members with their paths, sizes and
/// digests.
fn list_members(
    folder: &Path,
    computed: Computed,
    films: Vec<(String, PathBuf)>,
) -> Result<Vec<(Member, PathBuf)>, ArchiveError> {
    let mut files = Vec::new();
    for (name, text) in computed {
        let path = folder.join(name);
        std::fs::write(&path, text)
            .map_err(|source| ArchiveError::Write { path: path.clone(), source })?;
        files.push((name.to_owned(), path));
    }
    files.push((ROLLOUTS_FILE.to_owned(), folder.join(ROLLOUTS_FILE)));
    files.extend(films);
    let member = |(name, path): (String, PathBuf)| {
        let file = File::open(&path).map_err(CopyError::Read);
        let digest = file.and_then(|file| copy_digesting(file, io::sink()));
        let (bytes, sha256) = digest.map_err(|error| match error {
            CopyError::Read(error) | CopyError::Write(error) => input_error(&path)(error),
        })?;
        let member = Member { name, bytes, sha256 };
        Ok((member, path))
    };
    files.into_iter().map(member).collect()
}

impl Package {
    pub fn contents(&self) -> &Contents {
        &self.contents
    }

    /// Writes the archive to `out`; `archive` is its path in errors. The output is reproducible:
    /// one release writes the same bytes for the same campaign in the same state.
    pub fn write(&self, out: impl Write, archive: &Path) -> Result<(), ArchiveError> {
        let write_error = |source| ArchiveError::Write { path: archive.to_owned(), source };
        // Fast compression, since films are compressed already and rows compress well at any level.
        let mut tar = Builder::new(GzEncoder::new(out, Compression::fast()));
        let contents = serde_json::to_vec_pretty(&self.contents);
        let contents = contents
            .map_err(|error| ArchiveError::Json { member: CONTENTS_FILE, source: error.into() })?;
        let mut tar_header = header(contents.len() as u64);
        tar.append_data(&mut tar_header, CONTENTS_FILE, contents.as_slice())
            .map_err(write_error)?;
        for (member, path) in self.contents.members.iter().zip(&self.files) {
            let file = File::open(path).map_err(input_error(path))?;
            let mut file = Digesting::new(file.take(member.bytes));
            let mut tar_header = header(member.bytes);
            let appended = tar.append_data(&mut tar_header, &member.name, &mut file);
            appended.map_err(|error| match file.copy_error(error) {
                CopyError::Read(error) => input_error(path)(error),
                CopyError::Write(error) => write_error(error),
            })?;
            if file.finish() != (member.bytes, member.sha256.clone()) {
                let changed = io::Error::other("it has changed since it was listed");
                return Err(input_error(path)(changed));
            }
        }
        let finished = tar.into_inner().and_then(GzEncoder::finish);
        finished.and_then(|mut out| out.flush()).map_err(write_error)
    }
}

/// Returns a tar header without owner and modification time, for reproducible archives.
fn header(bytes: u64) -> Header {
    let mut header = Header::new_gnu();
    header.set_entry_type(EntryType::Regular);
    header.set_mode(0o644);
    header.set_mtime(0);
    header.set_size(bytes);
    header
}

fn input_error(path: &Path) -> impl FnOnce(io::Error) -> ArchiveError {
    let path = path.to_owned();
    move |source| ArchiveError::Input { path, source }
}

/// Error of copying, by the side that failed.
#[derive(Debug)]
pub(super) enum CopyError {
    Read(io::Error),
    Write(io::Error),
}

/// Reader that counts and hashes the bytes read through it.
struct Digesting<R> {
    reader: R,
    bytes: u64,
    digest: Sha256,
    /// True if the last read failed.
    has_failed: bool,
}

impl<R: Read> Digesting<R> {
    fn new(reader: R) -> Digesting<R> {
        Digesting { reader, bytes: 0, digest: Sha256::new(), has_failed: false }
    }

    /// Attributes an error of a copy from this reader to the side that failed.
    fn copy_error(&self, error: io::Error) -> CopyError {
        if self.has_failed { CopyError::Read(error) } else { CopyError::Write(error) }
    }

    /// Returns the number of bytes read and their SHA-256, hex.
    fn finish(self) -> (u64, String) {
        let hex = hex::encode(self.digest.finalize());
        (self.bytes, hex)
    }
}

impl<R: Read> Read for Digesting<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let read = self.reader.read(into);
        self.has_failed = read.is_err();
        let count = read?;
        self.bytes += count as u64;
        self.digest.update(&into[..count]);
        Ok(count)
    }
}

/// Copies all bytes; returns their number and their SHA-256, hex.
pub(super) fn copy_digesting(
    from: impl Read,
    mut to: impl Write,
) -> Result<(u64, String), CopyError> {
    let mut from = Digesting::new(from);
    match io::copy(&mut from, &mut to) {
        Ok(_) => Ok(from.finish()),
        Err(error) => Err(from.copy_error(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Size of the member, bytes.
    const BYTES: u32 = 1 << 20;

    /// Returns the error of writing an archive whose only member is the file `path`.
    fn error(path: &Path, out: impl Write) -> ArchiveError {
        let member =
            Member { name: "film.mp4".to_owned(), bytes: BYTES.into(), sha256: String::new() };
        let contents = Contents {
            format: FORMAT,
            program: String::new(),
            campaign: "first".to_owned(),
            spec_digest: String::new(),
            source: None,
            members: vec![member],
        };
        let files = vec![path.to_owned()];
        let written = Package { contents, files }.write(out, Path::new("first.tar.gz"));
        written.expect_err("a failure")
    }

    #[test]
    fn a_member_that_cannot_be_read_is_told_from_a_full_disk() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        // A folder can be opened as a file, and every read of it fails.
        let unreadable = error(folder.path(), io::sink());
        assert!(matches!(unreadable, ArchiveError::Input { .. }), "{unreadable}");
        // Bytes that do not compress, and room for few of them.
        let film = folder.path().join("film.mp4");
        let words = (0..BYTES / 4).map(|n| n.wrapping_mul(2_654_435_761));
        let bytes: Vec<u8> = words.flat_map(u32::to_le_bytes).collect();
        std::fs::write(&film, bytes).expect("written");
        let full = error(&film, &mut [0_u8; 4_096][..]);
        assert!(matches!(full, ArchiveError::Write { .. }), "{full}");
    }
}
