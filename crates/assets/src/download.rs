//! One file from the hub, whatever happens on the way: what has arrived is
//! kept, and asked for is the rest. Checked before it gets its name.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Duration;

use attempt::{Backoff, Waits};

use crate::error::AssetsError;
use crate::hub::{Hub, RemoteFile, RequestError};
use crate::manifest::sha256_of;

/// How often something is tried in vain before it is given up.
pub(crate) const MAX_TRIES: u32 = 5;
/// A try that gained less than this was in vain.
const GAIN_BYTES: u64 = 1 << 20;
/// Bytes that are written at a time.
const BLOCK_BYTES: usize = 1 << 16;

/// Repeats a request until it succeeds, in vain for [`MAX_TRIES`] times, or
/// fails for good.
pub(crate) fn persistently<T>(
    hub: &Hub,
    pause: &mut dyn FnMut(Duration),
    mut request: impl FnMut() -> Result<T, RequestError>,
) -> Result<T, AssetsError> {
    let mut backoff = Backoff::new(Waits::USUAL, 0);
    loop {
        let (url, problem) = match request() {
            Ok(answer) => return Ok(answer),
            Err(RequestError::Final(error)) => return Err(error),
            Err(RequestError::Passing { url, problem }) => (url, problem),
        };
        let wait = backoff.next_wait();
        let tries = backoff.failures();
        if tries == MAX_TRIES {
            return Err(AssetsError::Unreachable {
                url,
                problem,
                tries,
                assets: hub.program().assets,
            });
        }
        pause(wait);
    }
}

/// A file on its way.
pub(crate) struct Download<'a> {
    pub(crate) hub: &'a Hub,
    pub(crate) url: String,
    pub(crate) file: &'a RemoteFile,
    /// Where it goes; beside it, with `.part` at the end, is what has arrived.
    pub(crate) target: PathBuf,
}

impl Download<'_> {
    /// Gets it; tells how many bytes are there as they come, until it hears that
    /// nobody waits for more.
    pub(crate) fn run(
        &self,
        pause: &mut dyn FnMut(Duration),
        arrived: &mut dyn FnMut(u64) -> ControlFlow<()>,
    ) -> Result<(), AssetsError> {
        let part = self.part();
        let folder = part.parent().expect("in the pack's folder");
        fs::create_dir_all(folder).map_err(|source| write_error(folder, source))?;
        let mut corruptions = 0;
        loop {
            self.get_whole(&part, pause, arrived)?;
            let Some(problem) = self.corruption(&part)? else {
                break;
            };
            corruptions += 1;
            fs::remove_file(&part).map_err(|source| write_error(&part, source))?;
            if corruptions == MAX_TRIES {
                return Err(AssetsError::Altered {
                    url: self.url.clone(),
                    problem,
                    tries: corruptions,
                });
            }
        }
        fs::rename(&part, &self.target).map_err(|source| write_error(&self.target, source))
    }

    fn part(&self) -> PathBuf {
        let mut name = self.target.clone().into_os_string();
        name.push(".part");
        name.into()
    }

    /// Goes on until the size is right.
    fn get_whole(
        &self,
        part: &Path,
        pause: &mut dyn FnMut(Duration),
        arrived: &mut dyn FnMut(u64) -> ControlFlow<()>,
    ) -> Result<(), AssetsError> {
        loop {
            let before = size(part);
            let outcome = persistently(self.hub, pause, || {
                let had = size(part);
                match self.get_more(part, arrived) {
                    // A try that gained much starts the count anew.
                    Err(RequestError::Passing { .. }) if size(part) >= had + GAIN_BYTES => Ok(()),
                    other => other,
                }
            });
            outcome?;
            let now = size(part);
            if now == self.file.bytes {
                return Ok(());
            }
            debug_assert!(now > before, "a try without an error gains something");
        }
    }

    /// One request for what is missing.
    fn get_more(
        &self,
        part: &Path,
        arrived: &mut dyn FnMut(u64) -> ControlFlow<()>,
    ) -> Result<(), RequestError> {
        let failed = |source| RequestError::Final(write_error(part, source));
        let passing = |problem: String| RequestError::Passing {
            url: self.url.clone(),
            problem,
        };
        let mut have = size(part);
        if have > self.file.bytes {
            fs::remove_file(part).map_err(failed)?;
            have = 0;
        }
        if have == self.file.bytes && part.is_file() {
            return Ok(());
        }
        let mut response = self.hub.get(&self.url, have)?;
        let status = response.status().as_u16();
        let range = response.headers().get("content-range");
        let range = range.and_then(|range| range.to_str().ok());
        let goes_on = status == 206
            && range.is_some_and(|range| range.starts_with(&format!("bytes {have}-")));
        if status != 200 && !goes_on {
            fs::remove_file(part).map_err(failed)?;
            return Err(passing("it sends another part than asked for".to_owned()));
        }
        let mut file = if goes_on {
            OpenOptions::new().append(true).open(part).map_err(failed)?
        } else {
            have = 0;
            File::create(part).map_err(failed)?
        };
        // One more than expected, to notice a file that is too long.
        let missing = self.file.bytes - have + 1;
        let mut reader = response.body_mut().as_reader().take(missing);
        let mut block = vec![0; BLOCK_BYTES];
        loop {
            let read = match reader.read(&mut block) {
                Ok(0) => break,
                Ok(read) => read,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => {
                    let of = self.file.bytes;
                    return Err(passing(format!("{error} after {have} of {of} bytes")));
                }
            };
            file.write_all(&block[..read]).map_err(failed)?;
            have += read as u64;
            if arrived(have).is_break() {
                return Err(RequestError::Final(AssetsError::Interrupted));
            }
        }
        match have.cmp(&self.file.bytes) {
            std::cmp::Ordering::Equal => Ok(()),
            std::cmp::Ordering::Less => {
                let of = self.file.bytes;
                Err(passing(format!("it ended after {have} of {of} bytes")))
            }
            std::cmp::Ordering::Greater => {
                fs::remove_file(part).map_err(failed)?;
                Err(passing(format!(
                    "it is longer than {} bytes",
                    self.file.bytes
                )))
            }
        }
    }

    /// How a whole file differs from what the hub says of it.
    fn corruption(&self, part: &Path) -> Result<Option<String>, AssetsError> {
        let Some(expected) = &self.file.sha256 else {
            return Ok(None);
        };
        let found = sha256_of(part).map_err(|source| AssetsError::Read {
            path: part.to_owned(),
            source,
        })?;
        let differs = !found.eq_ignore_ascii_case(expected);
        Ok(differs.then(|| format!("its SHA-256 is {found} and should be {expected}")))
    }
}

/// Of a file that may not be there.
fn size(path: &Path) -> u64 {
    fs::metadata(path).map_or(0, |facts| facts.len())
}

pub(crate) fn write_error(path: &Path, source: io::Error) -> AssetsError {
    AssetsError::Write {
        path: path.to_owned(),
        source,
    }
}
