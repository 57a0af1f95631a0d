//! Operations of workers and operators: each reads the inputs of a decision, applies the rules, and
//! writes the outcome in the writing transaction.

pub(crate) mod alter;
pub(crate) mod append;
pub(crate) mod artifacts;
pub(crate) mod backup;
pub(crate) mod batches;
mod cache;
pub(crate) mod campaigns;
mod choose;
pub(crate) mod claim;
pub(crate) mod commit;
pub(crate) mod context;
pub(crate) mod error;
pub(crate) mod filming;
pub(crate) mod films;
pub(crate) mod heartbeat;
pub(crate) mod local_videos;
pub(crate) mod means;
pub(crate) mod portable;
pub(crate) mod records;
mod register;
pub(crate) mod release;
pub(crate) mod removals;
pub(crate) mod retry;
pub(crate) mod shared;
mod skip;
pub(crate) mod start;
pub(crate) mod stop;
mod sweep;
pub(crate) mod unfilmed;
pub(crate) mod writer;
