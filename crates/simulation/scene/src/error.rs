//! Errors of reading and composing a scene.

use std::path::PathBuf;

/// Reason why a scene could not be read or composed. Messages read after "failed to …"
/// and name the file, the place in it and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A file is missing or unreadable.
    #[error("read {what} {}: {remedy}", path.display())]
    Read {
        /// Purpose of the file.
        what: String,
        /// Path at which the file was expected.
        path: PathBuf,
        /// Remedy for the operator.
        remedy: String,
        /// Error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// The content of a file is malformed.
    #[error("understand {what} {}: {problem}", path.display())]
    Malformed {
        /// Purpose of the file.
        what: String,
        /// Path of the file.
        path: PathBuf,
        /// Defect, with its place where there is one.
        problem: String,
    },
    /// A file of a pack named `libero` differs from LIBERO's.
    #[error(
        "use {what} {}: it is not LIBERO's ({difference}). Run `worker assets fetch`, which \
         replaces it, or `worker assets verify`, which lists everything that differs",
        path.display()
    )]
    NotLiberos {
        /// Purpose of the file.
        what: String,
        /// Path of the file.
        path: PathBuf,
        /// Difference from LIBERO's file.
        difference: String,
    },
    /// A BDDL file uses an unknown category.
    #[error(
        "find a model for category `{category}` of `{instance}`: the catalogue knows {known} \
         categories and not this one; check its spelling in the BDDL file"
    )]
    UnknownCategory {
        /// Category as in the BDDL file.
        category: String,
        /// Instance of that category.
        instance: String,
        /// Number of categories in the catalogue.
        known: usize,
    },
    /// The problem class of a BDDL file is unknown.
    #[error("choose an arena for problem `{problem}`: known are {}", known.join(", "))]
    UnknownProblem {
        /// Problem class as the BDDL file writes it.
        problem: String,
        /// The problem classes with an arena.
        known: Vec<&'static str>,
    },
    /// LIBERO's assets cannot be fetched.
    #[error(transparent)]
    Assets(#[from] assets::AssetsError),
    /// Names inside a scene do not match.
    #[error("compose the scene: {0}")]
    Inconsistent(String),
    /// The placement sampler found no room.
    #[error(
        "place `{object}` in region `{region}`: no free position in {attempts} attempts \
         (the region is too crowded)"
    )]
    NoRoom {
        /// Name of the object to place.
        object: String,
        /// Name of the region.
        region: String,
        /// Number of attempts.
        attempts: usize,
    },
}
