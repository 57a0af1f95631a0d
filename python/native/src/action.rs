use numpy::{AllowTypeChange, PyArrayLikeDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::error::invalid;

/// Number of components of an action: translation (3), rotation (3), gripper.
pub(crate) const WIDTH: usize = 7;

/// Array-like of numbers of any type.
pub(crate) type Numbers<'py> = PyArrayLikeDyn<'py, f64, AllowTypeChange>;

/// Converts actions of the given shape, whose last length is [`WIDTH`].
///
/// # Errors
/// If the shape differs or a number is not finite.
pub(crate) fn actions(given: &Numbers<'_>, shape: &[usize]) -> PyResult<Vec<[f64; WIDTH]>> {
    if given.shape() != shape {
        return Err(invalid(format_args!(
            "read actions of shape {:?}: expected {shape:?}; the last axis holds three numbers of \
             translation, three of rotation and the gripper, each in -1..1",
            given.shape()
        )));
    }
    let numbers: Vec<f64> = given.as_array().iter().copied().collect();
    if let Some(number) = numbers.iter().find(|number| !number.is_finite()) {
        return Err(invalid(format_args!(
            "read actions: one of the numbers is {number}; search the policy for its origin"
        )));
    }
    let (actions, _) = numbers.as_chunks::<WIDTH>();
    Ok(actions.to_vec())
}
