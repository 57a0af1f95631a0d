//! Recordings of sessions: one file each, with all requests to a policy server and its answers.
//! Format:
//!
//! ```text
//! the line "rollout recording 1\n", and then messages of rollout.policy.v1, each
//! preceded by its length in bytes as a varint (protobuf's delimited form):
//!   DescribeResponse   the policy's description
//!   ResetRequest       the episode
//!   InferRequest, InferResponse   … one pair per query, in the order of sending
//! ```
//!
//! A file in progress has the suffix `.partial`, and is renamed when its session ends, so that a
//! file with the final name is complete.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

use prost::Message;
use proto::policy::{DescribeResponse, InferRequest, InferResponse, ResetRequest};
use sha2::{Digest, Sha256};
use thiserror::Error;

const FIRST_LINE: &[u8] = b"rollout recording 1\n";
/// Extension of complete recordings.
pub const SUFFIX: &str = "recording";
/// Largest number of recordings in a folder.
pub const MAX_FILES: usize = 100_000;

#[derive(Clone, Debug, PartialEq)]
pub struct Pair {
    pub query: InferRequest,
    pub answer: InferResponse,
}

#[derive(Debug)]
pub struct Writer {
    file: BufWriter<File>,
    folder: PathBuf,
    name: String,
}

impl Writer {
    /// Starts the recording of a session. An existing recording of the same session is replaced
    /// when the new one is finished.
    pub fn begin(
        folder: &Path,
        described: &DescribeResponse,
        reset: &ResetRequest,
    ) -> io::Result<Self> {
        let name = hex::encode(&Sha256::digest(&reset.session)[..8]);
        let partial = folder.join(format!("{name}.partial"));
        // Removes the file of a killed gateway, or a link, whose target must not be overwritten.
        let _ = std::fs::remove_file(&partial);
        let file = File::create_new(partial)?;
        let mut writer = Self { file: BufWriter::new(file), folder: folder.to_owned(), name };
        writer.file.write_all(FIRST_LINE)?;
        writer.message(described)?;
        writer.message(reset)?;
        Ok(writer)
    }

    /// Adds a pair; returns its size in bytes.
    pub fn add(&mut self, pair: &Pair) -> io::Result<u64> {
        Ok(self.message(&pair.query)? + self.message(&pair.answer)?)
    }

    /// Completes the recording and returns its path. If this fails, the file keeps the suffix
    /// `.partial`.
    pub fn finish(mut self) -> io::Result<PathBuf> {
        self.file.flush()?;
        self.file.get_ref().sync_all()?;
        let complete = self.folder.join(format!("{}.{SUFFIX}", self.name));
        std::fs::rename(self.partial(), &complete)?;
        Ok(complete)
    }

    pub fn discard(self) {
        // If the removal fails, the suffix still marks the file as partial.
        drop(std::fs::remove_file(self.partial()));
    }

    fn partial(&self) -> PathBuf {
        self.folder.join(format!("{}.partial", self.name))
    }

    fn message(&mut self, message: &impl Message) -> io::Result<u64> {
        let bytes = message.encode_length_delimited_to_vec();
        self.file.write_all(&bytes)?;
        Ok(bytes.len() as u64)
    }
}

#[derive(Debug)]
pub struct Reader {
    path: PathBuf,
    file: BufReader<File>,
    pub described: DescribeResponse,
    pub reset: ResetRequest,
}

impl Reader {
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut reader = Self {
            path: path.to_owned(),
            file: BufReader::new(File::open(path).map_err(|source| io_error(path, source))?),
            described: DescribeResponse::default(),
            reset: ResetRequest::default(),
        };
        let mut line = [0; FIRST_LINE.len()];
        let read = reader.file.read_exact(&mut line);
        if read.is_err() || line != FIRST_LINE {
            return Err(reader.broken());
        }
        reader.described = reader.message()?.ok_or_else(|| reader.broken())?;
        reader.reset = reader.message()?.ok_or_else(|| reader.broken())?;
        Ok(reader)
    }

    /// Reads the next pair; `None` at the end.
    pub fn pair(&mut self) -> Result<Option<Pair>, RecordingError> {
        let Some(query) = self.message()? else {
            return Ok(None);
        };
        let answer = self.message()?.ok_or_else(|| self.broken())?;
        Ok(Some(Pair { query, answer }))
    }

    fn message<M: Message + Default>(&mut self) -> Result<Option<M>, RecordingError> {
        let Some(bytes) = self.length()? else {
            return Ok(None);
        };
        let mut message = vec![0; bytes];
        self.file.read_exact(&mut message).map_err(|_| self.broken())?;
        let message = M::decode(message.as_slice());
        message.map(Some).map_err(|_| self.broken())
    }

    /// Reads a message's length; `None` at the end of the file.
    fn length(&mut self) -> Result<Option<usize>, RecordingError> {
        let mut length = 0_usize;
        for position in 0..5 {
            let mut byte = [0];
            match self.file.read(&mut byte) {
                Ok(0) if position == 0 => return Ok(None),
                Ok(1) => {}
                Ok(_) => return Err(self.broken()),
                Err(source) => return Err(io_error(&self.path, source)),
            }
            length |= usize::from(byte[0] & 0x7f) << (7 * position);
            if byte[0] & 0x80 == 0 {
                let fits = length <= proto::MAX_MESSAGE_BYTES;
                return fits.then_some(Some(length)).ok_or_else(|| self.broken());
            }
        }
        Err(self.broken())
    }

    fn broken(&self) -> RecordingError {
        RecordingError::Broken { path: self.path.clone() }
    }
}

/// Returns the recordings of a folder, sorted by name.
pub fn files(folder: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let entries = std::fs::read_dir(folder).map_err(|source| io_error(folder, source))?;
    let mut files = vec![];
    for entry in entries {
        let path = entry.map_err(|source| io_error(folder, source))?.path();
        if path.extension().is_some_and(|extension| extension == SUFFIX) {
            files.push(path);
        }
        if files.len() > MAX_FILES {
            return Err(RecordingError::TooMany { folder: folder.to_owned() });
        }
    }
    files.sort();
    match files.is_empty() {
        false => Ok(files),
        true => Err(RecordingError::NoRecordings { folder: folder.to_owned() }),
    }
}

/// Reason why recordings cannot be used. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum RecordingError {
    #[error("read {path:?}")]
    Io { path: PathBuf, source: io::Error },
    #[error(
        "read {path:?} as a recording: it is damaged or no recording; record the session again"
    )]
    Broken { path: PathBuf },
    #[error(
        "find a recording in {folder:?}: `policy-gateway record --output` makes them, one \
         .{SUFFIX} file per session that has ended"
    )]
    NoRecordings { folder: PathBuf },
    #[error("take more than {MAX_FILES} recordings from {folder:?}: move some to another folder")]
    TooMany { folder: PathBuf },
    #[error(
        "replay {first:?} and {other:?} as one policy: {difference}; give each policy a folder of \
         its own"
    )]
    DifferentPolicies { first: PathBuf, other: PathBuf, difference: String },
}

fn io_error(path: &Path, source: io::Error) -> RecordingError {
    RecordingError::Io { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(query_index: u32) -> Pair {
        Pair {
            query: InferRequest { query_index, ..InferRequest::default() },
            answer: InferResponse { actions: vec![0.5; 7], action_width: 7 },
        }
    }

    fn write(folder: &Path, pairs: u32) -> Writer {
        let described = DescribeResponse { name: "p".to_owned(), ..DescribeResponse::default() };
        let reset = ResetRequest { session: "a/b".to_owned(), seed: 7, ..ResetRequest::default() };
        let mut writer = Writer::begin(folder, &described, &reset).expect("written");
        for query in 0..pairs {
            writer.add(&pair(query)).expect("written");
        }
        writer
    }

    #[test]
    fn a_link_in_place_of_a_partial_recording_is_replaced_and_not_followed() {
        let folder = tempfile::tempdir().expect("a folder");
        let other = folder.path().join("other");
        std::fs::write(&other, "unrelated").expect("written");
        let partial = write(folder.path(), 0).partial();
        std::fs::remove_file(&partial).expect("removed");
        std::os::unix::fs::symlink(&other, &partial).expect("a link");
        let complete = write(folder.path(), 1).finish().expect("written");
        assert!(!complete.is_symlink());
        assert_eq!(std::fs::read(&other).expect("read"), b"unrelated");
    }

    #[test]
    fn a_finished_recording_reads_back_under_its_final_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let writer = write(folder.path(), 2);
        assert!(matches!(files(folder.path()), Err(RecordingError::NoRecordings { .. })));
        writer.finish().expect("finished");
        let [path] = &files(folder.path()).expect("a recording")[..] else {
            panic!("one file");
        };
        let mut reader = Reader::open(path).expect("a recording");
        assert_eq!((reader.described.name.as_str(), reader.reset.seed), ("p", 7));
        assert_eq!(reader.pair().expect("a pair"), Some(pair(0)));
        assert_eq!(reader.pair().expect("a pair"), Some(pair(1)));
        assert_eq!(reader.pair().expect("the end"), None);
    }

    #[test]
    fn a_truncated_file_has_fewer_pairs_or_is_reported_as_damaged() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = write(folder.path(), 2).finish().expect("finished");
        let whole = std::fs::read(&path).expect("read");
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).expect("written");
            let pairs = Reader::open(&path).and_then(|mut reader| {
                let mut pairs = 0;
                while reader.pair()?.is_some() {
                    pairs += 1;
                }
                Ok(pairs)
            });
            match pairs {
                Ok(pairs) => assert!(pairs < 2),
                Err(error) => assert!(matches!(error, RecordingError::Broken { .. }), "{error}"),
            }
        }
    }
}
