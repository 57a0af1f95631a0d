//! `rollout_libero._native`: Python bindings of the simulator. Its types mirror those of
//! `sim`; the package in `python/` builds the public interface on them.
//!
//! Long computations release the interpreter. Using an environment that another thread is
//! computing with raises `BusyError`.

mod action;
mod batch;
mod captured;
mod error;
mod fetch;
mod generator;
mod guarded;
mod plus;
mod scene;
mod schedule;
mod simulation;
mod start;
mod state;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    #[pymodule_export]
    use super::batch::Batch;
    #[pymodule_export]
    use super::captured::CapturedView;
    #[pymodule_export]
    use super::error::{BusyError, ClosedError, FilesError, SimulationError};
    #[pymodule_export]
    use super::fetch::fetch_assets;
    #[pymodule_export]
    use super::plus::{PlusPath, PlusVariant, plus_problem_parent};
    #[pymodule_export]
    use super::scene::Scene;
    #[pymodule_export]
    use super::schedule::Schedule;
    #[pymodule_export]
    use super::simulation::Simulation;
    #[pymodule_export]
    use super::start::{configuration_row, nominal_row, perturbed_axes, task};
    #[pymodule_export]
    use super::state::Snapshot;
    use super::*;

    /// Names of the looks, the default first.
    #[pymodule_export]
    const LOOKS: [&str; 2] = {
        let [default, other] = benchmark::Look::ALL;
        [default.name(), other.name()]
    };

    #[pyfunction]
    fn mujoco_version() -> String {
        sim::Simulator::mujoco_version()
    }
}
