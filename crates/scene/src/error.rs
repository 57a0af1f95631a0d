//! What can be wrong with the files that a scene is made of.

use std::path::PathBuf;

/// Why a scene could not be read or composed. Messages read after "failed to …"
/// and name the file, the place in it and what to do.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A file is missing or unreadable.
    #[error("read {what} {}: {remedy}", path.display())]
    Read {
        /// What the file is for.
        what: String,
        /// Where it was looked for.
        path: PathBuf,
        /// What to do about it.
        remedy: String,
        /// The system's answer.
        #[source]
        source: std::io::Error,
    },
    /// A file was read but does not say what it should.
    #[error("understand {what} {}: {problem}", path.display())]
    Malformed {
        /// What the file is for.
        what: String,
        /// The file.
        path: PathBuf,
        /// What is wrong, with its place where there is one.
        problem: String,
    },
    /// A file of a pack that goes by LIBERO's name is not LIBERO's.
    #[error(
        "use {what} {}: it is not LIBERO's ({difference}). Run `worker assets fetch`, which \
         replaces it, or `worker assets verify`, which lists everything that differs",
        path.display()
    )]
    NotLiberos {
        /// The purpose of the file.
        what: String,
        /// The file.
        path: PathBuf,
        /// How it differs.
        difference: String,
    },
    /// A BDDL file names a category that no model is known for.
    #[error(
        "find a model for category `{category}` of `{instance}`: the catalogue knows {known} \
         categories and not this one; check its spelling in the BDDL file"
    )]
    UnknownCategory {
        /// The category as the BDDL file writes it.
        category: String,
        /// The instance that has it.
        instance: String,
        /// How many categories there are.
        known: usize,
    },
    /// The problem class of a BDDL file is none of LIBERO's.
    #[error("choose an arena for problem `{problem}`: known are {}", known.join(", "))]
    UnknownProblem {
        /// As the BDDL file writes it.
        problem: String,
        /// The problem classes with an arena.
        known: Vec<&'static str>,
    },
    /// LIBERO's assets cannot be fetched.
    #[error(transparent)]
    Assets(#[from] assets::AssetsError),
    /// Names inside a scene do not fit together.
    #[error("compose the scene: {0}")]
    Inconsistent(String),
    /// The placement sampler found no room.
    #[error(
        "place `{object}` in region `{region}`: no free position in {attempts} attempts \
         (the region is too crowded)"
    )]
    NoRoom {
        /// What was to be placed.
        object: String,
        /// Where.
        region: String,
        /// How often it was tried.
        attempts: usize,
    },
}
