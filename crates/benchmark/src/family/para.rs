//! LIBERO-Para: 4,092 sentences for the ten tasks of `libero_goal`, and its score PRIDE. Only the
//! sentence differs from LIBERO: scenes, goals and initial states are those of `libero_goal`.

mod inventory;
mod kind;
mod score;

pub use inventory::{Paraphrase, TypeName, digest, inventory, paraphrase};
pub use kind::{Kind, Wording};
pub use score::{Distances, Paraphrased};

/// Folder of a checkout of LIBERO-Para that has the task files.
pub const PACKAGE: &str = "libero/libero";
/// Path of the metadata in a checkout.
pub const METADATA: &str = "metrics/libero_para_metadata.csv";
/// Commands that get the sentences: a checkout of the commit, and the copy of its files.
pub const FETCH: &str = crate::Benchmark::Para.fetch_command();
