//! Result of an attempt. One value from the slot to the database, the export and the report: a field
//! is declared, and its bounds are checked, only here.

use crate::Axis;
use serde::{Deserialize, Serialize};

use crate::attempt::{Digests, Provenance, Realised};

/// Longest prompt of a result, bytes.
pub const MAX_PROMPT_BYTES: usize = 4_096;
/// Largest measured number, in seconds, millimetres or degrees; bounded so that sums stay finite.
const MAX_MEASURED: f64 = 1e9;
/// Most values of one realised axis; the metric axes, which have numeric parameters, have at most a
/// few dozen.
const MAX_REALISED_VALUES: usize = 1_024;

/// Result of a rollout with its provenance, as a slot measures it and a worker sends it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measurement {
    pub result: RolloutResult,
    pub provenance: Provenance,
}

/// Result of a rollout: outcome, steps and timing, and what it is compared by.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RolloutResult {
    /// True if the goal was reached within the step budget.
    pub success: bool,
    /// The policy's control steps: up to the one that reached the goal, or the whole budget.
    pub steps: u32,
    /// Duration from the preparation of the scene to the end of the policy's session, seconds.
    pub wall_secs: f64,
    /// Residual of the inverse kinematics, if the robot axis is perturbed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ik: Option<IkResidual>,
    /// Executed actions that were clipped into [-1, 1].
    pub clipped_actions: u32,
    pub policy_queries: u32,
    /// Parts of `wall_secs`.
    pub parts: Parts,
    pub goal: GoalProgress,
    /// Prompt that the policy got; `None` if it was empty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt: Option<String>,
    /// Digests of the scene, the initial state and the first frames.
    pub digests: Digests,
    /// The perturbation as it was realised.
    pub realised: Realised,
}

impl Measurement {
    /// Reads JSON; the parser is compiled here, where the development build is optimised too.
    pub fn from_json(json: &str) -> serde_json::Result<Measurement> {
        serde_json::from_str(json)
    }
}

impl RolloutResult {
    /// Reads JSON, like [`Measurement::from_json`].
    pub fn from_json(json: &str) -> serde_json::Result<RolloutResult> {
        serde_json::from_str(json)
    }

    /// Describes the first field with a value that no worker measures; `None` if there is none.
    pub fn problem(&self) -> Option<String> {
        let Parts { physics_secs, drawing_secs, policy_secs } = self.parts;
        let measured = [
            ("wall_secs", self.wall_secs),
            ("parts.physics_secs", physics_secs),
            ("parts.drawing_secs", drawing_secs),
            ("parts.policy_secs", policy_secs),
            ("ik.residual_mm", self.ik.map_or(0.0, |ik| ik.residual_mm)),
            ("ik.residual_deg", self.ik.map_or(0.0, |ik| ik.residual_deg)),
        ];
        let beyond = measured.iter().find(|(_, value)| !(0.0..=MAX_MEASURED).contains(value));
        if let Some((field, value)) = beyond {
            return Some(format!("`{field}` is {value:e}; it must be from 0 to {MAX_MEASURED:e}"));
        }
        if !self.goal.agrees_with(self.success) {
            return Some("`goal` is inconsistent in itself or with `success`".to_owned());
        }
        let prompt_bytes = self.prompt.as_ref().map_or(1, String::len);
        if !(1..=MAX_PROMPT_BYTES).contains(&prompt_bytes) {
            return Some(format!(
                "`prompt` has {prompt_bytes} bytes; it may have 1 to {MAX_PROMPT_BYTES}"
            ));
        }
        self.digests.problem().or_else(|| {
            let (axis, _) = self.realised.axes().find(|(axis, realised)| {
                let mut values = realised.parameters.iter().chain(&realised.elements);
                !Axis::METRIC.contains(axis)
                    || values.clone().count() > MAX_REALISED_VALUES
                    || !values.all(|value| value.is_finite())
            })?;
            Some(format!(
                "`realised` of axis `{axis}`: each axis must be metric and have at most \
                 {MAX_REALISED_VALUES} values, all finite"
            ))
        })
    }
}

/// Progress towards a goal during a rollout, in predicates that held. `at_end` ≤
/// `at_most` ≤ `predicates`, and `at_end` = `predicates` exactly in a success.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
#[serde(deny_unknown_fields)]
pub struct Parts {
    /// Processor time of preparing the scene and its initial state, settling and control steps.
    pub physics_secs: f64,
    /// Processor time of rendering the policy's observations.
    pub drawing_secs: f64,
    /// Wall time of the calls to the policy: the session's reset, its queries and its end.
    pub policy_secs: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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

/// Converts a position from metres to tenths of a millimetre.
pub fn tenths_of_mm(position: [f64; 3]) -> [i16; 3] {
    const TENTHS_OF_MM_PER_M: f64 = 10_000.0;
    // A cast from float to integer saturates, at about three metres.
    position.map(|metres| (metres * TENTHS_OF_MM_PER_M).round() as i16)
}

impl Motion {
    pub fn pack(path: &[[i16; 3]], actions: &[[f32; 7]]) -> Motion {
        let (path, actions) = (path.as_flattened(), actions.as_flattened());
        Motion {
            path: path.iter().flat_map(|number| number.to_le_bytes()).collect(),
            actions: actions.iter().flat_map(|number| number.to_le_bytes()).collect(),
        }
    }

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
    use crate::attempt::{MAX_SETTINGS, MAX_TEXT_BYTES, Pin};

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

    fn measured() -> Measurement {
        let digest = "0".repeat(64);
        let mut realised = Realised::default();
        realised.add(Axis::Robot, vec![0.1], vec![1.0 / 3.0, -0.0]);
        let ik = IkResidual { residual_mm: 0.1 + 0.2, residual_deg: 5e-324, clamped_joints: 1 };
        let required = || "x".to_owned();
        Measurement {
            result: RolloutResult {
                wall_secs: 1.0,
                ik: Some(ik),
                goal: GoalProgress { predicates: 2, at_end: 0, at_most: 1 },
                prompt: Some("pick\nup \u{1b}".to_owned()),
                digests: Digests {
                    scene: digest.clone(),
                    init_state: digest.clone(),
                    first_frame: String::new(),
                },
                realised,
                ..RolloutResult::default()
            },
            provenance: Provenance {
                pin: Pin {
                    asset_pack: required(),
                    asset_pack_digest: required(),
                    mujoco_version: required(),
                    renderer: required(),
                    ..Pin::default()
                },
                fingerprint: digest,
                realisation: "matched".to_owned(),
                policy_name: required(),
                ..Provenance::default()
            },
        }
    }

    #[test]
    fn a_result_keeps_every_bit_as_json_and_has_no_unknown_fields() {
        let json = serde_json::to_string(&measured()).expect("JSON");
        let read: Measurement = serde_json::from_str(&json).expect("a result");
        assert_eq!(read, measured());
        assert_eq!(serde_json::to_string(&read).expect("JSON"), json);
        // Every object but the policy's settings.
        for object in [
            "",
            "result",
            "result/parts",
            "result/goal",
            "result/ik",
            "result/digests",
            "result/realised",
            "result/realised/robot",
            "provenance",
        ] {
            let mut more: serde_json::Value = serde_json::from_str(&json).expect("JSON");
            let pointer = if object.is_empty() { String::new() } else { format!("/{object}") };
            more.pointer_mut(&pointer).expect(object)["colour"] = 1.into();
            let error = serde_json::from_value::<Measurement>(more).expect_err(object);
            assert!(error.to_string().contains("colour"), "{object}: {error}");
        }
    }

    #[test]
    fn every_bound_is_checked_and_names_its_field() {
        assert_eq!(measured().result.problem(), None);
        assert_eq!(measured().provenance.problem(), None);
        type Alter = fn(&mut RolloutResult);
        let results: [(Alter, &str); 13] = [
            (|of| of.wall_secs = f64::NAN, "`wall_secs` is NaN"),
            (|of| of.parts.physics_secs = -0.5, "`parts.physics_secs`"),
            (|of| of.parts.drawing_secs = f64::INFINITY, "`parts.drawing_secs`"),
            (|of| of.parts.policy_secs = 1e10, "`parts.policy_secs`"),
            (|of| of.ik.as_mut().expect("ik").residual_mm = -1.0, "`ik.residual_mm`"),
            (|of| of.ik.as_mut().expect("ik").residual_deg = 1e308, "`ik.residual_deg`"),
            (|of| of.success = true, "`goal`"),
            (|of| of.prompt = Some(String::new()), "`prompt`"),
            (|of| of.prompt = Some("x".repeat(MAX_PROMPT_BYTES + 1)), "`prompt`"),
            (|of| of.digests.scene.clear(), "`digests.scene`"),
            (|of| of.digests.init_state = "0".repeat(63), "`digests.init_state`"),
            (|of| of.digests.first_frame = "A".repeat(64), "`digests.first_frame`"),
            (|of| of.realised.add(Axis::Language, vec![], vec![]), "`language`"),
        ];
        for (alter, words) in results {
            let mut result = measured().result;
            alter(&mut result);
            let problem = result.problem().expect(words);
            assert!(problem.contains(words), "{problem} lacks {words}");
        }
        for values in [vec![f64::NAN], vec![0.0; MAX_REALISED_VALUES]] {
            let mut result = measured().result;
            result.realised.add(Axis::Robot, vec![0.5], values);
            let problem = result.problem().expect("a problem");
            assert!(problem.contains("`realised` of axis `robot`"), "{problem}");
        }
        let long = || "x".repeat(MAX_TEXT_BYTES + 1);
        type AlterOrigin<'a> = &'a dyn Fn(&mut Provenance);
        let origins: [(AlterOrigin<'_>, &str); 9] = [
            (&|of| of.host = long(), "`host`"),
            (&|of| of.pin.renderer.clear(), "`renderer` is empty"),
            (&|of| of.policy_name.clear(), "`policy_name` is empty"),
            (&|of| of.policy_checkpoint = long(), "`policy_checkpoint`"),
            (&|of| of.program_version = long(), "`program_version`"),
            (&|of| drop(of.policy_settings.insert(long(), String::new())), "`policy_settings`"),
            (
                &|of| {
                    of.policy_settings
                        .extend((0..=MAX_SETTINGS).map(|n| (n.to_string(), String::new())))
                },
                "`policy_settings` has 69 entries",
            ),
            (&|of| of.realisation.push('x'), "`realisation`"),
            (&|of| of.fingerprint.truncate(16), "`fingerprint`"),
        ];
        for (alter, words) in origins {
            let mut provenance = measured().provenance;
            alter(&mut provenance);
            let problem = provenance.problem().expect(words);
            assert!(problem.contains(words), "{problem} lacks {words}");
        }
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
