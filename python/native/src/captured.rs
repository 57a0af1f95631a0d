//! Deferred rendering of an observation.

use std::sync::Arc;

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use sim::{CompiledScene, Environment, Renderer, SimError};

use crate::error::simulation;
use crate::guarded::Guarded;
use crate::state::{State, pairs, picture_size, shaped, with_drawer};

/// Camera views at the time of an observation, rendered on demand.
#[pyclass(frozen, module = "rollout_libero._native")]
pub(crate) struct CapturedView {
    pub(crate) captured: sim::CapturedView,
    pub(crate) compiled: Arc<CompiledScene>,
    pub(crate) renderer: Renderer,
    /// State of the observed environment, which renders the views unless it is busy or closed.
    pub(crate) state: Guarded<State>,
}

#[pymethods]
impl CapturedView {
    /// Renders a frame, [height, width, 3]; row 0 is the bottom.
    fn frame<'py>(
        &self,
        py: Python<'py>,
        camera: &str,
        width: u32,
        height: u32,
    ) -> PyResult<Bound<'py, PyArrayDyn<u8>>> {
        let [wide, high] = picture_size(width, height)?;
        let frame =
            self.draw(py, |environment, drawer| environment.draw(drawer, camera, wide, high))?;
        shaped(py, frame.rgb, &[height as usize, width as usize, 3])
    }

    /// Renders OpenGL depth values, [height, width]: 0 at the near plane, 1 at the far plane; row 0
    /// is the bottom.
    fn depth<'py>(
        &self,
        py: Python<'py>,
        camera: &str,
        width: u32,
        height: u32,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let size = picture_size(width, height)?;
        let depths =
            self.draw(py, |environment, drawer| environment.depth(drawer, camera, size))?;
        shaped(py, depths, &[height as usize, width as usize])
    }

    /// Renders the kind (mjtObj) and id of the object at each pixel, [height, width, 2]; -1
    /// for the background; row 0 is the bottom. Sites are transparent, as in frames, unlike
    /// in `MuJoCo`'s segmentation, except the site of a burner that glowed at the observation.
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

impl CapturedView {
    /// Renders with the observed environment or, if that is busy or closed, with a new
    /// environment, so that deferred rendering never fails for these reasons.
    fn draw<T: Send>(
        &self,
        py: Python<'_>,
        draw: impl Fn(&mut Environment, &sim::Drawer) -> Result<T, SimError> + Sync,
    ) -> PyResult<T> {
        let render = |environment: &mut Environment| {
            environment.with_captured(&self.captured, |environment| {
                with_drawer(self.renderer, |drawer| draw(environment, drawer))
            })
        };
        py.detach(|| {
            let rendered = self.state.try_read(|state| {
                Arc::ptr_eq(state.environment.compiled(), &self.compiled)
                    .then(|| render(&mut state.environment))
            });
            rendered.unwrap_or_else(|| {
                let new = Environment::before_load(Arc::clone(&self.compiled)).map_err(simulation);
                render(&mut new?)
            })
        })
    }
}
