//! Result of an attempt.

use serde::{Deserialize, Serialize};

/// Result of a rollout: outcome, steps and timing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RolloutResult {
    /// True if the goal was reached within the step budget.
    pub success: bool,
    /// The policy's control steps: up to the one that reached the goal, or the whole budget.
    pub steps: u32,
    /// Duration from the preparation of the scene to the end of the policy's session, seconds.
    pub wall_secs: f64,
    /// Residual of the inverse kinematics, if the robot axis is perturbed.
    pub ik: Option<IkResidual>,
    /// Executed actions that were clipped into [-1, 1].
    pub clipped_actions: u32,
    pub policy_queries: u32,
    /// Parts of `wall_secs`.
    pub parts: Parts,
    pub goal: GoalProgress,
    /// Prompt that the policy got; `None` if it was empty.
    pub prompt: Option<String>,
}

/// Progress towards a goal during a rollout, in predicates that held. `at_end` ≤
/// `at_most` ≤ `predicates`, and `at_end` = `predicates` exactly in a success.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GoalProgress {
    /// Predicates of the goal; 1 or more.
    pub predicates: u32,
    /// Predicates that held after the last control step.
    pub at_end: u32,
    /// Most predicates that held together, from the settled initial state to the last control step.
    pub at_most: u32,
}

impl GoalProgress {
    /// Records the predicates that hold after a further step.
    pub fn record(&mut self, truths: &[bool]) {
        self.predicates = truths.len() as u32;
        self.at_end = truths.iter().filter(|holds| **holds).count() as u32;
        self.at_most = self.at_most.max(self.at_end);
    }

    /// Returns true if the numbers agree with one another, and with the rollout's
    /// outcome.
    pub fn agrees_with(&self, success: bool) -> bool {
        let Self { predicates, at_end, at_most } = *self;
        predicates > 0
            && at_end <= at_most
            && at_most <= predicates
            && (at_end == predicates) == success
    }
}

/// Parts of a rollout's duration, seconds. The remaining time was spent waiting for a core, a
/// graphics card or a disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Parts {
    /// Processor time of preparing the scene and its initial state, settling and control steps.
    pub physics_secs: f64,
    /// Processor time of rendering the policy's observations.
    pub drawing_secs: f64,
    /// Wall time of the calls to the policy: the session's reset, its queries and its end.
    pub policy_secs: f64,
}

/// Residual of the inverse kinematics.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct IkResidual {
    /// Distance to the target position, mm.
    pub residual_mm: f64,
    /// Angle to the target orientation, degrees.
    pub residual_deg: f64,
    /// Arm joints at a limit.
    pub clamped_joints: u32,
}

/// Packed motion of a rollout's robot, as sent and stored: little endian, without padding.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Motion {
    /// Position of the site between the fingertips, after settling and after every control step of
    /// the policy: x, y, z in the world frame, tenths of a millimetre, 16 bits each.
    pub path: Vec<u8>,
    /// Action of every control step, clipped into [-1, 1] unless the realisation is `reference`:
    /// seven 32-bit floats each; empty unless the campaign stores actions.
    pub actions: Vec<u8>,
}

impl Motion {
    pub fn pack(path: &[[i16; 3]], actions: &[[f32; 7]]) -> Motion {
        let (path, actions) = (path.as_flattened(), actions.as_flattened());
        Motion {
            path: path.iter().flat_map(|number| number.to_le_bytes()).collect(),
            actions: actions.iter().flat_map(|number| number.to_le_bytes()).collect(),
        }
    }

    /// Unpacks the positions.
    pub fn path(&self) -> Vec<[i16; 3]> {
        let numbers = self.path.as_chunks().0.iter();
        let numbers: Vec<i16> = numbers.map(|number| i16::from_le_bytes(*number)).collect();
        numbers.as_chunks().0.to_vec()
    }

    pub fn actions(&self) -> Vec<[f32; 7]> {
        let numbers = self.actions.as_chunks().0.iter();
        let numbers: Vec<f32> = numbers.map(|number| f32::from_le_bytes(*number)).collect();
        numbers.as_chunks().0.to_vec()
    }

    /// Returns true if the packed lengths are whole numbers of positions and actions.
    pub fn is_whole(&self) -> bool {
        self.path.len().is_multiple_of(6) && self.actions.len().is_multiple_of(28)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_records_the_last_and_the_largest_number_of_true_predicates() {
        let mut goal = GoalProgress::default();
        for truths in [[false, false], [true, false], [false, true], [false, false]] {
            goal.record(&truths);
        }
        assert_eq!((goal.predicates, goal.at_end, goal.at_most), (2, 0, 1));
        assert!(goal.agrees_with(false) && !goal.agrees_with(true));
        goal.record(&[true, true]);
        assert!(goal.agrees_with(true) && !goal.agrees_with(false));
        assert!(!GoalProgress::default().agrees_with(true));
    }

    #[test]
    fn a_packed_motion_round_trips() {
        let (path, actions) =
            ([[1, -2, 3], [i16::MIN, 0, i16::MAX]], [[0.1, -1.0, 0.0, 1.0, 0.5, 0.25, -0.3]]);
        let motion = Motion::pack(&path, &actions);
        assert_eq!((motion.path(), motion.actions()), (path.to_vec(), actions.to_vec()));
        assert!(motion.is_whole());
        let truncated = Motion { path: motion.path[1..].to_vec(), ..motion };
        assert!(!truncated.is_whole());
    }
}
