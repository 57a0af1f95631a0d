//! The whole pack from the hub. Files gather in a folder beside the one they
//! are for, so that half a pack is never taken for one; the last step gives it
//! its name. A fetch that was interrupted goes on with what is there.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::download::{Download, persistently, write_error};
use super::error::AssetsError;
use super::hub::{Hub, Listing, RemoteFile};
use super::manifest::{self, Manifest};
use super::progress::Progress;

/// Figures of a commit that tell it from others.
const SHORT_COMMIT: usize = 12;

/// A fetch to do.
pub(super) struct Fetch<'a> {
    pub(super) hub: &'a Hub,
    /// The pack's folder; not there yet.
    pub(super) into: &'a Path,
    /// Waits.
    pub(super) pause: &'a mut dyn FnMut(Duration),
    /// Told how it is coming on.
    pub(super) progress: &'a mut dyn FnMut(Progress),
}

impl Fetch<'_> {
    /// Fetches; what the pack holds is also recorded beside it.
    pub(super) fn run(&mut self) -> Result<Manifest, AssetsError> {
        if self.into.exists() {
            let folder = self.into.to_owned();
            return Err(AssetsError::Occupied { folder });
        }
        let hub = self.hub;
        let commit = persistently(self.pause, || hub.latest_commit())?;
        let listing = self.list(&commit)?;
        let gathering = self.gathering(&commit);
        self.gather(&commit, &listing.files, &gathering)?;
        let manifest = Manifest::of_folder(&gathering)?;
        let record = manifest::beside(self.into);
        let written = fs::write(&record, manifest.to_string());
        written.map_err(|source| write_error(&record, source))?;
        let renamed = fs::rename(&gathering, self.into);
        renamed.map_err(|source| write_error(self.into, source))?;
        Ok(manifest)
    }

    fn list(&mut self, commit: &str) -> Result<Listing, AssetsError> {
        let hub = self.hub;
        let mut listing = hub.listing(commit);
        while persistently(self.pause, || hub.list_more(&mut listing))? {}
        if listing.files.is_empty() {
            return Err(AssetsError::Answer {
                url: format!("the listing of {commit}"),
                problem: "it has no files".to_owned(),
            });
        }
        Ok(listing)
    }

    /// Where the files of a commit gather.
    fn gathering(&self, commit: &str) -> PathBuf {
        let mut name = self.into.file_name().unwrap_or_default().to_owned();
        name.push(".fetching-");
        name.push(&commit[..SHORT_COMMIT]);
        self.into.with_file_name(name)
    }

    fn gather(
        &mut self,
        commit: &str,
        files: &[RemoteFile],
        folder: &Path,
    ) -> Result<(), AssetsError> {
        let mut progress = Progress {
            files: 0,
            of_files: files.len(),
            bytes: 0,
            of_bytes: files.iter().map(|file| file.bytes).sum(),
        };
        (self.progress)(progress);
        for file in files {
            let target = folder.join(&file.path);
            let before = progress.bytes;
            // It has its name, so it was whole and checked.
            if !target.is_file() {
                let download = Download {
                    hub: self.hub,
                    url: self.hub.file_url(commit, file),
                    file,
                    target,
                };
                let show = &mut *self.progress;
                download.run(self.pause, &mut |arrived| {
                    let bytes = before + arrived;
                    show(Progress { bytes, ..progress });
                })?;
            }
            progress.files += 1;
            progress.bytes = before + file.bytes;
            (self.progress)(progress);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
