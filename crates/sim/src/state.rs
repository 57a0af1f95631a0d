//! State of an environment in robosuite's terms: reset without an initial state, the state as one
//! vector, and observation on request. Snapshots hold the complete state of an environment.

use benchmark::numpy::LegacyRng;
use scene::placement::MAX_DRAWS;

use crate::compiled_scene::{Burner, hide_marker_sites};
use crate::controller::{Controller, SUBSTEPS};
use crate::environment::{Environment, JointReadings};
use crate::error::SimError;
use crate::mujoco::{Data, Model};
use crate::reset::Reset;

/// Environments of one compiled scene can exchange snapshots.
pub struct Snapshot {
    pub(crate) model: Model,
    pub(crate) data: Data,
    pub(crate) observed: Data,
    pub(crate) observed_joints: JointReadings,
    pub(crate) observed_substep: usize,
    pub(crate) controller: Controller,
    pub(crate) burners: Vec<Burner>,
    pub(crate) control_steps: u32,
}

impl Environment {
    /// Resets without an initial state: draws all poses from NumPy's legacy generator in
    /// LIBERO's order, with the arm in its reset posture, its controller reset and time 0; then
    /// observes once.
    ///
    /// `joint_sampler_rounds` is the number of times that LIBERO would have loaded its model so
    /// far: 1 at construction, plus 1 for each hard reset, this one included. Each time, LIBERO
    /// appends its samplers for joints that start open, closed, on or off to its list of samplers
    /// once more.
    ///
    /// If there is no room for an object, all joints and poses are drawn again, as in LIBERO's
    /// wrapper of environments; in a hard reset, each repetition counts as another hard reset.
    /// Returns the number of rounds after this reset, to which the caller adds 1 for a next hard
    /// reset.
    pub fn reset(
        &mut self,
        rng: &mut LegacyRng,
        reset: Reset,
        joint_sampler_rounds: u32,
    ) -> Result<u32, SimError> {
        let Self { compiled, model, data, reset_joints, .. } = self;
        if reset == Reset::Hard {
            model.copy_own(&compiled.model);
            compiled.resets.restore_fixtures(model);
        }
        let samplers = &compiled.scene.samplers;
        let mut rounds = joint_sampler_rounds;
        let mut attempts = 1;
        while let Err(error) =
            compiled.resets.place(samplers, model, data, rng, rounds, reset_joints)
        {
            if attempts == MAX_DRAWS {
                return Err(error.into());
            }
            attempts += 1;
            rounds += u32::from(reset == Reset::Hard);
        }
        data.forward(model);
        hide_marker_sites(&compiled.scene, model);
        for burner in &mut self.burners {
            burner.opacity = model.site_rgba()[burner.site * 4 + 3];
        }
        match reset {
            Reset::Hard => self.controller.reset(),
            Reset::Soft => self.controller.reset_arm(),
        }
        self.control_steps = 0;
        self.observed_substep = SUBSTEPS;
        self.observe_now();
        Ok(rounds)
    }

    /// Returns time, positions and velocities as one vector.
    pub fn state(&self) -> Vec<f64> {
        let (model, data) = (&self.model, &self.data);
        let mut state = vec![data.time_secs()];
        state.extend(data.qpos(model));
        state.extend(data.qvel(model));
        state
    }

    /// Does not compute derived values: controllers and observations stay unchanged.
    ///
    /// # Panics
    /// If the vector does not have 1 + nq + nv numbers.
    pub fn set_state(&mut self, state: &[f64]) {
        let (nq, nv) = (self.model.nq(), self.model.nv());
        assert_eq!(state.len(), 1 + nq + nv, "a state of this scene");
        self.data.set_time_secs(state[0]);
        let (qpos, qvel) = state[1..].split_at(nq);
        self.data.qpos_mut(&self.model).copy_from_slice(qpos);
        self.data.qvel_mut(&self.model).copy_from_slice(qvel);
    }

    /// Computes the quantities that depend on the state: poses, contacts, forces.
    pub fn forward(&mut self) {
        self.data.forward(&self.model);
    }

    pub fn post_process(&mut self) {
        self.update_burners();
    }

    /// Observes the current state. As in robosuite, later control steps then observe one simulation
    /// step earlier: a requested update counts as one of the steps between two samples.
    pub fn observe_now(&mut self) {
        self.observed_substep = (self.observed_substep + SUBSTEPS - 1) % SUBSTEPS;
        self.record_all();
    }

    /// Pose that the controller read last: position, m, and matrix, row by row, world frame.
    pub fn controller_pose(&self) -> ([f64; 3], [f64; 9]) {
        self.controller.last_pose()
    }

    pub fn snapshot(&self) -> Result<Snapshot, SimError> {
        let copy = |source: &Data| {
            let mut data = Data::new(&self.model)?;
            data.copy_from(&self.model, source);
            Ok::<_, SimError>(data)
        };
        Ok(Snapshot {
            model: self.model.share(),
            data: copy(&self.data)?,
            observed: copy(&self.observed)?,
            observed_joints: self.observed_joints,
            observed_substep: self.observed_substep,
            controller: self.controller.clone(),
            burners: self.burners.clone(),
            control_steps: self.control_steps,
        })
    }

    ///
    /// # Panics
    /// If the snapshot is from another compiled scene.
    pub fn restore(&mut self, snapshot: &Snapshot) {
        self.model.copy_own(&snapshot.model);
        self.data.copy_from(&self.model, &snapshot.data);
        self.observed.copy_from(&self.model, &snapshot.observed);
        self.has_observed_poses = false;
        self.observed_joints = snapshot.observed_joints;
        self.observed_substep = snapshot.observed_substep;
        self.controller.clone_from(&snapshot.controller);
        self.burners.clone_from(&snapshot.burners);
        self.control_steps = snapshot.control_steps;
    }
}

/// State of a few kilobytes from which every environment of the scene renders the same bits later.
pub struct CapturedView {
    model: Model,
    positions: Box<[f64]>,
    burner_opacities: Box<[f32]>,
}

impl Environment {
    pub fn capture(&self) -> CapturedView {
        let opacities = self.burners.iter().map(|burner| burner.observed_opacity);
        CapturedView {
            model: self.model.share(),
            positions: self.observed.qpos(&self.model).into(),
            burner_opacities: opacities.collect(),
        }
    }

    /// Runs `render` at a captured instant; restores the environment afterwards.
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
