use std::error::Error;
use std::fmt::Display;

use pyo3::create_exception;
use pyo3::exceptions::{PyFileNotFoundError, PyMemoryError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use scene::SceneError;
use scene::assets::AssetsError;
use sim::SimError;

create_exception!(
    rollout_libero,
    SimulationError,
    PyRuntimeError,
    "The physics diverged, a scene is inconsistent, or nothing can be drawn."
);
create_exception!(
    rollout_libero,
    BusyError,
    PyRuntimeError,
    "Another thread is computing with this environment."
);
create_exception!(rollout_libero, ClosedError, PyRuntimeError, "The environment has been closed.");
create_exception!(
    rollout_libero,
    FilesError,
    PyFileNotFoundError,
    "A file of a scene is missing or wrong, or cannot be fetched."
);

/// `failed to`, and an error's text, which is an infinitive, as on command lines.
pub(crate) fn failed_to(infinitive: impl Display) -> String {
    format!("failed to {infinitive}")
}

pub(crate) fn invalid(infinitive: impl Display) -> PyErr {
    PyValueError::new_err(failed_to(infinitive))
}

/// Returns the message of an error with all its causes.
fn message_of(error: &dyn Error) -> String {
    let mut message = failed_to(error);
    let mut cause = error.source();
    while let Some(error) = cause {
        message.push_str(": ");
        message.push_str(&error.to_string());
        cause = error.source();
    }
    message
}

pub(crate) fn simulation(error: SimError) -> PyErr {
    let message = message_of(&error);
    match error {
        SimError::Scene(error) => scene(error),
        SimError::StateWidth { .. }
        | SimError::NoSuchState { .. }
        | SimError::Missing { .. }
        | SimError::DistortedPose
        | SimError::Camera(_) => PyValueError::new_err(message),
        SimError::OutOfMemory(_) => PyMemoryError::new_err(message),
        _ => SimulationError::new_err(message),
    }
}

pub(crate) fn scene(error: SceneError) -> PyErr {
    FilesError::new_err(message_of(&error))
}

pub(crate) fn assets(error: AssetsError) -> PyErr {
    FilesError::new_err(message_of(&error))
}

/// Converts an error about a value that the protocol does not know.
pub(crate) fn value(error: impl Error) -> PyErr {
    PyValueError::new_err(message_of(&error))
}
