//! Deferred rendering of observations.

use crate::environment::Environment;
use crate::mujoco::Model;

/// State that cameras show at an observed instant: a few kilobytes, from which every environment of
/// the compiled scene renders the same bits later.
pub struct Look {
    model: Model,
    positions: Box<[f64]>,
    burner_opacities: Box<[f32]>,
}

impl Environment {
    /// Captures the observed instant of the last step.
    pub fn look(&self) -> Look {
        let opacities = self.burners.iter().map(|burner| burner.observed_opacity);
        Look {
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
    pub fn seeing<T>(&mut self, look: &Look, render: impl FnOnce(&mut Self) -> T) -> T {
        let present = self.look();
        self.show(look);
        let result = render(self);
        self.show(&present);
        result
    }

    fn show(&mut self, look: &Look) {
        self.model.copy_own(&look.model);
        let positions = self.observed.qpos_mut(&self.model);
        positions.copy_from_slice(&look.positions);
        for (burner, opacity) in self.burners.iter_mut().zip(&look.burner_opacities) {
            burner.observed_opacity = *opacity;
        }
        self.has_observed_poses = false;
    }
}
