use std::sync::Arc;

use benchmark::family::plus::CameraPose as WrittenPose;
use benchmark::presets::ENV_SEED;
use scene::arena::arena;
use scene::{AssetPack, FileStamps, InitialStates, Sources, TaskFiles, compose};

use crate::compiled_scene::CompiledScene;
use crate::environment::Environment;
use crate::error::SimError;
use crate::mujoco::ObjectKind;
use crate::perturb::{CameraPose, look_at_point};

pub(crate) const PERTURBED_CAMERA: &str = "agentview";
/// `mjJNT_FREE`.
pub(crate) const FREE_JOINT: i32 = 0;

/// A task's compiled scene and what is computed from it once, shared by all environments of the task.
pub struct ReadyScene {
    pub(crate) compiled: Arc<CompiledScene>,
    pub(crate) states: InitialStates,
    pub(crate) digest: String,
    /// Point that the perturbed camera turns about, world frame, m.
    pub(crate) look_at: [f64; 3],
    /// Pose of the perturbed camera as written in the arena, before MuJoCo normalises it.
    pub(crate) written_camera: Option<WrittenPose>,
    pub(crate) files: TaskFiles,
    pub(crate) stamps: FileStamps,
}

impl ReadyScene {
    pub fn compile(
        files: TaskFiles,
        pack: &AssetPack,
        sources: &Sources,
    ) -> Result<Self, SimError> {
        // Stamps precede the reading, so that a change during the reading is noticed later.
        let stamps = files.stamps();
        let problem = files.problem()?;
        let states = InitialStates::read(&files.init)?;
        let scene = compose(&problem, pack, sources, ENV_SEED)?;
        let digest = scene.digest();
        let compiled = Arc::new(CompiledScene::compile(scene, pack, sources)?);
        let mut environment = Environment::before_load(Arc::clone(&compiled))?;
        let needed = 1 + environment.model().nq() + environment.model().nv();
        if states.width() != needed {
            return Err(SimError::StateWidth {
                // All states of a file have one width.
                id: 0,
                file: files.init.display().to_string(),
                found: states.width(),
                needed,
            });
        }
        environment.load(states.get(0).expect("a file holds at least one state"));
        let camera = nominal_camera(&environment)?;
        let look_at = look_at_point(&camera, &movable_centres(&environment));
        Ok(Self {
            compiled,
            states,
            digest,
            look_at,
            written_camera: written_camera(&problem.name),
            files,
            stamps,
        })
    }

    pub fn compiled(&self) -> &Arc<CompiledScene> {
        &self.compiled
    }

    pub fn states(&self) -> &InitialStates {
        &self.states
    }

    pub(crate) fn state(&self, id: u16) -> Result<&[f64], SimError> {
        self.states.get(usize::from(id)).ok_or_else(|| SimError::NoSuchState {
            id: usize::from(id),
            file: self.files.init.display().to_string(),
            count: self.states.count(),
        })
    }
}

/// Returns the pose of `agentview` as written in the arena of a problem class, before `MuJoCo`
/// normalises it; `None` if the class is unknown or its arena does not set the camera.
pub fn written_camera(problem: &str) -> Option<WrittenPose> {
    arena(problem)?.camera(PERTURBED_CAMERA)
}

pub(crate) fn nominal_camera(environment: &Environment) -> Result<CameraPose, SimError> {
    let model = environment.model();
    let camera = model.id(ObjectKind::Camera, PERTURBED_CAMERA)?;
    Ok(CameraPose {
        position: std::array::from_fn(|axis| model.cam_pos()[camera * 3 + axis]),
        quat_wxyz: std::array::from_fn(|index| model.cam_quat()[camera * 4 + index]),
    })
}

/// Returns the centres of mass of all bodies with a free joint, world frame, m.
fn movable_centres(environment: &Environment) -> Vec<[f64; 3]> {
    let (model, data) = (environment.model(), environment.data());
    let joints = model.jnt_type().iter().zip(model.jnt_bodyid());
    joints
        .filter(|(kind, _)| **kind == FREE_JOINT)
        .map(|(_, body)| std::array::from_fn(|axis| data.xipos(model)[*body as usize * 3 + axis]))
        .collect()
}
