//! Everything that a slot needs to simulate rollouts: the compiled scenes it
//! has met lately and, once it is asked for, an opened renderer.

use protocol::presets::ENV_SEED;
use protocol::{ManifestRow, Realisation};
use scene::{AssetPack, InitialStates, Sources, TaskFiles, compose};

use crate::environment::Environment;
use crate::episode::Episode;
use crate::error::SimError;
use crate::fingerprint::fingerprint;
use crate::mujoco::{self, ObjectKind};
use crate::perturb::{CameraPose, look_at_point};
use crate::render::{Drawer, Renderer};

/// The camera that the camera axis moves.
pub(crate) const PERTURBED_CAMERA: &str = "agentview";
/// `mjJNT_FREE`.
const FREE_JOINT: i32 = 0;

/// How to set a simulator up.
#[derive(Debug, Clone)]
pub struct SimulatorConfig {
    /// Robot models, BDDL files, initial states.
    pub sources: Sources,
    /// Models of objects and arenas.
    pub pack: AssetPack,
    /// What draws.
    pub renderer: Renderer,
    /// Compiled scenes kept; each takes some 100 MB with the real assets.
    pub cached_scenes: usize,
}

/// A simulator, bound to its thread.
pub struct Simulator {
    config: SimulatorConfig,
    /// Latest first. Before the drawer, which their canvases need.
    scenes: Vec<ReadyScene>,
    drawer: Option<Drawer>,
    fingerprint: Option<String>,
}

/// A compiled scene with what is computed once for it.
pub(crate) struct ReadyScene {
    pub(crate) environment: Environment,
    pub(crate) states: InitialStates,
    pub(crate) digest: String,
    /// Nominal pose of the perturbed camera, and the point it looks at.
    pub(crate) camera: CameraPose,
    pub(crate) look_at: [f64; 3],
    files: TaskFiles,
}

impl Simulator {
    /// A simulator without any scene yet. The renderer is not opened before
    /// something is asked of it.
    pub fn new(config: SimulatorConfig) -> Self {
        Self {
            config,
            scenes: Vec::new(),
            drawer: None,
            fingerprint: None,
        }
    }

    /// The library's version, for example `3.3.7`.
    pub fn mujoco_version() -> String {
        mujoco::version()
    }

    /// What draws, by its own name; opens it.
    pub fn renderer_name(&mut self) -> Result<String, SimError> {
        Ok(self.drawer()?.name().to_owned())
    }

    /// The fingerprint of this process and its renderer; opens it.
    pub fn fingerprint(&mut self) -> Result<String, SimError> {
        if let Some(known) = &self.fingerprint {
            return Ok(known.clone());
        }
        let fingerprint = fingerprint(self.drawer()?)?;
        self.fingerprint = Some(fingerprint.clone());
        Ok(fingerprint)
    }

    /// Prepares a rollout up to its loaded, perturbed initial state.
    pub fn begin(
        &mut self,
        row: &ManifestRow,
        realisation: Realisation,
    ) -> Result<Episode<'_>, SimError> {
        let files = TaskFiles::of_task(&self.config.sources, row.id.task());
        self.begin_with(files, row, realisation)
    }

    /// The same with a BDDL file and initial states of one's own, in place of
    /// those of the row's task.
    pub fn begin_with(
        &mut self,
        files: TaskFiles,
        row: &ManifestRow,
        realisation: Realisation,
    ) -> Result<Episode<'_>, SimError> {
        self.make_ready(files)?;
        Episode::begin(self, row, realisation)
    }

    /// The scene of the rollout in hand.
    pub(crate) fn ready(&mut self) -> &mut ReadyScene {
        &mut self.scenes[0]
    }

    /// The scene of the rollout in hand, and what draws it.
    pub(crate) fn ready_to_draw(&mut self) -> Result<(&mut ReadyScene, &Drawer), SimError> {
        self.drawer()?;
        let drawer = self.drawer.as_ref().expect("opened above");
        Ok((&mut self.scenes[0], drawer))
    }

    fn drawer(&mut self) -> Result<&Drawer, SimError> {
        if self.drawer.is_none() {
            self.drawer = Some(Drawer::open(self.config.renderer)?);
        }
        Ok(self.drawer.as_ref().expect("just opened"))
    }

    /// Moves the files' scene to the front, compiling it if need be.
    fn make_ready(&mut self, files: TaskFiles) -> Result<(), SimError> {
        if let Some(index) = self.scenes.iter().position(|scene| scene.files == files) {
            self.scenes[..=index].rotate_right(1);
            return Ok(());
        }
        // Room first: two scenes' buffers need not be alive at once.
        self.scenes
            .truncate(self.config.cached_scenes.saturating_sub(1));
        let scene = ReadyScene::compile(files, &self.config)?;
        self.scenes.insert(0, scene);
        Ok(())
    }
}

impl ReadyScene {
    fn compile(files: TaskFiles, config: &SimulatorConfig) -> Result<Self, SimError> {
        let problem = files.problem()?;
        let states = InitialStates::read(&files.init)?;
        let scene = compose(&problem, &config.pack, &config.sources, ENV_SEED)?;
        let digest = scene.digest();
        let mut environment = Environment::new(scene, &config.pack, &config.sources)?;
        let needed = 1 + environment.model().nq() + environment.model().nv();
        if states.width() != needed {
            return Err(SimError::StateWidth {
                id: 0,
                file: files.init.display().to_string(),
                found: states.width(),
                needed,
            });
        }
        environment.load(states.get(0).expect("there is at least one"));
        let camera = nominal_camera(&environment)?;
        let look_at = look_at_point(&camera, &movable_centres(&environment));
        Ok(Self {
            environment,
            states,
            digest,
            camera,
            look_at,
            files,
        })
    }

    /// An initial state of the task.
    pub(crate) fn state(&self, id: u16) -> Result<&[f64], SimError> {
        self.states
            .get(usize::from(id))
            .ok_or_else(|| SimError::NoSuchState {
                id: usize::from(id),
                file: self.files.init.display().to_string(),
                count: self.states.count(),
            })
    }
}

fn nominal_camera(environment: &Environment) -> Result<CameraPose, SimError> {
    let model = environment.model();
    let camera = model.id(ObjectKind::Camera, PERTURBED_CAMERA)?;
    Ok(CameraPose {
        position: std::array::from_fn(|axis| model.cam_pos()[camera * 3 + axis]),
        quat_wxyz: std::array::from_fn(|index| model.cam_quat()[camera * 4 + index]),
    })
}

/// Centres of mass of everything with a free joint, world frame, m.
fn movable_centres(environment: &Environment) -> Vec<[f64; 3]> {
    let (model, data) = (environment.model(), environment.data());
    let joints = model.jnt_type().iter().zip(model.jnt_bodyid());
    joints
        .filter(|(kind, _)| **kind == FREE_JOINT)
        .map(|(_, body)| std::array::from_fn(|axis| data.xipos(model)[*body as usize * 3 + axis]))
        .collect()
}
