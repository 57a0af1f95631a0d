//! Reads and verifies archives from untrusted sources. Nothing is written before the table of
//! contents has declared the sizes of all members and the disk has room for them, and no member may
//! exceed its declared size. Entries are read raw: the `tar` crate would otherwise load long names
//! and extended headers into memory, however large they claim to be.

use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read};
use std::path::Path;

use flate2::bufread::GzDecoder;
use queue::ids::CampaignName;
use queue::{ARTIFACTS_FOLDER, Portable, PortableError, ROLLOUTS_FILE, film_attempt};
use serde::Deserialize;
use tar::{Archive, Entries, Entry, EntryType};

use super::computed::{self, PROVENANCE, REPORT, SPECIFICATION};
use super::pack::{CopyError, copy_digesting};
use super::{ArchiveError, CONTENTS_FILE, Contents, FORMAT, Member};
use crate::disk::Room;

/// Largest table of contents, bytes: enough for three hundred thousand films.
const MAX_CONTENTS_BYTES: u64 = 64 << 20;
/// Highest compression ratio, against decompression bombs. Films do not compress, and repetitive
/// rows compress to a twentieth.
const MAX_RATIO: u64 = 100;
/// Total size of the members up to which any compression ratio is accepted, bytes.
const SMALL_BYTES: u64 = 64 << 20;
/// Largest padding after the last member, bytes. Tar programs pad archives to a few kilobytes.
const MAX_PADDING_BYTES: u64 = 1 << 20;

/// Problem reported for a file that is not an archive at all.
const NO_TAR: &str = "it is not a compressed tar archive";

/// First members after the table of contents, in order; every archive has them.
const MEMBERS: [&str; 4] = [SPECIFICATION, PROVENANCE, REPORT, ROLLOUTS_FILE];

#[derive(Debug)]
pub struct Unpacked {
    /// Rows and films of the campaign, in a folder of their own.
    pub campaign: Portable,
    pub contents: Contents,
}

type Compressed = GzDecoder<BufReader<File>>;
type Members<'a> = Entries<'a, Compressed>;

/// Unpacks an archive into an empty folder and verifies size and SHA-256 of every member, the
/// version of the format, the specification's digest, all rows and invariants, and that report and
/// provenance follow from the rows. `name` is the file's name in messages. After an
/// error, the members unpacked so far remain in `into`.
pub async fn unpack(
    file: &Path,
    name: &str,
    into: &Path,
    min_free_bytes: u64,
) -> Result<Unpacked, ArchiveError> {
    let (path, archive, folder) = (file.to_owned(), name.to_owned(), into.to_owned());
    let read =
        move || ArchiveReader { archive: &archive, min_free_bytes }.unpack_members(&path, &folder);
    let read = tokio::task::spawn_blocking(read).await;
    let contents = read.map_err(|_| ArchiveError::Panicked { archive: name.to_owned() })??;
    let archive = || name.to_owned();
    let films = contents.members[MEMBERS.len()..].iter();
    let films = films.map(|film| (film.name.as_str(), film.bytes));
    let altered =
        |member, problem| ArchiveReader { archive: name, min_free_bytes }.altered(member, problem);
    let text = |member| {
        let text = std::fs::read_to_string(into.join(member));
        text.map_err(|_| altered(member, "it is not UTF-8 text"))
    };
    let campaign = Portable::open(into, &text(SPECIFICATION)?, films).await;
    let campaign = campaign.map_err(|source| ArchiveError::Content {
        archive: archive(),
        member: match source {
            PortableError::Specification(_) => SPECIFICATION,
            _ => ROLLOUTS_FILE,
        },
        source: Box::new(source),
    })?;
    let unpacked = &campaign.campaign;
    if (unpacked.name.as_str(), &unpacked.spec_digest)
        != (&contents.campaign, &contents.spec_digest)
    {
        return Err(altered(SPECIFICATION, "it is of another campaign"));
    }
    for (member, fresh) in computed::compute(&campaign).await? {
        let archived = text(member)?;
        if let Some(place) = computed::difference(&archived, &fresh) {
            return Err(ArchiveError::Differs {
                archive: archive(),
                member,
                place,
                program: contents.program,
            });
        }
    }
    Ok(Unpacked { campaign, contents })
}

/// Reader of one archive; `archive` is its name in messages.
struct ArchiveReader<'a> {
    archive: &'a str,
    /// Space that the archive must leave free.
    min_free_bytes: u64,
}

impl ArchiveReader<'_> {
    /// Unpacks every member and checks it against the table of contents.
    fn unpack_members(&self, file: &Path, into: &Path) -> Result<Contents, ArchiveError> {
        let unreadable = |source| ArchiveError::Read { archive: self.archive.to_owned(), source };
        let opened = File::open(file).map_err(unreadable)?;
        let compressed_bytes = opened.metadata().map_err(unreadable)?.len();
        let mut tar = Archive::new(GzDecoder::new(BufReader::new(opened)));
        let entries = tar.entries().map_err(|_| self.not_an_archive(NO_TAR))?;
        let mut entries = entries.raw(true);
        let contents = self.read_contents(&mut entries)?;
        self.check_room(&contents, compressed_bytes, into)?;
        for member in &contents.members {
            self.unpack_member(&mut entries, member, into)?;
        }
        if let Some(next) = entries.next() {
            next.map_err(|error| self.read_error("its end", error))?;
            return Err(self.altered("its end", "it holds members that archive.json does not list"));
        }
        // The gzip trailer holds the checksum, so the stream must be read to its very end.
        let mut padding = tar.into_inner().take(MAX_PADDING_BYTES);
        let read = io::copy(&mut padding, &mut io::sink());
        read.map_err(|error| self.read_error("its end", error))?;
        if padding.limit() == 0 {
            return Err(self.altered("its end", "data follows the last member"));
        }
        let mut compressed = padding.into_inner().into_inner();
        let mut byte_after_gzip = [0];
        match compressed.read(&mut byte_after_gzip) {
            Ok(0) => Ok(contents),
            Ok(_) => Err(self.altered("its end", "data follows the last member")),
            Err(error) => Err(self.read_error("its end", error)),
        }
    }

    fn read_contents(&self, entries: &mut Members<'_>) -> Result<Contents, ArchiveError> {
        /// Version fields, parsed first so that another format is reported as such.
        #[derive(Deserialize)]
        struct Versions {
            format: u32,
            program: String,
        }
        let first = entries.next().ok_or_else(|| self.not_an_archive("it holds nothing"))?;
        let mut first = first.map_err(|error| match error.kind() {
            ErrorKind::UnexpectedEof => self.read_error(CONTENTS_FILE, error),
            _ => self.not_an_archive(NO_TAR),
        })?;
        let is_contents = first.path_bytes().as_ref() == CONTENTS_FILE.as_bytes()
            && first.header().entry_type() == EntryType::Regular;
        if !is_contents {
            return Err(self.not_an_archive(format!("it does not begin with {CONTENTS_FILE}")));
        }
        if first.size() > MAX_CONTENTS_BYTES {
            return Err(self.not_an_archive(format!("its {CONTENTS_FILE} exceeds the size limit")));
        }
        let mut text = Vec::new();
        let read = first.read_to_end(&mut text);
        read.map_err(|error| self.read_error(CONTENTS_FILE, error))?;
        let unreadable = |error: serde_json::Error| {
            let problem = benchmark::JsonError::from(error);
            self.not_an_archive(format!("{CONTENTS_FILE}: {problem}"))
        };
        let versions: Versions = serde_json::from_slice(&text).map_err(unreadable)?;
        if versions.format != FORMAT {
            return Err(ArchiveError::OtherVersion {
                archive: self.archive.to_owned(),
                program: versions.program,
                found: versions.format,
            });
        }
        let contents: Contents = serde_json::from_slice(&text).map_err(unreadable)?;
        self.check_names(&contents)?;
        Ok(contents)
    }

    /// Checks that the members are [`MEMBERS`] and then films of the campaign, and that no member's
    /// path leads out of the folder.
    fn check_names(&self, contents: &Contents) -> Result<(), ArchiveError> {
        let refused = |problem: String| Err(self.altered(CONTENTS_FILE, &problem));
        if let Err(error) = CampaignName::parse(&contents.campaign) {
            return refused(error.to_string());
        }
        let names = contents.members.iter().map(|member| member.name.as_str());
        let names: Vec<&str> = names.collect();
        if !names.starts_with(&MEMBERS) {
            return refused(format!("its members do not begin with {}", MEMBERS.join(", ")));
        }
        let films = format!("{ARTIFACTS_FOLDER}/{}/", contents.campaign);
        for name in &names[MEMBERS.len()..] {
            if !name.strip_prefix(films.as_str()).is_some_and(is_film) {
                return refused(format!("`{}` is no film of this campaign", shorten(name)));
            }
        }
        Ok(())
    }

    /// Checks that the disk has room for all members and that the archive is no decompression bomb.
    fn check_room(
        &self,
        contents: &Contents,
        compressed_bytes: u64,
        into: &Path,
    ) -> Result<(), ArchiveError> {
        let sizes = contents.members.iter().map(|member| member.bytes);
        let total = sizes.fold(0, u64::saturating_add);
        let max_total = compressed_bytes.saturating_mul(MAX_RATIO);
        if total > max_total.max(SMALL_BYTES) {
            let problem = format!(
                "it claims {} MiB of members in {} KiB of archive",
                total >> 20,
                compressed_bytes >> 10
            );
            return Err(self.altered(CONTENTS_FILE, &problem));
        }
        std::fs::create_dir_all(into)
            .map_err(|source| ArchiveError::Write { path: into.to_owned(), source })?;
        // The rows count three times: they are stored in a database of their own, then in the
        // coordinator's.
        let rows = contents.members.iter().filter(|member| member.name == ROLLOUTS_FILE);
        let copied =
            rows.fold(0, |sum: u64, rows| sum.saturating_add(rows.bytes.saturating_mul(2)));
        let needed = total.saturating_add(copied).saturating_add(self.min_free_bytes);
        let room = Room::measure(into, needed);
        match room.free_bytes < needed {
            true => Err(ArchiveError::NoRoom {
                archive: self.archive.to_owned(),
                folder: into.to_owned(),
                needed_mib: needed >> 20,
                free_mib: room.free_bytes >> 20,
            }),
            false => Ok(()),
        }
    }

    /// Unpacks the next entry, which must be `member`, and verifies its size and digest.
    fn unpack_member(
        &self,
        entries: &mut Members<'_>,
        member: &Member,
        into: &Path,
    ) -> Result<(), ArchiveError> {
        let name = shorten(&member.name);
        let displaced = || self.altered(name, "another member is in its place");
        let mut entry = self.next_entry(entries, name)?;
        let mut entry_name = entry.path_bytes().into_owned();
        // GNU tar stores a name that is too long for the header in a preceding entry.
        if entry.header().entry_type() == EntryType::GNULongName {
            if entry.size() > member.name.len() as u64 + 1 {
                return Err(displaced());
            }
            entry_name.clear();
            let read = entry.read_to_end(&mut entry_name);
            read.map_err(|error| self.read_error(name, error))?;
            entry_name.pop_if(|last| *last == 0);
            entry = self.next_entry(entries, name)?;
        }
        if entry_name != member.name.as_bytes() || entry.header().entry_type() != EntryType::Regular
        {
            return Err(displaced());
        }
        if entry.size() != member.bytes {
            return Err(self.resized(name, entry.size(), member.bytes));
        }
        let path = into.join(&member.name);
        let written = write(&path, entry);
        let (bytes, sha256) = written.map_err(|error| match error {
            CopyError::Read(error) => self.read_error(name, error),
            CopyError::Write(source) => ArchiveError::Write { path: path.clone(), source },
        })?;
        if bytes != member.bytes {
            return Err(self.resized(name, bytes, member.bytes));
        }
        if sha256 != member.sha256 {
            return Err(self.altered(name, &format!("its SHA-256 is {sha256}")));
        }
        Ok(())
    }

    /// Returns the next raw entry. Errors name `member`, which is expected there.
    fn next_entry<'a>(
        &self,
        entries: &mut Members<'a>,
        member: &str,
    ) -> Result<Entry<'a, Compressed>, ArchiveError> {
        let next = entries.next().transpose();
        let next = next.map_err(|error| self.read_error(member, error))?;
        next.ok_or_else(|| ArchiveError::Damaged {
            archive: self.archive.to_owned(),
            member: member.to_owned(),
        })
    }

    fn not_an_archive(&self, problem: impl ToString) -> ArchiveError {
        ArchiveError::Foreign { archive: self.archive.to_owned(), problem: problem.to_string() }
    }

    fn altered(&self, member: &str, problem: &str) -> ArchiveError {
        ArchiveError::Altered {
            archive: self.archive.to_owned(),
            member: member.to_owned(),
            problem: problem.to_owned(),
        }
    }

    fn resized(&self, member: &str, bytes: u64, listed: u64) -> ArchiveError {
        self.altered(member, &format!("it has {bytes} bytes instead of {listed}"))
    }

    /// Classifies a read error: an error of the operating system means that the file cannot be
    /// read; any other error, that the file's content is damaged.
    fn read_error(&self, member: &str, error: io::Error) -> ArchiveError {
        let archive = self.archive.to_owned();
        match error.raw_os_error() {
            Some(_) => ArchiveError::Read { archive, source: error },
            None => ArchiveError::Damaged { archive, member: member.to_owned() },
        }
    }
}

/// Writes a file; returns its size and SHA-256, hex.
fn write(path: &Path, from: impl Read) -> Result<(u64, String), CopyError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(CopyError::Write)?;
    let file = File::create_new(path).map_err(CopyError::Write)?;
    let copied = copy_digesting(from, &file)?;
    file.sync_all().map_err(CopyError::Write)?;
    Ok(copied)
}

/// Returns true if `file` has the form of the names that this program gives to films. Names of
/// films of LIBERO's family and of suite files contain a colon. Any other extension is refused,
/// since a browser could render the file as a page, and so is any other character, since it could
/// form a path.
fn is_film(file: &str) -> bool {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._-:".contains(&byte);
    film_attempt(file).is_some() && !file.starts_with('.') && file.bytes().all(is_plain)
}

fn shorten(name: &str) -> &str {
    queue::ids::shortened(name, 120)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_archive_that_cannot_be_read_is_told_from_a_full_disk() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        // A folder can be opened as a file, and every read of it fails.
        let unreadable = File::open(folder.path()).expect("a folder");
        let written = write(&folder.path().join("film.mp4"), unreadable);
        let archive = "first.tar.gz";
        let error = match written {
            Err(CopyError::Read(error)) => {
                ArchiveReader { archive, min_free_bytes: 0 }.read_error("film.mp4", error)
            }
            other => panic!("{other:?}"),
        };
        assert!(matches!(error, ArchiveError::Read { .. }), "{error}");
    }
}
