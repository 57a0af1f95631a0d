//! Stage of a rollout: a simulator, and the task that it simulates.

use std::borrow::Cow;

use libero_ctrl::{ManifestRow, Realisation};
use proto::policy as wire;
use scene::TaskFiles;
use sim::{Episode, SimError, Simulator, VariantStart};

use crate::actor::Description;

/// Simulator of a rollout, and the files of the task.
pub struct Stage<'a> {
    simulator: &'a mut Simulator,
    /// In place of those of the row's task.
    files: Option<TaskFiles>,
    /// Circumstances of a variant of LIBERO's family, in place of the row's perturbation.
    variant: Option<VariantStart>,
    /// True if a rollout that nothing is drawn of names the renderer too.
    always_names_renderer: bool,
}

impl<'a> Stage<'a> {
    /// For the protocol's own tasks: each row says which.
    pub fn of_the_protocol(simulator: &'a mut Simulator) -> Self {
        Self {
            simulator,
            files: None,
            variant: None,
            always_names_renderer: true,
        }
    }

    /// For a user's own task, which stands in for the row's.
    pub fn of_files(simulator: &'a mut Simulator, files: TaskFiles) -> Self {
        Self {
            simulator,
            files: Some(files),
            variant: None,
            always_names_renderer: true,
        }
    }

    /// Begins as a variant does, if there is one.
    pub fn with_variant(self, variant: Option<VariantStart>) -> Self {
        Self { variant, ..self }
    }

    /// Leaves the renderer unopened, and unnamed in the evidence, if nothing is
    /// drawn of a rollout. Not for campaigns, which are pinned to a renderer.
    pub fn with_a_renderer_only_if_needed(self) -> Self {
        Self {
            always_names_renderer: false,
            ..self
        }
    }

    /// Returns the renderer's own name and the fingerprint, which covers its
    /// pictures too; both empty if they are not needed.
    pub(crate) fn drawing(&mut self, draws: bool) -> Result<(String, String), SimError> {
        if !draws && !self.always_names_renderer {
            return Ok(Default::default());
        }
        let renderer = self.simulator.renderer_name()?;
        Ok((renderer, self.simulator.fingerprint()?))
    }

    /// Prepares a rollout up to its loaded, perturbed initial state.
    pub(crate) fn begin(
        &mut self,
        row: &ManifestRow,
        realisation: Realisation,
    ) -> Result<Episode<'_>, SimError> {
        match (&self.files, &self.variant) {
            (None, _) => self.simulator.begin(row, realisation),
            (Some(files), None) => self.simulator.begin_with(files.clone(), row, realisation),
            (Some(files), Some(variant)) => {
                self.simulator.begin_variant(files.clone(), row, variant)
            }
        }
    }

    /// A policy's instruction: the row's. A policy that knows the canonical
    /// instructions verbatim, and no other wording, gets those: the language axis
    /// is the identity for it, and not an error in every rollout.
    pub(crate) fn instruction<'r>(
        &self,
        row: &'r ManifestRow,
        description: &Description,
    ) -> Cow<'r, str> {
        let by_heart = description.about.language() == wire::Language::CanonicalOnly;
        let is_of_a_benchmark = self.files.is_none() || self.variant.is_some();
        match by_heart && is_of_a_benchmark {
            true => Cow::Owned(row.id.task().instruction()),
            false => Cow::Borrowed(&row.instruction),
        }
    }

    /// Returns the name of a rollout in messages.
    pub(crate) fn title(&self, row: &ManifestRow) -> String {
        match &self.files {
            None => row.id.to_string(),
            Some(files) => format!("{} from state {}", files.bddl.display(), row.init_id),
        }
    }
}
