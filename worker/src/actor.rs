//! What acts in a rollout. Responsible for nothing but the seam: policies behind
//! a connection are `policy`'s, recordings `single`'s.

use proto::policy::Observation;

use crate::policy::{Action, Description, Episode, PolicyError};

/// Whoever acts in rollouts: a policy behind a connection, or a recording.
pub trait Actor {
    /// What it is and wants to see.
    ///
    /// # Errors
    /// If it does not answer, speaks another version, or describes something
    /// that no rollout can work with.
    fn describe(&mut self, episode: Episode<'_>) -> Result<Description, PolicyError>;

    /// Starts an episode.
    ///
    /// # Errors
    /// If it does not answer or refuses.
    fn reset(
        &mut self,
        episode: Episode<'_>,
        suite: &str,
        instruction: &str,
        seed: u64,
    ) -> Result<(), PolicyError>;

    /// Its answers to one observation: between one and `horizon` actions,
    /// finite, not yet clipped.
    ///
    /// # Errors
    /// If it does not answer, or answers something else.
    fn infer(
        &mut self,
        episode: Episode<'_>,
        query_index: u32,
        observation: Observation,
        horizon: usize,
    ) -> Result<Vec<Action>, PolicyError>;
}
