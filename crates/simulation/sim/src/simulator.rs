//! Everything that a slot needs to simulate rollouts: the compiled scenes it
//! has met lately and, once it is asked for, an opened renderer.

use std::sync::Arc;

use libero_ctrl::{ManifestRow, Realisation};
use scene::{AssetPack, Sources, TaskFiles};

use crate::environment::Environment;
use crate::episode::Episode;
use crate::error::SimError;
use crate::fingerprint::fingerprint;
use crate::mujoco;
use crate::ready_scene::ReadyScene;
use crate::render::{LazyDrawer, Renderer};
use crate::variant::VariantStart;

/// Configuration of a simulator.
#[derive(Debug, Clone)]
pub struct SimulatorConfig {
    /// Robot models, BDDL files, initial states.
    pub sources: Sources,
    /// Models of objects and arenas.
    pub pack: AssetPack,
    /// Renderer of the frames.
    pub renderer: Renderer,
    /// Compiled scenes kept; each takes some 100 MB with the real assets where it is not
    /// kept in a file.
    pub cached_scenes: usize,
}

/// A simulator, bound to its thread.
pub struct Simulator {
    config: SimulatorConfig,
    /// Latest first.
    scenes: Vec<(ReadyScene, Environment)>,
    drawer: LazyDrawer,
    fingerprint: Option<String>,
}

impl Simulator {
    /// A simulator without any scene yet. The renderer is not opened before
    /// something is asked of it.
    pub fn new(config: SimulatorConfig) -> Self {
        Self {
            drawer: LazyDrawer::new(config.renderer),
            config,
            scenes: Vec::new(),
            fingerprint: None,
        }
    }

    /// The library's version, for example `3.3.7`.
    pub fn mujoco_version() -> String {
        mujoco::version()
    }

    /// Name of the renderer; opens it.
    pub fn renderer_name(&mut self) -> Result<String, SimError> {
        Ok(self.drawer.open()?.name().to_owned())
    }

    /// The fingerprint of this process and its renderer; opens it.
    pub fn fingerprint(&mut self) -> Result<String, SimError> {
        if let Some(known) = &self.fingerprint {
            return Ok(known.clone());
        }
        let fingerprint = fingerprint(self.drawer.open()?)?;
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

    /// The same with another BDDL file and other initial states than those of the
    /// row's task.
    pub fn begin_with(
        &mut self,
        files: TaskFiles,
        row: &ManifestRow,
        realisation: Realisation,
    ) -> Result<Episode<'_>, SimError> {
        self.begin_either(files, row, realisation, None)
    }

    /// Prepares a rollout of a variant of LIBERO's family up to the state in which it begins
    /// to wait. Of the row, the initial state and the waits count.
    pub fn begin_variant(
        &mut self,
        files: TaskFiles,
        row: &ManifestRow,
        variant: &VariantStart,
    ) -> Result<Episode<'_>, SimError> {
        self.begin_either(files, row, Realisation::Matched, Some(variant))
    }

    fn begin_either(
        &mut self,
        files: TaskFiles,
        row: &ManifestRow,
        realisation: Realisation,
        variant: Option<&VariantStart>,
    ) -> Result<Episode<'_>, SimError> {
        self.make_ready(files)?;
        let (ready, environment) = &mut self.scenes[0];
        Episode::begin(
            ready,
            environment,
            &mut self.drawer,
            row,
            realisation,
            variant,
        )
    }

    /// Moves the files' scene to the front, compiling it if need be.
    fn make_ready(&mut self, files: TaskFiles) -> Result<(), SimError> {
        if let Some(index) = self
            .scenes
            .iter()
            .position(|(scene, _)| scene.files == files)
        {
            self.scenes[..=index].rotate_right(1);
            return Ok(());
        }
        // Room first: two scenes' buffers need not be alive at once.
        self.scenes
            .truncate(self.config.cached_scenes.saturating_sub(1));
        let scene = ReadyScene::compile(files, &self.config.pack, &self.config.sources)?;
        let environment = Environment::before_load(Arc::clone(scene.compiled()))?;
        self.scenes.insert(0, (scene, environment));
        Ok(())
    }
}
