//! Errors of a selection of variants.

use libero_ctrl::{RolloutId, UnknownName};

use crate::plus::UnknownVariant;

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SelectionError {
    #[error("choose variants: none matches all filters; leave a filter out")]
    Nothing,
    #[error(
        "run {benchmark} under protocol `{protocol}`: it is another benchmark's protocol; \
         docs/FAMILY.md lists the protocols of each benchmark"
    )]
    Foreign { protocol: &'static str, benchmark: &'static str },
    #[error(
        "choose variant `{name}`: its name is well-formed, but LIBERO-Plus' task map does not \
         have it; `worker variants --list` lists the variants"
    )]
    Unused { name: String },
    #[error(
        "choose variants of {benchmark} by `{filter}`: only another benchmark has this \
         filter; leave it out"
    )]
    Filter { benchmark: &'static str, filter: &'static str },
    #[error("choose variants: `{field}` has {given}, valid are {} to {}", valid[0], valid[1])]
    Range { field: &'static str, given: u16, valid: [u16; 2] },
    #[error(
        "read rollout {id}: neither LIBERO-Plus nor LIBERO-PRO nor LIBERO-Para has it; `coordinator \
         manifest expand` prints the ids of a specification"
    )]
    Id { id: RolloutId },
    #[error(
        "run {lacking} of the {chosen} chosen rollouts, whose files are missing:\n{report}\n{}",
        advice(chosen - lacking)
    )]
    Lacking {
        lacking: usize,
        chosen: usize,
        /// Missing files, with the rollouts that need them.
        report: String,
    },
    #[error(transparent)]
    Variant(#[from] UnknownVariant),
    #[error(transparent)]
    Name(#[from] UnknownName),
}

/// Returns the advice on a selection with missing files, of which `runnable` rollouts can run.
fn advice(runnable: usize) -> &'static str {
    match runnable {
        0 => "No chosen rollout can run: follow the advice above, or choose other rollouts",
        _ => {
            "Give --runnable (`\"runnable\": true` in a specification) to run the other rollouts \
             only"
        }
    }
}
