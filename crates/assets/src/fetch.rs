//! The whole pack from the hub. Files gather in a folder beside the one they
//! are for, so that half a pack is never taken for one; the last step gives it
//! its name. A fetch that was interrupted goes on with what is there.

use std::fs::{self, File, TryLockError};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::download::{Download, persistently, write_error};
use crate::error::AssetsError;
use crate::hub::{Hub, Listing, RemoteFile};
use crate::manifest::Manifest;
use crate::progress::Progress;

/// Figures of a commit that tell it from others.
const SHORT_COMMIT: usize = 12;

/// A fetch to do.
pub struct Fetch<'a> {
    /// Where from.
    pub hub: &'a Hub,
    /// The pack's folder; not there yet.
    pub into: &'a Path,
    /// Waits.
    pub pause: &'a mut dyn FnMut(Duration),
    /// Told how it is coming on; says whether to go on.
    pub progress: &'a mut dyn FnMut(Progress) -> ControlFlow<()>,
}

impl Fetch<'_> {
    /// Fetches; what the pack holds is also recorded beside it.
    ///
    /// # Errors
    /// If the pack is there, or its files cannot be had or written. What has
    /// arrived is kept; the next fetch goes on with it.
    pub fn run(&mut self) -> Result<Manifest, AssetsError> {
        if self.into.exists() {
            let folder = self.into.to_owned();
            let remedy = self.hub.program().occupied;
            return Err(AssetsError::Occupied { folder, remedy });
        }
        let hub = self.hub;
        let commit = persistently(hub, self.pause, || hub.latest_commit())?;
        let listing = self.list(&commit)?;
        let gathering = self.gathering(&commit);
        let _alone = self.alone_in(&gathering)?;
        self.gather(&commit, &listing.files, &gathering)?;
        let manifest = Manifest::of_folder(&gathering)?;
        let record = Manifest::beside(self.into);
        let written = fs::write(&record, manifest.to_string());
        written.map_err(|source| write_error(&record, source))?;
        let renamed = fs::rename(&gathering, self.into);
        renamed.map_err(|source| write_error(self.into, source))?;
        Ok(manifest)
    }

    fn list(&mut self, commit: &str) -> Result<Listing, AssetsError> {
        let hub = self.hub;
        let mut listing = hub.listing(commit);
        while persistently(hub, self.pause, || hub.list_more(&mut listing))? {}
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

    /// Makes the folder, and keeps other fetches out of it for as long as what is
    /// returned lives: two would mix their bytes.
    fn alone_in(&self, gathering: &Path) -> Result<File, AssetsError> {
        let made = fs::create_dir_all(gathering).and_then(|()| File::open(gathering));
        let folder = made.map_err(|source| write_error(gathering, source))?;
        match folder.try_lock() {
            Err(TryLockError::WouldBlock) => {
                let folder = self.into.to_owned();
                Err(AssetsError::Busy { folder })
            }
            // Not every network file system locks folders.
            Ok(()) | Err(TryLockError::Error(_)) => Ok(folder),
        }
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
        self.tell(progress)?;
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
                    show(Progress { bytes, ..progress })
                })?;
            }
            progress.files += 1;
            progress.bytes = before + file.bytes;
            self.tell(progress)?;
        }
        Ok(())
    }

    fn tell(&mut self, progress: Progress) -> Result<(), AssetsError> {
        match (self.progress)(progress) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(AssetsError::Interrupted),
        }
    }
}

#[cfg(test)]
mod tests;
