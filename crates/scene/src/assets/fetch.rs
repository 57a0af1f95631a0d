//! Fetches files of a table into a pack's folder. Every file is checked against its SHA-256 before
//! it gets its final name, so an incomplete folder is a valid part of the pack. Partially received
//! files stay in `.incoming`, and the next try or fetch resumes them.

mod receive;

use std::fs::{self, File, TryLockError};
use std::ops::ControlFlow;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::Duration;

use benchmark::attempt::{Backoff, Waits};

use crate::assets::error::{AssetsError, write_error};
use crate::assets::http::{GAIN_BYTES, RequestError};
use crate::assets::origin::{Origin, Parcel};
use crate::assets::progress::{Progress, Report};
use crate::assets::table::FileFacts;
use crate::assets::verify::{Difference, VerifiedFolder};

const LOCK_POLL: Duration = Duration::from_millis(200);
const INCOMING: &str = ".incoming";
const LOCK: &str = ".lock";

pub struct Fetch<'a> {
    pub origin: &'a Origin,
    /// Folder of the pack, created if necessary.
    pub into: &'a VerifiedFolder,
    pub pause: &'a mut dyn FnMut(Duration),
    /// Receives progress reports; returns whether to continue.
    pub progress: &'a mut dyn FnMut(Report) -> ControlFlow<()>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fetched {
    pub present: usize,
    pub fetched: usize,
    pub replaced: usize,
    /// Bytes as stored by the origin; includes parts that an earlier fetch had received.
    pub bytes: u64,
}

impl Fetch<'_> {
    /// Waits for another process that fetches into the same folder.
    pub fn run(&mut self, wanted: &[&FileFacts]) -> Result<Fetched, AssetsError> {
        if self.files_to_fetch(wanted)?.0.is_empty() {
            let present = wanted.len();
            return Ok(Fetched { present, ..Fetched::default() });
        }
        let incoming = self.into.folder().join(INCOMING);
        fs::create_dir_all(&incoming).map_err(|source| write_error(&incoming, source))?;
        let _lock = self.lock()?;
        // Another process may have fetched the files while this process waited for the lock.
        let (to_fetch, replaced) = self.files_to_fetch(wanted)?;
        let mut progress = Progress {
            files: 0,
            of_files: to_fetch.len(),
            bytes: 0,
            of_bytes: to_fetch.iter().map(|file| file.stored).sum(),
        };
        self.send_report(Report::Arriving(progress))?;
        for group in Origin::group_by_parcel(&to_fetch) {
            let (origin, table) = (self.origin, self.into.table());
            let parcel = self.retry(progress, || origin.locate(table, &group))?;
            self.receive(&parcel, &incoming, &mut progress)?;
        }
        // The folder stays: another process may be about to write its first file into it.
        Ok(Fetched {
            present: wanted.len() - to_fetch.len(),
            fetched: to_fetch.len(),
            replaced,
            bytes: progress.of_bytes,
        })
    }

    /// Returns the files that are missing or altered, and the number of altered files.
    fn files_to_fetch<'f>(
        &self,
        wanted: &[&'f FileFacts],
    ) -> Result<(Vec<&'f FileFacts>, usize), AssetsError> {
        let mut to_fetch = Vec::new();
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
            to_fetch.push(*file);
        }
        Ok((to_fetch, altered))
    }

    /// Locks until the file is dropped. Concurrent fetches would append to the same partial files.
    fn lock(&mut self) -> Result<File, AssetsError> {
        let path = self.into.folder().join(LOCK);
        let file =
            File::options().create(true).append(true).custom_flags(receive::no_links()).open(&path);
        let file = file.map_err(|source| write_error(&path, source))?;
        loop {
            match file.try_lock() {
                // Some network file systems do not support locks. A file with bytes of two
                // fetches would fail verification and be fetched again.
                Ok(()) | Err(TryLockError::Error(_)) => return Ok(file),
                Err(TryLockError::WouldBlock) => {
                    self.send_report(Report::WaitingForAnotherFetch)?;
                    (self.pause)(LOCK_POLL);
                }
            }
        }
    }

    fn receive(
        &mut self,
        parcel: &Parcel<'_>,
        incoming: &Path,
        progress: &mut Progress,
    ) -> Result<(), AssetsError> {
        let mut receiver = receive::Receiver::new(self.origin, parcel, self.into, incoming);
        let mut tries = Tries::default();
        while !receiver.is_done() {
            let received_before = receiver.received_bytes();
            let outcome = receiver.stream(progress, self.progress);
            if receiver.received_bytes() - received_before >= GAIN_BYTES {
                tries = Tries::default();
            }
            match outcome {
                Ok(()) => {}
                Err(RequestError::Permanent(error)) => return Err(error),
                Err(RequestError::Transient { url, problem }) => {
                    self.wait(tries.next(url, problem)?, *progress)?;
                }
            }
        }
        Ok(())
    }

    /// Repeats until success, permanent failure, or [`receive::MAX_TRIES`] failures.
    fn retry<T>(
        &mut self,
        progress: Progress,
        mut request: impl FnMut() -> Result<T, RequestError>,
    ) -> Result<T, AssetsError> {
        let mut tries = Tries::default();
        loop {
            match request() {
                Ok(answer) => return Ok(answer),
                Err(RequestError::Permanent(error)) => return Err(error),
                Err(RequestError::Transient { url, problem }) => {
                    self.wait(tries.next(url, problem)?, progress)?;
                }
            }
        }
    }

    fn wait(&mut self, time: Duration, progress: Progress) -> Result<(), AssetsError> {
        self.send_report(Report::Arriving(progress))?;
        (self.pause)(time);
        self.send_report(Report::Arriving(progress))
    }

    fn send_report(&mut self, report: Report) -> Result<(), AssetsError> {
        match (self.progress)(report) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(AssetsError::Interrupted),
        }
    }
}

struct Tries(Backoff);

impl Default for Tries {
    fn default() -> Self {
        Self(Backoff::new(Waits::USUAL, 0))
    }
}

impl Tries {
    /// Counts a failed try. Returns the time to wait after it, or an error after the last try.
    fn next(&mut self, url: String, problem: String) -> Result<Duration, AssetsError> {
        let wait = self.0.next_wait();
        let tries = self.0.failures();
        if tries == receive::MAX_TRIES {
            return Err(AssetsError::Unreachable { url, problem, tries });
        }
        Ok(wait)
    }
}

#[cfg(test)]
mod tests;
