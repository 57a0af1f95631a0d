//! Measures how many slots are worth running on a machine: `worker bench` prints the measurements,
//! `--slots auto` acts on them. Both measure 1, 2, 4 and more slots, which simulate and render whole
//! rollouts with a policy of fixed actions, and add up the slots' throughput.
//!
//! Reading order: `open_loop` has that policy's actions; `counting` is the process of one measured
//! slot, `together` the parent of these processes, `room` the available memory, `choice` the rule
//! for the number of slots; `bench` and `auto` call these modules.

mod auto;
mod bench;
mod choice;
mod counting;
pub mod limits;
pub mod open_loop;
mod room;
mod together;

use std::io;
use std::path::PathBuf;

pub use auto::{Chosen, choose_slots};
pub use bench::{Plan, bench};
pub use counting::count;

use crate::rollout::RolloutError;

/// Reason why the measurement failed.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    #[error("count the cores that this process may use")]
    Cores(#[source] io::Error),
    #[error("find `{field}` in {}", file.display())]
    Memory { field: &'static str, file: PathBuf },
    #[error("start {} as a slot to measure with", program.display())]
    Start {
        program: PathBuf,
        #[source]
        source: io::Error,
    },
    #[error("measure with slot {slot}: its process {end}; its error output is above")]
    Ended {
        /// Number of the slot, from 0.
        slot: usize,
        end: String,
    },
    #[error(
        "measure with {}: a slot sent nothing within {secs:.0} s",
        terminal::counted(*slots as u64, "slot")
    )]
    Silent { slots: usize, secs: f64 },
    #[error("exchange messages with a slot, or print the measurements")]
    Exchange(#[from] io::Error),
    #[error(transparent)]
    Rollout(#[from] RolloutError),
}

/// Returns the number of cores that this process may use; its CPU affinity or a control group's
/// quota may leave fewer than the machine has.
fn cores() -> Result<usize, MeasureError> {
    let cores = std::thread::available_parallelism();
    cores.map(usize::from).map_err(MeasureError::Cores)
}
