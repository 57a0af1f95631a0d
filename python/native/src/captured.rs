use std::sync::Arc;

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use sim::{CompiledScene, Environment, Renderer, SimError};

use crate::error::simulation;
use crate::guarded::Guarded;
use crate::state::{State, pairs, picture_size, shaped, with_drawer};

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

    /// Sites are transparent, unlike in `MuJoCo`, except the site of a burner that glowed.
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
    /// Draws with the observed environment or, if that is busy or closed, with a new one.
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
