//! Deferred rendering of observations.

use crate::environment::Environment;
use crate::mujoco::Model;

/// State that cameras show at the observed instant of a step (see [`Environment`]): a few
/// kilobytes, from which every environment of the compiled scene renders the same bits later.
pub struct CapturedView {
    model: Model,
    positions: Box<[f64]>,
    burner_opacities: Box<[f32]>,
}

impl Environment {
    /// Captures the observed instant of the last step.
    pub fn capture(&self) -> CapturedView {
        let opacities = self.burners.iter().map(|burner| burner.observed_opacity);
        CapturedView {
            model: self.model.share(),
            positions: self.observed.qpos(&self.model).into(),
            burner_opacities: opacities.collect(),
        }
    }

    /// Runs `render` with the environment at a captured instant, so that [`draw`](Self::draw) and
    /// similar methods render that instant. Restores the environment afterwards.
    ///
    /// # Panics
    /// If the capture is from another compiled scene.
    pub fn with_captured<T>(
        &mut self,
        captured: &CapturedView,
        render: impl FnOnce(&mut Self) -> T,
    ) -> T {
        let current = self.capture();
        self.restore_view(captured);
        let result = render(self);
        self.restore_view(&current);
        result
    }

    fn restore_view(&mut self, captured: &CapturedView) {
        self.model.copy_own(&captured.model);
        let positions = self.observed.qpos_mut(&self.model);
        positions.copy_from_slice(&captured.positions);
        for (burner, opacity) in self.burners.iter_mut().zip(&captured.burner_opacities) {
            burner.observed_opacity = *opacity;
        }
        self.has_observed_poses = false;
    }
}
