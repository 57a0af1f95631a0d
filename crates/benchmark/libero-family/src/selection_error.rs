//! Errors of a selection of variants.

use libero_ctrl::{RolloutId, UnknownName};

use crate::plus::UnknownVariant;

/// Error in a selection of variants.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SelectionError {
    /// No variant matches all filters.
    #[error("choose variants: none matches all filters; leave a filter out")]
    Nothing,
    /// The protocol belongs to another benchmark.
    #[error(
        "run {benchmark} under protocol `{protocol}`: it is another benchmark's protocol; \
         docs/FAMILY.md lists the protocols of each benchmark"
    )]
    Foreign {
        /// The protocol.
        protocol: &'static str,
        /// The benchmark.
        benchmark: &'static str,
    },
    /// LIBERO-Plus' task map lacks the variant.
    #[error(
        "choose variant `{name}`: its name is well-formed, but LIBERO-Plus' task map does not \
         have it; `worker variants --list` lists the variants"
    )]
    Unused {
        /// Name of the variant.
        name: String,
    },
    /// A filter that the benchmark does not have.
    #[error(
        "choose variants of {benchmark} by `{filter}`: only another benchmark has this \
         filter; leave it out"
    )]
    Filter {
        /// The benchmark.
        benchmark: &'static str,
        /// The filter.
        filter: &'static str,
    },
    /// A difficulty or a number of trials outside its range.
    #[error("choose variants: `{field}` has {given}, valid are {} to {}", valid[0], valid[1])]
    Range {
        /// The field.
        field: &'static str,
        /// The number given.
        given: u16,
        /// The valid range.
        valid: [u16; 2],
    },
    /// No rollout of LIBERO's family has the id.
    #[error(
        "read rollout {id}: neither LIBERO-Plus nor LIBERO-PRO nor LIBERO-Para has it; `coordinator \
         manifest expand` prints the ids of a specification"
    )]
    Id {
        /// The id.
        id: RolloutId,
    },
    /// Some of the chosen variants cannot run.
    #[error(
        "run {lacking} of the {chosen} chosen rollouts, whose files are missing:\n{report}\n{}",
        advice(chosen - lacking)
    )]
    Lacking {
        /// Number of rollouts that cannot run.
        lacking: usize,
        /// Number of chosen rollouts.
        chosen: usize,
        /// Missing files, with the rollouts that need them.
        report: String,
    },
    /// No variant has the name.
    #[error(transparent)]
    Variant(#[from] UnknownVariant),
    /// A suite, dimension, type of paraphrase, task or protocol is unknown.
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
