//! State of NumPy's legacy generator, in the form of `numpy.random.get_state()`.

use benchmark::numpy::{LegacyRng, LegacyState};
use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

use crate::error::invalid;

/// `("MT19937", key, position, has_gauss, cached_gaussian)`.
pub(crate) type Generator<'py> = (String, Bound<'py, PyArray1<u32>>, usize, i32, f64);

/// Converts a state to a generator.
///
/// # Errors
/// If the state is of another generator, or its key or position is invalid.
pub(crate) fn read((name, key, position, has_gauss, gauss): &Generator<'_>) -> PyResult<LegacyRng> {
    let wrong = |problem: String| {
        invalid(format_args!("read a generator's state: {problem}; give numpy.random.get_state()"))
    };
    if name != "MT19937" {
        return Err(wrong(format!("its generator is `{name}`, not `MT19937`")));
    }
    let key: PyReadonlyArray1<'_, u32> = key.readonly();
    let words = key.as_slice()?;
    let words =
        words.try_into().map_err(|_| wrong(format!("its key has {} words", words.len())))?;
    let state =
        LegacyState { words, position: *position, has_gauss: *has_gauss != 0, gauss: *gauss };
    LegacyRng::from_state(state).ok_or_else(|| wrong(format!("its position is {position}")))
}

pub(crate) fn write<'py>(py: Python<'py>, rng: &LegacyRng) -> Generator<'py> {
    let state = rng.state();
    (
        "MT19937".to_owned(),
        PyArray1::from_slice(py, &state.words),
        state.position,
        i32::from(state.has_gauss),
        state.gauss,
    )
}
