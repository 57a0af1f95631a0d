//! Fetches files of a table into a pack's folder. Every file is held against its
//! SHA-256 before it gets its name, so a folder with some of the files is a sound
//! part of the pack. What has arrived of a file waits in `.incoming`, and the next
//! try, or the next fetch, asks for the rest.

mod receive;

use std::fs::{self, File, TryLockError};
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Duration;

use rollout_types::{Backoff, Waits};

use crate::error::{AssetsError, write_error};
use crate::http::RequestError;
use crate::origin::{Origin, Parcel};
use crate::progress::{Progress, Report};
use crate::table::FileFacts;
use crate::verify::{Difference, VerifiedFolder};

/// Time between two looks at the lock of another fetch.
const LOCK_POLL: Duration = Duration::from_millis(200);
/// Folder inside the pack for what has arrived of a file.
const INCOMING: &str = ".incoming";
/// File inside the pack that the fetch under way has locked.
const LOCK: &str = ".lock";

/// A fetch to do.
pub struct Fetch<'a> {
    /// The place to fetch from.
    pub origin: &'a Origin,
    /// The pack's folder, made if need be.
    pub into: &'a VerifiedFolder,
    /// Waits.
    pub pause: &'a mut dyn FnMut(Duration),
    /// Is told how far the fetch is; says whether to go on.
    pub progress: &'a mut dyn FnMut(Report) -> ControlFlow<()>,
}

/// Outcome of a fetch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fetched {
    /// Files that were there already and are the table's.
    pub present: usize,
    /// Files that were fetched.
    pub fetched: usize,
    /// Files among those that were there before, and altered.
    pub replaced: usize,
    /// Bytes that came over the network for them.
    pub bytes: u64,
}

impl Fetch<'_> {
    /// Sees that `wanted` files are there, and fetches those that are missing or
    /// altered. A fetch of another process into the same folder is waited for.
    ///
    /// # Errors
    /// If files cannot be had or written. Files that arrived whole are kept.
    pub fn run(&mut self, wanted: &[&FileFacts]) -> Result<Fetched, AssetsError> {
        if self.lacking(wanted)?.0.is_empty() {
            let present = wanted.len();
            return Ok(Fetched {
                present,
                ..Fetched::default()
            });
        }
        let incoming = self.into.folder().join(INCOMING);
        fs::create_dir_all(&incoming).map_err(|source| write_error(&incoming, source))?;
        let _lock = self.lock()?;
        // Another process may have fetched them meanwhile.
        let (lacking, replaced) = self.lacking(wanted)?;
        let mut progress = Progress {
            files: 0,
            of_files: lacking.len(),
            bytes: 0,
            of_bytes: lacking
                .iter()
                .map(|file| self.origin.transfer_bytes(file))
                .sum(),
        };
        self.tell(Report::Arriving(progress))?;
        for group in self.origin.groups(&lacking) {
            let (origin, table) = (self.origin, self.into.table());
            let parcel = self.persistently(progress, || origin.locate(table, &group))?;
            self.receive(&parcel, &incoming, &mut progress)?;
        }
        // Not empty where another fetch was interrupted.
        let _ = fs::remove_dir(&incoming);
        Ok(Fetched {
            present: wanted.len() - lacking.len(),
            fetched: lacking.len(),
            replaced,
            bytes: progress.of_bytes,
        })
    }

    /// The files that are missing or altered, and the number of the latter.
    fn lacking<'f>(
        &self,
        wanted: &[&'f FileFacts],
    ) -> Result<(Vec<&'f FileFacts>, usize), AssetsError> {
        let mut lacking = Vec::new();
        let mut altered = 0;
        for file in wanted {
            match self.into.verify(file) {
                Ok(()) => continue,
                Err(Difference::Missing) => {}
                Err(Difference::Size { .. } | Difference::Content) => altered += 1,
                Err(Difference::Unreadable(source)) => {
                    let path = self.into.folder().join(file.path);
                    return Err(AssetsError::Read { path, source });
                }
            }
            lacking.push(*file);
        }
        Ok((lacking, altered))
    }

    /// Keeps other fetches out of the folder for as long as the file lives: two
    /// would mix their bytes.
    fn lock(&mut self) -> Result<File, AssetsError> {
        let path = self.into.folder().join(LOCK);
        let file = File::options().create(true).append(true).open(&path);
        let file = file.map_err(|source| write_error(&path, source))?;
        loop {
            match file.try_lock() {
                // Not every network file system knows locks. Mixed bytes would be
                // noticed, and fetched again.
                Ok(()) | Err(TryLockError::Error(_)) => return Ok(file),
                Err(TryLockError::WouldBlock) => {
                    self.tell(Report::WaitingForAnotherFetch)?;
                    (self.pause)(LOCK_POLL);
                }
            }
        }
    }

    /// Receives all members of a parcel.
    fn receive(
        &mut self,
        parcel: &Parcel<'_>,
        incoming: &Path,
        progress: &mut Progress,
    ) -> Result<(), AssetsError> {
        let mut receiver = receive::Receiver::new(self.origin, parcel, self.into, incoming);
        let mut tries = Tries::default();
        while !receiver.is_done() {
            let before = receiver.gained();
            let outcome = receiver.stream(progress, self.progress);
            if receiver.gained() - before >= receive::GAIN_BYTES {
                tries = Tries::default();
            }
            match outcome {
                Ok(()) => {}
                Err(RequestError::Final(error)) => return Err(error),
                Err(RequestError::Passing { url, problem }) => {
                    self.wait(tries.next(url, problem)?, *progress)?;
                }
            }
        }
        Ok(())
    }

    /// Repeats a request until it succeeds, fails for good, or has failed
    /// [`receive::MAX_TRIES`] times.
    fn persistently<T>(
        &mut self,
        progress: Progress,
        mut request: impl FnMut() -> Result<T, RequestError>,
    ) -> Result<T, AssetsError> {
        let mut tries = Tries::default();
        loop {
            match request() {
                Ok(answer) => return Ok(answer),
                Err(RequestError::Final(error)) => return Err(error),
                Err(RequestError::Passing { url, problem }) => {
                    self.wait(tries.next(url, problem)?, progress)?;
                }
            }
        }
    }

    /// Waits between two tries, unless the caller wants no more.
    fn wait(&mut self, time: Duration, progress: Progress) -> Result<(), AssetsError> {
        self.tell(Report::Arriving(progress))?;
        (self.pause)(time);
        self.tell(Report::Arriving(progress))
    }

    fn tell(&mut self, report: Report) -> Result<(), AssetsError> {
        match (self.progress)(report) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(AssetsError::Interrupted),
        }
    }
}

/// Tries in vain.
struct Tries(Backoff);

impl Default for Tries {
    fn default() -> Self {
        Self(Backoff::new(Waits::USUAL, 0))
    }
}

impl Tries {
    /// Counts one, and says how long to wait after it.
    fn next(&mut self, url: String, problem: String) -> Result<Duration, AssetsError> {
        let wait = self.0.next_wait();
        let tries = self.0.failures();
        if tries == receive::MAX_TRIES {
            return Err(AssetsError::Unreachable {
                url,
                problem,
                tries,
            });
        }
        Ok(wait)
    }
}

#[cfg(test)]
mod tests;
