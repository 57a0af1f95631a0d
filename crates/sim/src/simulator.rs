//! Simulation of rollouts in a slot: recently used compiled scenes and, once needed, an opened
//! renderer.

use std::sync::Arc;

use benchmark::{Look, ManifestRow, Realisation};
use scene::{AssetPack, Sources, TaskFiles};

use crate::environment::Environment;
use crate::episode::Episode;
use crate::error::SimError;
use crate::fingerprint::fingerprint;
use crate::mujoco;
use crate::ready_scene::ReadyScene;
use crate::render::{LazyDrawer, Renderer};
use crate::variant::VariantStart;

#[derive(Debug, Clone)]
pub struct SimulatorConfig {
    /// Folder of robot models, BDDL files and initial states.
    pub sources: Sources,
    pub pack: AssetPack,
    pub renderer: Renderer,
    /// Scenes in memory; each takes 0.8 to 1.3 GB with LIBERO's assets, unless it is in a file.
    pub cached_scenes: usize,
}

/// A simulator, bound to its thread.
pub struct Simulator {
    config: SimulatorConfig,
    /// Cached scenes, most recently used first.
    scenes: Vec<(ReadyScene, Environment)>,
    drawer: LazyDrawer,
    fingerprint: Option<String>,
}

impl Simulator {
    pub fn new(config: SimulatorConfig) -> Self {
        Self {
            drawer: LazyDrawer::new(config.renderer),
            config,
            scenes: Vec::new(),
            fingerprint: None,
        }
    }

    pub fn sources(&self) -> &Sources {
        &self.config.sources
    }

    /// Returns MuJoCo's version, for example `3.3.7`.
    pub fn mujoco_version() -> String {
        mujoco::version()
    }

    pub fn look(&self) -> Look {
        self.config.pack.look()
    }

    /// Returns the name of the renderer, opening it if necessary.
    pub fn renderer_name(&mut self) -> Result<String, SimError> {
        Ok(self.drawer.open()?.name().to_owned())
    }

    /// Returns the fingerprint of this process and its renderer, opening the renderer if necessary.
    pub fn fingerprint(&mut self) -> Result<String, SimError> {
        if let Some(cached) = &self.fingerprint {
            return Ok(cached.clone());
        }
        let fingerprint = fingerprint(self.drawer.open()?, self.config.pack.look())?;
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

    /// As [`begin`](Self::begin), with `files` instead of the files of the row's task.
    pub fn begin_with(
        &mut self,
        files: TaskFiles,
        row: &ManifestRow,
        realisation: Realisation,
    ) -> Result<Episode<'_>, SimError> {
        self.begin_episode(files, row, realisation, None)
    }

    /// Prepares the start of settling; of a variant's row, uses initial state and number of settling
    /// steps, of a perturbed one's all.
    pub fn begin_variant(
        &mut self,
        files: TaskFiles,
        row: &ManifestRow,
        realisation: Realisation,
        variant: &VariantStart,
    ) -> Result<Episode<'_>, SimError> {
        self.begin_episode(files, row, realisation, Some(variant))
    }

    fn begin_episode(
        &mut self,
        files: TaskFiles,
        row: &ManifestRow,
        realisation: Realisation,
        variant: Option<&VariantStart>,
    ) -> Result<Episode<'_>, SimError> {
        self.make_ready(files)?;
        let (ready, environment) = &mut self.scenes[0];
        Episode::begin(ready, environment, &mut self.drawer, row, realisation, variant)
    }

    /// Moves the scene of these files to the front of the cache, compiling it if necessary.
    fn make_ready(&mut self, files: TaskFiles) -> Result<(), SimError> {
        let stamps = files.stamps();
        let is_ready = |scene: &ReadyScene| scene.files == files && scene.stamps == stamps;
        if let Some(index) = self.scenes.iter().position(|(scene, _)| is_ready(scene)) {
            self.scenes[..=index].rotate_right(1);
            return Ok(());
        }
        // Evicts first, so that the buffers of two scenes are not allocated at once.
        self.scenes.truncate(self.config.cached_scenes.saturating_sub(1));
        let scene = ReadyScene::compile(files, &self.config.pack, &self.config.sources)?;
        let environment = Environment::before_load(Arc::clone(scene.compiled()))?;
        self.scenes.insert(0, (scene, environment));
        Ok(())
    }
}
