//! A running scene: loading a state, control steps, success, and observations of the instants that
//! LIBERO observes. This module does not depend on perturbations.

use std::sync::Arc;

use benchmark::Predicate;
use scene::{AssetPack, Scene, Sources};

use crate::compiled_scene::{Burner, CompiledScene, DISABLE_CONSTRAINT};
use crate::controller::{ARM_JOINTS, ActionFrame, Controller, RESET_JOINTS, SUBSTEPS};
use crate::error::SimError;
use crate::mujoco::{self, Data, Model, ObjectKind, Segment};
use crate::observation::{Frame, RobotState, axis_angle_of};
use crate::predicates::Goal;
use crate::render::{Canvas, Drawer, View};

/// Position of the first finger in the readings, after the arm's joints.
const FIRST_FINGER: usize = ARM_JOINTS;
/// Substep, from 0, whose kinematics are observed after a state was loaded.
const OBSERVED_SUBSTEP: usize = SUBSTEPS - 2;
/// Least width and height of a canvas, pixels, so that frames of LIBERO's sizes share one.
const CANVAS_SIZE: u32 = 256;

/// Observations show the *observed instant*, which lags behind the end of a control step like
/// LIBERO's: in steps after [`load`](Self::load), frames and poses by 4 ms, joints by 2 ms.
pub struct Environment {
    pub(crate) compiled: Arc<CompiledScene>,
    canvas: Option<Canvas>,
    pub(crate) model: Model,
    pub(crate) data: Data,
    /// Positions, without velocities, at the observed instant.
    pub(crate) observed: Data,
    pub(crate) has_observed_poses: bool,
    pub(crate) observed_joints: JointReadings,
    /// Substep of a control step, from 0, whose kinematics the observation shows.
    pub(crate) observed_substep: usize,
    pub(crate) controller: Controller,
    /// Angles of the arm's joints at a reset, rad.
    pub(crate) reset_joints: [f64; ARM_JOINTS],
    pub(crate) burners: Vec<Burner>,
    pub(crate) control_steps: u32,
}

#[derive(Clone, Copy, Default)]
pub(crate) struct JointReadings {
    pos: [f64; ARM_JOINTS + 2],
    vel: [f64; ARM_JOINTS + 2],
}

impl Environment {
    pub fn new(scene: Scene, pack: &AssetPack, sources: &Sources) -> Result<Self, SimError> {
        Self::from_compiled(Arc::new(CompiledScene::compile(scene, pack, sources)?))
    }

    pub fn from_compiled(compiled: Arc<CompiledScene>) -> Result<Self, SimError> {
        let mut environment = Self::before_load(compiled)?;
        let Self { model, data, .. } = &mut environment;
        data.reset(model);
        data.qpos_mut(model)[..ARM_JOINTS].copy_from_slice(&RESET_JOINTS);
        data.forward(model);
        Ok(environment)
    }

    /// Creates an environment that must be loaded or reset before use. It leaves out contacts: unplaced objects overlap, and
    /// solving their contacts would take most of the time and megabytes.
    pub fn before_load(compiled: Arc<CompiledScene>) -> Result<Self, SimError> {
        let model = compiled.model.share();
        let mut data = Data::new(&model)?;
        pose_arm(&model, &mut data, &RESET_JOINTS);
        Ok(Self {
            controller: Controller::new(&model, &data)?,
            burners: compiled.burners.clone(),
            observed: Data::new(&model)?,
            has_observed_poses: false,
            observed_joints: JointReadings::default(),
            observed_substep: OBSERVED_SUBSTEP,
            canvas: None,
            reset_joints: RESET_JOINTS,
            control_steps: 0,
            model,
            data,
            compiled,
        })
    }

    /// Sets the arm's joints at a reset, rad, which LIBERO-Plus' robots have otherwise. The
    /// controller's rest posture is theirs even after a state is loaded. The environment must be
    /// loaded or reset before use.
    pub fn set_reset_joints(&mut self, joints: [f64; ARM_JOINTS]) -> Result<(), SimError> {
        if joints != self.reset_joints {
            self.data.reset(&self.model);
            pose_arm(&self.model, &mut self.data, &joints);
            self.controller = Controller::new(&self.model, &self.data)?;
            self.reset_joints = joints;
        }
        Ok(())
    }

    pub fn scene(&self) -> &Scene {
        &self.compiled.scene
    }

    pub fn compiled(&self) -> &Arc<CompiledScene> {
        &self.compiled
    }

    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Returns the model for perturbation; [`load`](Self::load) restores it.
    pub fn model_mut(&mut self) -> &mut Model {
        &mut self.model
    }

    pub fn data(&self) -> &Data {
        &self.data
    }

    /// Returns the model and its state, for setting poses; [`load`](Self::load) restores both.
    pub fn model_and_data(&mut self) -> (&Model, &mut Data) {
        (&self.model, &mut self.data)
    }

    /// Loads time, qpos and qvel, and restores the unperturbed model.
    ///
    /// # Panics
    /// If the vector does not have 1 + nq + nv numbers. Callers check the length when they read the
    /// file, so that their errors can name the file.
    pub fn load(&mut self, state: &[f64]) {
        let (nq, nv) = (self.model.nq(), self.model.nv());
        assert_eq!(state.len(), 1 + nq + nv, "a state of this scene");
        self.model.copy_own(&self.compiled.model);
        self.data.reset(&self.model);
        self.data.set_time_secs(state[0]);
        self.data.qpos_mut(&self.model).copy_from_slice(&state[1..=nq]);
        self.data.qvel_mut(&self.model).copy_from_slice(&state[1 + nq..]);
        self.data.forward(&self.model);
        self.controller.reset();
        self.control_steps = 0;
        self.observed_substep = OBSERVED_SUBSTEP;
        self.burners.clone_from(&self.compiled.burners);
        self.update_burners();
        self.record_all();
    }

    /// Restores the scene's cameras, lights and poses of fixtures; the state stays as it is.
    pub(crate) fn restore_appearance(&mut self) {
        // The opacities of burners are part of the state.
        let site_rgba = self.model.site_rgba().to_vec();
        self.model.copy_own(&self.compiled.model);
        self.model.site_rgba_mut().copy_from_slice(&site_rgba);
        self.has_observed_poses = false;
    }

    /// 50 ms in 25 simulation steps. Returns true if the goal holds after the step.
    pub fn step(&mut self, action: &[f64; 7]) -> Result<bool, SimError> {
        self.step_in(action, ActionFrame::Relative)
    }

    pub fn step_in(&mut self, action: &[f64; 7], frame: ActionFrame) -> Result<bool, SimError> {
        // Discards warnings of a load, a reset or a failed step of any environment on this thread.
        mujoco::take_warnings();
        for burner in &mut self.burners {
            burner.observed_opacity = burner.opacity;
        }
        for substep in 0..SUBSTEPS {
            if substep == self.observed_substep {
                self.record_positions();
            }
            self.data.step1(&self.model);
            if substep == 0 {
                self.controller.set_goal(&self.model, &self.data, action, frame);
            }
            if !self.controller.run(&self.model, &mut self.data, action) {
                return Err(SimError::Singular { control_step: self.control_steps });
            }
            self.data.step2(&self.model);
            if substep == self.observed_substep {
                self.record_joints();
            }
        }
        self.check_stability()?;
        self.control_steps += 1;
        self.update_burners();
        Ok(self.succeeded())
    }

    /// Returns the number of control steps since the state was loaded.
    pub fn control_steps(&self) -> u32 {
        self.control_steps
    }

    pub fn succeeded(&self) -> bool {
        self.compiled.goal.holds(&self.model, &self.data)
    }

    /// Returns true if a predicate holds, which need not be in the goal.
    pub fn holds(&self, predicate: Predicate) -> Result<bool, SimError> {
        let predicate = Goal::resolve(&[predicate], self.scene(), &self.model)?;
        Ok(predicate.holds(&self.model, &self.data))
    }

    pub fn goal_truths(&self) -> Vec<bool> {
        self.compiled.goal.truths(&self.model, &self.data)
    }

    /// Returns the robot's readings at the observed instant of the last step.
    pub fn robot_state(&mut self) -> RobotState {
        self.pose_observed();
        let (model, observed) = (&self.model, &self.observed);
        let quat = &observed.xquat(model)[self.compiled.hand_body * 4..][..4];
        let eef_quat_xyzw = [quat[1], quat[2], quat[3], quat[0]];
        let JointReadings { pos, vel } = self.observed_joints;
        RobotState {
            eef_pos: std::array::from_fn(|axis| {
                observed.site_xpos(model)[self.compiled.grip_site * 3 + axis]
            }),
            eef_quat_xyzw,
            eef_axis_angle: axis_angle_of(eef_quat_xyzw),
            eef_rotation: rotation_of(quat),
            joint_pos: std::array::from_fn(|joint| pos[joint]),
            joint_vel: std::array::from_fn(|joint| vel[joint]),
            gripper_pos: [pos[FIRST_FINGER], pos[FIRST_FINGER + 1]],
            gripper_vel: [vel[FIRST_FINGER], vel[FIRST_FINGER + 1]],
        }
    }

    /// Pose at the observed instant: position, m, orientation, x y z w, in the world frame.
    ///
    /// # Panics
    /// If the model has no body with this id.
    pub fn observed_body(&mut self, body: usize) -> ([f64; 3], [f64; 4]) {
        self.pose_observed();
        let pos = &self.observed.xpos(&self.model)[body * 3..][..3];
        let quat = &self.observed.xquat(&self.model)[body * 4..][..4];
        (std::array::from_fn(|axis| pos[axis]), [quat[1], quat[2], quat[3], quat[0]])
    }

    /// Renders a camera's frame at the observed instant of the last step.
    pub fn draw(
        &mut self,
        drawer: &Drawer,
        camera: &str,
        width: u32,
        height: u32,
    ) -> Result<Frame, SimError> {
        let rgb = self.render(drawer, camera, [width, height], Canvas::draw)?;
        Ok(Frame { camera: camera.to_owned(), width, height, rgb })
    }

    /// Depths at the observed instant as in OpenGL: 0 at the near plane, 1 at the far, hyperbolic
    /// in between; rows from bottom to top. Translucent geoms are ignored.
    pub fn depth(
        &mut self,
        drawer: &Drawer,
        camera: &str,
        size: [u32; 2],
    ) -> Result<Vec<f32>, SimError> {
        self.render(drawer, camera, size, Canvas::depth)
    }

    /// Renders the object at the centre of each pixel at the observed instant of the last step;
    /// rows from bottom to top. Translucent geoms count as opaque.
    pub fn segmentation(
        &mut self,
        drawer: &Drawer,
        camera: &str,
        size: [u32; 2],
    ) -> Result<Vec<Option<Segment>>, SimError> {
        self.render(drawer, camera, size, Canvas::segmentation)
    }

    fn render<T>(
        &mut self,
        drawer: &Drawer,
        camera: &str,
        size: [u32; 2],
        draw: impl Fn(&mut Canvas, View<'_>) -> Result<T, SimError>,
    ) -> Result<T, SimError> {
        let id = self.model.id(ObjectKind::Camera, camera)?;
        self.pose_observed();
        let [width, height] = size.map(|side| side.max(CANVAS_SIZE));
        if self.canvas.as_ref().is_none_or(|canvas| !canvas.is_usable_for(drawer, width, height)) {
            // Dropped first, so that two canvases never exist together.
            self.canvas = None;
            self.canvas = Some(Canvas::new(
                drawer,
                &mut self.model,
                |_| self.compiled.prepared(),
                [width, height],
            )?);
        }
        self.show_burners(|burner| burner.observed_opacity);
        let canvas = self.canvas.as_mut().expect("created above");
        let view = View { model: &self.model, data: &mut self.observed, camera: id, size };
        let output = draw(canvas, view);
        self.show_burners(|burner| burner.opacity);
        output
    }

    pub(crate) fn record_all(&mut self) {
        for burner in &mut self.burners {
            burner.observed_opacity = burner.opacity;
        }
        self.record_positions();
        self.record_joints();
    }

    fn record_positions(&mut self) {
        let qpos = self.observed.qpos_mut(&self.model);
        qpos.copy_from_slice(self.data.qpos(&self.model));
        self.has_observed_poses = false;
    }

    fn record_joints(&mut self) {
        let (qpos, qvel) = (self.data.qpos(&self.model), self.data.qvel(&self.model));
        self.observed_joints.pos.copy_from_slice(&qpos[..ARM_JOINTS + 2]);
        self.observed_joints.vel.copy_from_slice(&qvel[..ARM_JOINTS + 2]);
    }

    fn pose_observed(&mut self) {
        if !self.has_observed_poses {
            self.observed.kinematics(&self.model);
            self.observed.com_pos(&self.model);
            self.observed.camlight(&self.model);
            self.has_observed_poses = true;
        }
    }

    fn check_stability(&self) -> Result<(), SimError> {
        let warnings = mujoco::take_warnings();
        if warnings.is_empty() && self.data.instabilities() == 0 {
            return Ok(());
        }
        let problem = match warnings.first() {
            Some(warning) => warning.clone(),
            None => "the state is not finite".to_owned(),
        };
        Err(SimError::Unstable { control_step: self.control_steps, problem })
    }

    /// Sets the opacity of a burner that disagrees with its knob to 1 minus it, like LIBERO.
    pub(crate) fn update_burners(&mut self) {
        let qpos = self.data.qpos(&self.model);
        for burner in &mut self.burners {
            let is_on = burner.knobs.iter().any(|knob| qpos[*knob] >= burner.on_threshold);
            if is_on != (burner.opacity > 0.0) {
                burner.opacity = 1.0 - burner.opacity;
            }
        }
        self.show_burners(|burner| burner.opacity);
    }

    fn show_burners(&mut self, opacity: impl Fn(&Burner) -> f32) {
        for burner in &self.burners {
            self.model.site_rgba_mut()[burner.site * 4 + 3] = opacity(burner);
        }
    }
}

/// Sets the arm's joints and computes the quantities that depend on them, without contacts.
fn pose_arm(model: &Model, data: &mut Data, joints: &[f64; ARM_JOINTS]) {
    data.qpos_mut(model)[..ARM_JOINTS].copy_from_slice(joints);
    let mut without_contacts = model.share();
    without_contacts.disable(DISABLE_CONSTRAINT);
    data.forward(&without_contacts);
}

/// Returns the rotation matrix of a unit quaternion w x y z, row by row.
fn rotation_of(quat: &[f64]) -> [f64; 9] {
    let quat = nalgebra::Quaternion::new(quat[0], quat[1], quat[2], quat[3]);
    let matrix = nalgebra::UnitQuaternion::from_quaternion(quat).to_rotation_matrix();
    std::array::from_fn(|index| matrix[(index / 3, index % 3)])
}
