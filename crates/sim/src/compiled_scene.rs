//! A compiled scene, shared by its environments.

use std::sync::{Arc, OnceLock};

use scene::catalog::Articulation;
use scene::{AssetPack, Scene, Sources};

use crate::controller::GRIP_SITE;
use crate::error::SimError;
use crate::mujoco::{Model, ObjectKind, return_freed_memory};
use crate::predicates::Goal;
use crate::render::Prepared;
use crate::reset::Resets;
use crate::scene_files::{LoadedScene, SceneFolder, name_of_scene};

/// `mjDSBL_CONSTRAINT`: disables contacts, limits and friction.
pub(crate) const DISABLE_CONSTRAINT: i32 = 1;
/// `mjDSBL_AUTORESET`: reports an unstable state instead of silently resetting it.
pub(crate) const DISABLE_AUTORESET: i32 = 1 << 16;
/// `mjDSBL_NATIVECCD`: makes MuJoCo 3.3.7 detect collisions like the benchmark's MuJoCo 2.3.7.
pub(crate) const DISABLE_NATIVE_CCD: i32 = 1 << 17;
const HAND_BODY: &str = "robot0_right_hand";

/// A scene's unperturbed model, with ids that were looked up once.
pub struct CompiledScene {
    pub(crate) scene: Scene,
    pub(crate) model: Model,
    pub(crate) goal: Goal,
    pub(crate) burners: Vec<Burner>,
    pub(crate) resets: Resets,
    pub(crate) hand_body: usize,
    pub(crate) grip_site: usize,
    prepared: OnceLock<Arc<Prepared>>,
}

/// Site that is visible while its stove is on.
#[derive(Clone)]
pub(crate) struct Burner {
    pub(crate) site: usize,
    /// Indices of the stove's joint positions in qpos.
    pub(crate) knobs: Vec<usize>,
    pub(crate) on_threshold: f64,
    pub(crate) opacity: f32,
    pub(crate) observed_opacity: f32,
}

impl CompiledScene {
    /// Maps the stored model into memory if this machine has compiled the scene before.
    pub fn compile(scene: Scene, pack: &AssetPack, sources: &Sources) -> Result<Self, SimError> {
        let compile = || {
            scene.verify_files(pack)?;
            Model::compile(&scene.mjcf(pack, sources))
        };
        let LoadedScene { mut model, prepared } = match SceneFolder::of_process() {
            Some(folder) => folder.obtain(&name_of_scene(&scene, pack, sources), compile)?,
            None => LoadedScene { model: compile()?, prepared: None },
        };
        model.disable(DISABLE_NATIVE_CCD | DISABLE_AUTORESET);
        let resets = Resets::resolve(&scene.samplers, &model)?;
        for pose in &scene.fixture_poses {
            let body = model.id(ObjectKind::Body, &pose.root_body)?;
            model.body_pos_mut()[body * 3..][..3].copy_from_slice(&pose.pos);
            model.body_quat_mut()[body * 4..][..4].copy_from_slice(&pose.quat);
        }
        hide_marker_sites(&scene, &mut model);
        Ok(Self {
            goal: Goal::resolve(&scene.goal, &scene, &model)?,
            burners: find_burners(&scene, &model)?,
            resets,
            hand_body: model.id(ObjectKind::Body, HAND_BODY)?,
            grip_site: model.id(ObjectKind::Site, GRIP_SITE)?,
            prepared: prepared.map_or_else(OnceLock::new, OnceLock::from),
            scene,
            model,
        })
    }

    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Returns the unperturbed model, with which every rollout starts.
    pub fn model(&self) -> &Model {
        &self.model
    }

    pub(crate) fn prepared(&self) -> Result<Arc<Prepared>, SimError> {
        if let Some(prepared) = self.prepared.get() {
            return Ok(Arc::clone(prepared));
        }
        let prepared = Arc::new(Prepared::from_model(&self.model)?);
        return_freed_memory();
        // If another thread was faster, all threads use that thread's data.
        Ok(Arc::clone(self.prepared.get_or_init(|| prepared)))
    }
}

/// Negates opacities, like robosuite; zones' sites on the workspace stay visible.
pub(crate) fn hide_marker_sites(scene: &Scene, model: &mut Model) {
    let mut prefixes = vec!["robot0_".to_owned(), "mount0_".to_owned(), "gripper0_".to_owned()];
    prefixes.extend(scene.instances.iter().map(|instance| format!("{}_", instance.name)));
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
        let knobs = instance.joints.iter().map(address).collect::<Result<_, _>>()?;
        let site = model.id(ObjectKind::Site, name)?;
        burners.push(Burner {
            site,
            knobs,
            on_threshold: on,
            opacity: model.site_rgba()[site * 4 + 3],
            observed_opacity: 0.0,
        });
    }
    Ok(burners)
}
