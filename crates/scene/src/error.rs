use std::path::PathBuf;

use benchmark::family::para::FETCH;

/// Messages complete the phrase "failed to …".
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    #[error("read {what} {}: {remedy}", path.display())]
    Read { what: String, path: PathBuf, remedy: String, source: std::io::Error },
    #[error(
        "write unpacked asset pack {}: make the sources folder writable, or point --sources \
         elsewhere",
        path.display()
    )]
    Unpack { path: PathBuf, source: std::io::Error },
    #[error("parse {what} {}: {problem}", path.display())]
    Malformed { what: String, path: PathBuf, problem: String },
    #[error(
        "use {what} {}: the file is not LIBERO's ({difference}). Run `worker assets fetch`, which \
         replaces it, or `worker assets --verify`, which lists everything that differs",
        path.display()
    )]
    NotLiberos { what: String, path: PathBuf, difference: String },
    #[error(
        "find a model for category `{category}` of `{instance}`: the catalogue has {known} \
         other categories; check the category's spelling in the BDDL file"
    )]
    UnknownCategory { category: String, instance: String, known: usize },
    #[error("choose an arena for problem `{problem}`: the known problems are {}", known.join(", "))]
    UnknownProblem { problem: String, known: Vec<&'static str> },
    #[error("fetch LIBERO-Para's sentences: no package index has them; run `{FETCH}`")]
    NoWheel,
    #[error("copy LIBERO-Para's sentences from {}: {problem}; run `{FETCH}`", path.display())]
    Checkout { path: PathBuf, problem: String },
    #[error(transparent)]
    Assets(#[from] crate::assets::AssetsError),
    #[error("compose the scene: {0}")]
    Inconsistent(String),
    #[error(
        "place `{object}` in region `{region}`: no free position in {attempts} attempts \
         (the region is too crowded)"
    )]
    NoRoom { object: String, region: String, attempts: usize },
}
