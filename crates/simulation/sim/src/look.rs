//! What an observation shows, kept until somebody looks at it.

use crate::environment::Environment;
use crate::mujoco::Model;

/// What cameras see at an instant of observation: a few kilobytes, from which every
/// environment of the compiled scene draws the bits that were drawn then.
pub struct Look {
    model: Model,
    positions: Box<[f64]>,
    burner_opacities: Box<[f32]>,
}

impl Environment {
    /// What the last step's instant of observation shows.
    pub fn look(&self) -> Look {
        let opacities = self.burners.iter().map(|burner| burner.observed_opacity);
        Look {
            model: self.model.share(),
            positions: self.observed.qpos(&self.model).into(),
            burner_opacities: opacities.collect(),
        }
    }

    /// Draws of that instant: within `see`, [`draw`](Self::draw) and the like show it.
    /// Afterwards everything is as it was.
    ///
    /// # Panics
    /// If it is of another compiled scene.
    pub fn seeing<T>(&mut self, look: &Look, see: impl FnOnce(&mut Self) -> T) -> T {
        let present = self.look();
        self.show(look);
        let seen = see(self);
        self.show(&present);
        seen
    }

    fn show(&mut self, look: &Look) {
        self.model.copy_own(&look.model);
        let positions = self.observed.qpos_mut(&self.model);
        positions.copy_from_slice(&look.positions);
        for (burner, opacity) in self.burners.iter_mut().zip(&look.burner_opacities) {
            burner.observed_opacity = *opacity;
        }
        self.observed_is_posed = false;
    }
}
