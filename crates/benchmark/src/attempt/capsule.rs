//! Capsules: a finished rollout in a file, which `worker rollout --capsule` repeats.

use serde::{Deserialize, Serialize};

use super::{Measurement, Motion, RolloutResult};
use crate::{AxisSet, ManifestRow};

/// A finished rollout: the actions that repeat it without its policy, and what the repetition must
/// reproduce.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Capsule {
    pub campaign: String,
    pub replicate: u32,
    pub manifest_row: ManifestRow,
    pub measurement: Measurement,
    /// End-effector positions at rest and after every control step, world frame, tenths of a
    /// millimetre.
    pub path: Vec<[i16; 3]>,
    /// Action of every control step, as [`Motion`] has them; empty if the campaign stores none.
    pub actions: Vec<[f32; 7]>,
    /// The smallest subsets of the axes that change the outcome, where `coordinator explain`
    /// searched for them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub minimal_axes: Vec<AxisSet>,
    /// Control step after which the policy still succeeds if the perturbations end there, the last
    /// such step that `worker rescue` found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saved_until: Option<u32>,
}

impl Capsule {
    /// Reads the first capsule of a file's text, which has one per line.
    ///
    /// # Errors
    /// If the line is no capsule.
    pub fn read(text: &str) -> Result<Capsule, serde_json::Error> {
        serde_json::from_str(text.lines().next().unwrap_or_default())
    }

    /// Returns true if the rollout is of LIBERO's own forty tasks, whose files every simulator has.
    pub fn is_of_libero(&self) -> bool {
        self.manifest_row.id.variant().is_none() && self.manifest_row.simulator.is_none()
    }

    /// Names what a repetition does not reproduce: outcome, digests, or the robot's path.
    pub fn differences(&self, repeated: &RolloutResult, motion: &Motion) -> Vec<String> {
        let (was, is) = (&self.measurement.result, repeated);
        let outcome = |success| if success { "success" } else { "failure" };
        let path = motion.path();
        let step = self.path.iter().zip(&path).position(|(was, is)| was != is);
        let step = step.unwrap_or_else(|| self.path.len().min(path.len()));
        let (was_digests, is_digests) = (&was.digests, &is.digests);
        let found = [
            (
                (was.success, was.steps) == (is.success, is.steps),
                format!(
                    "{} after {} steps, in the capsule {} after {}",
                    outcome(is.success),
                    is.steps,
                    outcome(was.success),
                    was.steps
                ),
            ),
            (was_digests.scene == is_digests.scene, "another scene".to_owned()),
            (was_digests.init_state == is_digests.init_state, "another initial state".to_owned()),
            (self.path == path, format!("another path of the robot from control step {step} on")),
        ];
        let differ = found.into_iter().filter(|(is_same, _)| !is_same);
        differ.map(|(_, difference)| difference).collect()
    }

    /// Names what a repetition is simulated with otherwise, with both values.
    pub fn other_pins(&self, asset_pack_digest: &str, mujoco_version: &str) -> Vec<String> {
        let pin = &self.measurement.provenance.pin;
        let both = [
            ("asset pack", asset_pack_digest, &pin.asset_pack_digest),
            ("MuJoCo", mujoco_version, &pin.mujoco_version),
        ];
        let differ = both.into_iter().filter(|(_, is, was)| is != was);
        differ.map(|(name, is, was)| format!("{name} {is}, in the capsule {was}")).collect()
    }
}
