//! Files of LIBERO's assets that a scene requires. The asset table lists the files that each
//! model references, so no model has to be read.

use assets::{FileFacts, Table};

use crate::arena::{arena, known_problems};
use crate::bddl::Problem;
use crate::catalog::{category, category_count};
use crate::error::SceneError;

/// Folder of the arenas' textures in LIBERO's assets.
const TEXTURES: &str = "textures";

/// Lists the files that [`compose`](fn@crate::compose) and MuJoCo read for a problem, sorted by
/// path.
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
