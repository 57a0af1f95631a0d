//! How many slots a machine is worth having, found out by trying: `worker
//! bench` prints what it finds, `--slots auto` acts on it. Both start slots that
//! simulate and draw whole rollouts for a policy that takes no time, and count
//! what more and more of them do together.
//!
//! Reading order: `open_loop` is that policy, `counting` the process of one such
//! slot, `together` their parent, `room` the memory that there is, `choice` the
//! rule, `bench` and `auto` the two that use it all.

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

/// Reason for which nothing could be measured.
#[derive(Debug, thiserror::Error)]
pub enum MeasureError {
    /// The machine does not say how many cores this process may use.
    #[error("count the cores that this process may use")]
    Cores(#[source] io::Error),
    /// The kernel does not say how much memory there is, or is used.
    #[error("find `{field}` in {}", file.display())]
    Memory {
        /// Field that is missing.
        field: &'static str,
        /// File without the field.
        file: PathBuf,
    },
    /// A slot's process cannot be started.
    #[error("start {} as a slot to measure with", program.display())]
    Start {
        /// The program.
        program: PathBuf,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
    /// A slot's process ended before it had counted.
    #[error("measure with slot {slot}: its process {end}; what it complained about is above")]
    Ended {
        /// Number of the slot, from 0.
        slot: usize,
        /// End of the process, in words.
        end: String,
    },
    /// Slots said nothing for too long.
    #[error("measure with {slots} slots: one of them said nothing for {secs:.0} s")]
    Silent {
        /// Number of slots measured.
        slots: usize,
        /// Seconds waited.
        secs: f64,
    },
    /// Parent and slot cannot talk to each other, or the table cannot be printed.
    #[error("read or write what is measured")]
    Talk(#[from] io::Error),
    /// The measured task cannot be simulated or drawn.
    #[error(transparent)]
    Rollout(#[from] RolloutError),
}

/// The cores that this process may use: fewer than the machine's where its
/// affinity or a control group's quota says so.
fn cores() -> Result<usize, MeasureError> {
    let cores = std::thread::available_parallelism();
    cores.map(usize::from).map_err(MeasureError::Cores)
}
