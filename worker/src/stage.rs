//! Simulator and task of a rollout.

use std::borrow::Cow;

use benchmark::{Look, ManifestRow, Realisation};
use proto::policy as wire;
use scene::TaskFiles;
use sim::{Episode, SimError, Simulator, VariantStart};

use crate::actor::Description;

/// Simulator of a rollout, with the task files if they differ from the row's.
pub struct Stage<'a> {
    simulator: &'a mut Simulator,
    /// Task files in place of those of the row's task.
    files: Option<TaskFiles>,
    /// Initial conditions of a rollout of LIBERO's family or of a suite file.
    variant: Option<VariantStart>,
    /// True if the renderer is named even for a rollout without frames.
    always_names_renderer: bool,
}

impl<'a> Stage<'a> {
    /// Creates a stage for the protocol's tasks, which each row names.
    pub fn of_the_protocol(simulator: &'a mut Simulator) -> Self {
        Self { simulator, files: None, variant: None, always_names_renderer: true }
    }

    /// Creates a stage for task files that replace those of the row's task.
    pub fn of_files(simulator: &'a mut Simulator, files: TaskFiles) -> Self {
        Self { simulator, files: Some(files), variant: None, always_names_renderer: true }
    }

    /// Starts episodes from a variant's initial conditions, if one is given.
    pub fn with_variant(self, variant: Option<VariantStart>) -> Self {
        Self { variant, ..self }
    }

    /// Leaves the renderer closed, and unnamed in the provenance, if a rollout renders nothing. Not
    /// for campaigns, which are pinned to a renderer.
    pub fn with_a_renderer_only_if_needed(self) -> Self {
        Self { always_names_renderer: false, ..self }
    }

    /// Returns the renderer's own name and the fingerprint, which covers rendering too. Both are
    /// empty if the renderer stays closed, see [`Self::with_a_renderer_only_if_needed`].
    pub(crate) fn renderer_and_fingerprint(
        &mut self,
        needs_renderer: bool,
    ) -> Result<(String, String), SimError> {
        if !needs_renderer && !self.always_names_renderer {
            return Ok(Default::default());
        }
        let renderer = self.simulator.renderer_name()?;
        Ok((renderer, self.simulator.fingerprint()?))
    }

    pub(crate) fn look(&self) -> Look {
        self.simulator.look()
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
                self.simulator.begin_variant(files.clone(), row, realisation, variant)
            }
        }
    }

    /// Returns the policy's instruction, normally the row's. A policy that accepts only the
    /// canonical wording gets the canonical wording, so that the language axis has no effect on the
    /// policy instead of failing every rollout. A user's own task has one wording, which every policy
    /// gets.
    pub(crate) fn instruction<'r>(
        &self,
        row: &'r ManifestRow,
        description: &Description,
    ) -> Cow<'r, str> {
        let is_canonical_only = description.about.language() == wire::Language::CanonicalOnly;
        let has_canonical_instruction = self.files.is_none() || self.variant.is_some();
        match is_canonical_only && has_canonical_instruction {
            true => Cow::Owned(row.canonical_instruction()),
            false => Cow::Borrowed(&row.instruction),
        }
    }

    /// Returns the name of a rollout in messages.
    pub(crate) fn title(&self, row: &ManifestRow) -> String {
        match &self.files {
            None => row.id.to_string(),
            Some(_) if self.variant.is_some() => row.id.to_string(),
            Some(files) => format!("{} from state {}", files.bddl.display(), row.init_id),
        }
    }
}
