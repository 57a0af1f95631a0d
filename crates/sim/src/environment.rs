//! One scene, ready to run: loading a state, control steps, success, readings
//! and frames at the original's instants. Knows nothing of perturbations.

use protocol::numpy::LegacyRng;
use scene::catalog::Articulation;
use scene::placement::MAX_DRAWS;
use scene::{AssetPack, Scene, Sources};

use crate::controller::{ARM_JOINTS, Controller, GRIP_SITE, RESET_JOINTS, SUBSTEPS};
use crate::error::SimError;
use crate::mujoco::{self, Data, Model, ObjectKind, Segment};
use crate::observation::{Frame, RobotState, axis_angle_of};
use crate::predicates::Goal;
use crate::render::{Canvas, Drawer, View};
use crate::reset::{Reset, Resets};

/// `mjDSBL_AUTORESET`: an unstable state is reported, not silently replaced.
pub(crate) const DISABLE_AUTORESET: i32 = 1 << 16;
/// `mjDSBL_NATIVECCD`: with it, 3.3.7 collides as the benchmark's 2.3.7 does.
pub(crate) const DISABLE_NATIVE_CCD: i32 = 1 << 17;
/// The body whose orientation is the observed one.
const HAND_BODY: &str = "robot0_right_hand";
/// First position coordinate of the fingers.
const FINGERS: usize = ARM_JOINTS;
/// Kinematics shown by a step's observation are those of this substep.
const OBSERVED_SUBSTEP: usize = SUBSTEPS - 2;
/// Buffers for pictures are at least this large, pixels.
const CANVAS_SIZE: u32 = 256;

/// A compiled scene and its state.
pub struct Environment {
    scene: Scene,
    canvas: Option<Canvas>,
    model: Model,
    data: Data,
    /// Positions only, at the instant that observations show.
    observed: Data,
    observed_is_posed: bool,
    observed_joints: JointReadings,
    pristine: Pristine,
    resets: Resets,
    controller: Controller,
    goal: Goal,
    burners: Vec<Burner>,
    hand_body: usize,
    grip_site: usize,
    control_steps: u32,
}

/// Joint readings at the instant that observations show.
#[derive(Clone, Copy, Default)]
struct JointReadings {
    pos: [f64; ARM_JOINTS + 2],
    vel: [f64; ARM_JOINTS + 2],
}

/// The model's arrays that a rollout may change, fixtures as campaigns place them.
struct Pristine {
    body_pos: Vec<f64>,
    body_quat: Vec<f64>,
    cam_pos: Vec<f64>,
    cam_quat: Vec<f64>,
    light_pos: Vec<f64>,
    light_dir: Vec<f64>,
    light_diffuse: Vec<f32>,
    light_specular: Vec<f32>,
    headlight_ambient: [f32; 3],
    site_rgba: Vec<f32>,
}

/// A site that glows while its stove is on.
struct Burner {
    site: usize,
    /// Position coordinates of the stove's joints.
    knobs: Vec<usize>,
    on_at: f64,
    /// Opacity as drawn, and as the last observation still shows it.
    opacity: f32,
    observed_opacity: f32,
}

impl Environment {
    /// Compiles a scene.
    pub fn new(scene: Scene, pack: &AssetPack, sources: &Sources) -> Result<Self, SimError> {
        let mut model = Model::compile(&scene.mjcf(pack, sources))?;
        model.disable(DISABLE_NATIVE_CCD | DISABLE_AUTORESET);
        let resets = Resets::resolve(&scene.samplers, &model)?;
        for pose in &scene.fixture_poses {
            let body = model.id(ObjectKind::Body, &pose.root_body)?;
            model.body_pos_mut()[body * 3..][..3].copy_from_slice(&pose.pos);
            model.body_quat_mut()[body * 4..][..4].copy_from_slice(&pose.quat);
        }
        hide_marker_sites(&scene, &mut model);
        let mut data = Data::new(&model)?;
        data.qpos_mut(&model)[..ARM_JOINTS].copy_from_slice(&RESET_JOINTS);
        data.forward(&model);
        Ok(Self {
            controller: Controller::new(&model, &data)?,
            goal: Goal::resolve(&scene, &model)?,
            burners: find_burners(&scene, &model)?,
            pristine: Pristine::of(&model),
            resets,
            hand_body: model.id(ObjectKind::Body, HAND_BODY)?,
            grip_site: model.id(ObjectKind::Site, GRIP_SITE)?,
            observed: Data::new(&model)?,
            observed_is_posed: false,
            observed_joints: JointReadings::default(),
            canvas: None,
            control_steps: 0,
            scene,
            model,
            data,
        })
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The compiled model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The model, to be perturbed; [`load`](Self::load) undoes it.
    pub fn model_mut(&mut self) -> &mut Model {
        &mut self.model
    }

    /// The state.
    pub fn data(&self) -> &Data {
        &self.data
    }

    /// The model and its state, for setting poses; [`load`](Self::load) starts over.
    pub fn model_and_data(&mut self) -> (&Model, &mut Data) {
        (&self.model, &mut self.data)
    }

    /// Starts over from a state vector (time, qpos, qvel) of the right width,
    /// with a fresh controller and an unperturbed model, fixtures where
    /// campaigns have them.
    ///
    /// # Panics
    /// If the vector does not have 1 + nq + nv numbers; callers check that
    /// where they read it and can say which file is wrong.
    pub fn load(&mut self, state: &[f64]) {
        let (nq, nv) = (self.model.nq(), self.model.nv());
        assert_eq!(state.len(), 1 + nq + nv, "a state of this scene");
        self.pristine.restore(&mut self.model);
        self.data.reset(&self.model);
        self.data.set_time_secs(state[0]);
        self.data
            .qpos_mut(&self.model)
            .copy_from_slice(&state[1..=nq]);
        self.data
            .qvel_mut(&self.model)
            .copy_from_slice(&state[1 + nq..]);
        self.data.forward(&self.model);
        self.controller.reset();
        self.control_steps = 0;
        for burner in &mut self.burners {
            burner.opacity = self.pristine.site_rgba[burner.site * 4 + 3];
        }
        self.update_burners();
        for burner in &mut self.burners {
            burner.observed_opacity = burner.opacity;
        }
        self.record_positions();
        self.record_joints();
        // Earlier warnings belong to another rollout.
        mujoco::take_warnings();
    }

    /// Starts over without an initial state: draws where everything is from
    /// NumPy's legacy generator, in the original's order, the arm at home, fresh
    /// controllers, time 0; then observes.
    ///
    /// `joint_sampler_rounds` is how often the original has loaded its model by
    /// then: 1 at construction, one more with each hard reset. Its list of
    /// samplers of what starts open, closed, on or off grows by that.
    ///
    /// Where a thing finds no room, everything is drawn again, as the original's
    /// wrapper does, which counts as another hard reset if this is one. Returns
    /// the rounds that it came to: what the next reset's count goes on from.
    ///
    /// # Errors
    /// [`NoRoom`](scene::SceneError::NoRoom) if that fails a thousand times.
    pub fn reset(
        &mut self,
        rng: &mut LegacyRng,
        reset: Reset,
        joint_sampler_rounds: u32,
    ) -> Result<u32, SimError> {
        if reset == Reset::Hard {
            self.pristine.restore(&mut self.model);
            self.resets.put_fixtures_back(&mut self.model);
        }
        let (model, data) = (&mut self.model, &mut self.data);
        let samplers = &self.scene.samplers;
        let mut rounds = joint_sampler_rounds;
        let mut attempts = 1;
        while let Err(error) = self.resets.place(samplers, model, data, rng, rounds) {
            if attempts == MAX_DRAWS {
                return Err(error.into());
            }
            attempts += 1;
            rounds += u32::from(reset == Reset::Hard);
        }
        self.data.forward(&self.model);
        match reset {
            Reset::Hard => self.controller.reset(),
            Reset::Soft => self.controller.reset_arm(),
        }
        self.control_steps = 0;
        // A burner that is on glows from the first step on, not before.
        hide_marker_sites(&self.scene, &mut self.model);
        for burner in &mut self.burners {
            burner.opacity = self.model.site_rgba()[burner.site * 4 + 3];
            burner.observed_opacity = burner.opacity;
        }
        self.record_positions();
        self.record_joints();
        // Earlier warnings belong to another rollout.
        mujoco::take_warnings();
        Ok(rounds)
    }

    /// One control step: 50 ms in 25 simulation steps. True if the goal holds
    /// after it.
    pub fn step(&mut self, action: &[f64; 7]) -> Result<bool, SimError> {
        for burner in &mut self.burners {
            burner.observed_opacity = burner.opacity;
        }
        for substep in 0..SUBSTEPS {
            if substep == OBSERVED_SUBSTEP {
                self.record_positions();
            }
            self.data.step1(&self.model);
            if substep == 0 {
                self.controller.set_goal(&self.model, &self.data, action);
            }
            if !self.controller.run(&self.model, &mut self.data, action) {
                return Err(SimError::Singular {
                    control_step: self.control_steps,
                });
            }
            self.data.step2(&self.model);
            if substep == OBSERVED_SUBSTEP {
                self.record_joints();
            }
        }
        self.check_stability()?;
        self.control_steps += 1;
        self.update_burners();
        Ok(self.succeeded())
    }

    /// Control steps since the state was loaded.
    pub fn control_steps(&self) -> u32 {
        self.control_steps
    }

    /// Whether the goal holds now.
    pub fn succeeded(&self) -> bool {
        self.goal.holds(&self.model, &self.data)
    }

    /// Whether each predicate of the goal holds now.
    pub fn goal_truths(&self) -> Vec<bool> {
        self.goal.truths(&self.model, &self.data)
    }

    /// The robot's readings as the last step returned them.
    pub fn robot_state(&mut self) -> RobotState {
        self.pose_observed();
        let (model, observed) = (&self.model, &self.observed);
        let quat = &observed.xquat(model)[self.hand_body * 4..][..4];
        let eef_quat_xyzw = [quat[1], quat[2], quat[3], quat[0]];
        let JointReadings { pos, vel } = self.observed_joints;
        RobotState {
            eef_pos: std::array::from_fn(|axis| {
                observed.site_xpos(model)[self.grip_site * 3 + axis]
            }),
            eef_quat_xyzw,
            eef_axis_angle: axis_angle_of(eef_quat_xyzw),
            eef_rotation: rotation_of(quat),
            joint_pos: std::array::from_fn(|joint| pos[joint]),
            joint_vel: std::array::from_fn(|joint| vel[joint]),
            gripper_pos: [pos[FINGERS], pos[FINGERS + 1]],
            gripper_vel: [vel[FINGERS], vel[FINGERS + 1]],
        }
    }

    /// Draws what a camera saw at the last step's instant of observation.
    ///
    /// # Errors
    /// If the scene has no such camera, or the renderer cannot draw it.
    pub fn draw(
        &mut self,
        drawer: &Drawer,
        camera: &str,
        width: u32,
        height: u32,
    ) -> Result<Frame, SimError> {
        let rgb = self.render(drawer, camera, [width, height], Canvas::draw)?;
        Ok(Frame {
            camera: camera.to_owned(),
            width,
            height,
            rgb,
        })
    }

    /// How far it was to what a camera saw at that instant, as OpenGL keeps it: 0 at
    /// the near plane, 1 at the far one, hyperbolic in between; rows from bottom to
    /// top. What one can see through is passed over.
    ///
    /// # Errors
    /// As [`Environment::draw`].
    pub fn depth(
        &mut self,
        drawer: &Drawer,
        camera: &str,
        size: [u32; 2],
    ) -> Result<Vec<f32>, SimError> {
        self.render(drawer, camera, size, Canvas::depth)
    }

    /// What a camera saw at that instant in the middle of each pixel; rows from
    /// bottom to top. Nothing can be seen through.
    ///
    /// # Errors
    /// As [`Environment::draw`].
    pub fn segmentation(
        &mut self,
        drawer: &Drawer,
        camera: &str,
        size: [u32; 2],
    ) -> Result<Vec<Option<Segment>>, SimError> {
        self.render(drawer, camera, size, Canvas::segmentation)
    }

    /// Draws something of the last step's instant of observation.
    fn render<T>(
        &mut self,
        drawer: &Drawer,
        camera: &str,
        size: [u32; 2],
        draw: impl Fn(&mut Canvas, View<'_>) -> Result<T, SimError>,
    ) -> Result<T, SimError> {
        let id = self.model.id(ObjectKind::Camera, camera)?;
        self.pose_observed();
        let [wide, high] = size.map(|side| side.max(CANVAS_SIZE));
        if self
            .canvas
            .as_ref()
            .is_none_or(|canvas| !canvas.suits(drawer, wide, high))
        {
            self.canvas = None;
            self.canvas = Some(Canvas::new(drawer, &mut self.model, wide, high)?);
        }
        self.show_burners(|burner| burner.observed_opacity);
        let canvas = self.canvas.as_mut().expect("made above");
        let view = View {
            model: &self.model,
            data: &mut self.observed,
            camera: id,
            size,
        };
        let drawn = draw(canvas, view);
        self.show_burners(|burner| burner.opacity);
        drawn
    }

    fn record_positions(&mut self) {
        let qpos = self.observed.qpos_mut(&self.model);
        qpos.copy_from_slice(self.data.qpos(&self.model));
        self.observed_is_posed = false;
    }

    fn record_joints(&mut self) {
        let (qpos, qvel) = (self.data.qpos(&self.model), self.data.qvel(&self.model));
        self.observed_joints
            .pos
            .copy_from_slice(&qpos[..ARM_JOINTS + 2]);
        self.observed_joints
            .vel
            .copy_from_slice(&qvel[..ARM_JOINTS + 2]);
    }

    /// Computes the observed poses, once per control step and only if an observation
    /// is asked for.
    fn pose_observed(&mut self) {
        if !self.observed_is_posed {
            self.observed.kinematics(&self.model);
            self.observed.com_pos(&self.model);
            self.observed.camlight(&self.model);
            self.observed_is_posed = true;
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
        Err(SimError::Unstable {
            control_step: self.control_steps,
            problem,
        })
    }

    /// The original toggles a burner's opacity to 1 − itself when the knob and
    /// the opacity disagree.
    fn update_burners(&mut self) {
        let qpos = self.data.qpos(&self.model);
        for burner in &mut self.burners {
            let on = burner.knobs.iter().any(|knob| qpos[*knob] >= burner.on_at);
            if on != (burner.opacity > 0.0) {
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

impl Pristine {
    fn of(model: &Model) -> Self {
        Self {
            body_pos: model.body_pos().to_vec(),
            body_quat: model.body_quat().to_vec(),
            cam_pos: model.cam_pos().to_vec(),
            cam_quat: model.cam_quat().to_vec(),
            light_pos: model.light_pos().to_vec(),
            light_dir: model.light_dir().to_vec(),
            light_diffuse: model.light_diffuse().to_vec(),
            light_specular: model.light_specular().to_vec(),
            headlight_ambient: model.headlight_ambient(),
            site_rgba: model.site_rgba().to_vec(),
        }
    }

    fn restore(&self, model: &mut Model) {
        model.body_pos_mut().copy_from_slice(&self.body_pos);
        model.body_quat_mut().copy_from_slice(&self.body_quat);
        model.cam_pos_mut().copy_from_slice(&self.cam_pos);
        model.cam_quat_mut().copy_from_slice(&self.cam_quat);
        model.light_pos_mut().copy_from_slice(&self.light_pos);
        model.light_dir_mut().copy_from_slice(&self.light_dir);
        model
            .light_diffuse_mut()
            .copy_from_slice(&self.light_diffuse);
        model
            .light_specular_mut()
            .copy_from_slice(&self.light_specular);
        model.set_headlight_ambient(self.headlight_ambient);
        model.site_rgba_mut().copy_from_slice(&self.site_rgba);
    }
}

/// The original hides the sites of the robot, the objects and the fixtures by
/// negating their opacity; those of zones on the workspace stay.
fn hide_marker_sites(scene: &Scene, model: &mut Model) {
    let mut prefixes = vec![
        "robot0_".to_owned(),
        "mount0_".to_owned(),
        "gripper0_".to_owned(),
    ];
    prefixes.extend(
        scene
            .instances
            .iter()
            .map(|instance| format!("{}_", instance.name)),
    );
    for site in 0..model.count(ObjectKind::Site) {
        let name = model.name(ObjectKind::Site, site).unwrap_or_default();
        if prefixes.iter().any(|prefix| name.starts_with(prefix)) {
            let opacity = &mut model.site_rgba_mut()[site * 4 + 3];
            *opacity = -opacity.abs();
        }
    }
}

fn find_burners(scene: &Scene, model: &Model) -> Result<Vec<Burner>, SimError> {
    let mut burners = Vec::new();
    for instance in &scene.instances {
        let (Some(name), Articulation::OnOff { on, .. }) =
            (&instance.burner_site, instance.category.articulation)
        else {
            continue;
        };
        let address = |name: &String| {
            let joint = model.id(ObjectKind::Joint, name)?;
            Ok::<_, SimError>(model.jnt_qposadr()[joint] as usize)
        };
        let knobs = instance
            .joints
            .iter()
            .map(address)
            .collect::<Result<_, _>>()?;
        let site = model.id(ObjectKind::Site, name)?;
        burners.push(Burner {
            site,
            knobs,
            on_at: on,
            opacity: 0.0,
            observed_opacity: 0.0,
        });
    }
    Ok(burners)
}

/// The matrix of a unit quaternion w x y z, row by row.
fn rotation_of(quat: &[f64]) -> [f64; 9] {
    let quat = nalgebra::Quaternion::new(quat[0], quat[1], quat[2], quat[3]);
    let matrix = nalgebra::UnitQuaternion::from_quaternion(quat).to_rotation_matrix();
    std::array::from_fn(|index| matrix[(index / 3, index % 3)])
}
