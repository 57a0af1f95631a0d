//! What an observation shows, kept until somebody looks at it.

use std::sync::Arc;

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use sim::{CompiledScene, Environment, Renderer, SimError};

use crate::error::simulation;
use crate::guarded::Guarded;
use crate::state::{State, pairs, picture_size, shaped, with_drawer};

/// What cameras see at an instant of observation.
#[pyclass(frozen, module = "rollout_libero._native")]
pub(crate) struct Look {
    pub(crate) look: sim::Look,
    pub(crate) compiled: Arc<CompiledScene>,
    pub(crate) renderer: Renderer,
    /// State of the environment that was looked at, which draws it if it can.
    pub(crate) state: Guarded<State>,
}

#[pymethods]
impl Look {
    /// A frame, [height, width, 3]; row 0 is the bottom.
    fn frame<'py>(
        &self,
        py: Python<'py>,
        camera: &str,
        width: u32,
        height: u32,
    ) -> PyResult<Bound<'py, PyArrayDyn<u8>>> {
        let [wide, high] = picture_size(width, height)?;
        let frame = self.draw(py, |environment, drawer| {
            environment.draw(drawer, camera, wide, high)
        })?;
        shaped(py, frame.rgb, &[height as usize, width as usize, 3])
    }

    /// Depths as OpenGL keeps them, [height, width]; row 0 is the bottom.
    fn depth<'py>(
        &self,
        py: Python<'py>,
        camera: &str,
        width: u32,
        height: u32,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let size = picture_size(width, height)?;
        let depths = self.draw(py, |environment, drawer| {
            environment.depth(drawer, camera, size)
        })?;
        shaped(py, depths, &[height as usize, width as usize])
    }

    /// Kind (mjtObj) and id of what each pixel shows, [height, width, 2]; -1 where
    /// nothing is; row 0 is the bottom. Sites are transparent, as in frames; `MuJoCo`'s
    /// segmentations would show them. A burner is as it was observed.
    fn segmentation<'py>(
        &self,
        py: Python<'py>,
        camera: &str,
        width: u32,
        height: u32,
    ) -> PyResult<Bound<'py, PyArrayDyn<i32>>> {
        let size = picture_size(width, height)?;
        let segments = self.draw(py, |environment, drawer| {
            for colour in environment.model_mut().site_rgba_mut().chunks_exact_mut(4) {
                colour[3] = 0.0;
            }
            environment.segmentation(drawer, camera, size)
        })?;
        shaped(py, pairs(segments), &[height as usize, width as usize, 2])
    }
}

impl Look {
    /// Draws with the environment that was looked at; with another one where that is busy or
    /// closed, as a picture that was drawn at once would be there too.
    fn draw<T: Send>(
        &self,
        py: Python<'_>,
        draw: impl Fn(&mut Environment, &sim::Drawer) -> Result<T, SimError> + Sync,
    ) -> PyResult<T> {
        let see = |environment: &mut Environment| {
            environment.seeing(&self.look, |environment| {
                with_drawer(self.renderer, |drawer| draw(environment, drawer))
            })
        };
        py.detach(|| {
            let seen = self.state.look(|state| {
                Arc::ptr_eq(state.environment.compiled(), &self.compiled)
                    .then(|| see(&mut state.environment))
            });
            seen.unwrap_or_else(|| {
                let other = Environment::of(Arc::clone(&self.compiled)).map_err(simulation);
                see(&mut other?)
            })
        })
    }
}
