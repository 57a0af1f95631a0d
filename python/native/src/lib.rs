//! `rollout_libero._native`: the simulator for Python. Its types mirror those of `sim`;
//! what Python users see is made of them by the package in `python/`.
//!
//! Every method lets go of the interpreter while it computes. What one thread is
//! computing with, another may not touch meanwhile: it gets `BusyError`.

mod action;
mod batch;
mod error;
mod fetch;
mod generator;
mod guarded;
mod look;
mod pack;
mod scene;
mod simulation;
mod start;
mod state;
mod tasks;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    #[pymodule_export]
    use super::batch::Batch;
    #[pymodule_export]
    use super::error::{BusyError, ClosedError, FilesError, SimulationError};
    #[pymodule_export]
    use super::fetch::fetch_assets;
    #[pymodule_export]
    use super::look::Look;
    #[pymodule_export]
    use super::scene::Scene;
    #[pymodule_export]
    use super::simulation::Simulation;
    #[pymodule_export]
    use super::start::perturbed_axes;
    #[pymodule_export]
    use super::state::Snapshot;
    #[pymodule_export]
    use super::tasks::{configuration_row, nominal_row, task};

    use super::*;

    /// Version of the MuJoCo library that is loaded.
    #[pyfunction]
    fn mujoco_version() -> String {
        sim::Simulator::mujoco_version()
    }
}
