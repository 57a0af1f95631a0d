//! Writes a rollout's trace as a NumPy archive. With n control steps of the policy and a goal of g
//! predicates, `trace.npz` holds:
//!
//! | array | shape | content |
//! | --- | --- | --- |
//! | `actions` | n × 7 | as the policy sent them; no motion where the arm holds still |
//! | `executed` | n × 7 | input of the actuation axis: clipped to -1..1; unclipped in `reference` |
//! | `eef_pos` | n+1 × 3 | site between the fingertips, world frame, m |
//! | `eef_quat_xyzw` | n+1 × 4 | hand body, world frame |
//! | `joint_pos` | n+1 × 7 | arm, rad |
//! | `gripper_pos` | n+1 × 2 | fingers, m |
//! | `qpos` | n+1 × nq | all position coordinates of the model, m and rad |
//! | `goal_truths` | n+1 × g | truth of each predicate of the goal |
//! | `success` | n+1 | true if all predicates hold |
//!
//! Row 0 of the arrays with n+1 rows is the scene at rest before the first action, row k the scene
//! after action k. Readings of the robot lag behind the scene as in the policy's observations: the
//! hand's pose by 4 ms, joints and fingers by 2 ms. `qpos` does not lag.

use std::fs::File;
use std::io::{self, BufWriter, Seek, Write};
use std::path::Path;

use proto::checks::ACTION_WIDTH;
use sim::Environment;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::npy;
use crate::rollout::Step;

/// Trace under construction: arrays that grow by a row per step.
#[derive(Default)]
pub(super) struct Trace {
    actions: Vec<f64>,
    executed: Vec<f64>,
    eef_pos: Vec<f64>,
    eef_quat_xyzw: Vec<f64>,
    joint_pos: Vec<f64>,
    gripper_pos: Vec<f64>,
    qpos: Vec<f64>,
    goal_truths: Vec<bool>,
    success: Vec<bool>,
}

impl Trace {
    /// Returns true if no scene was added.
    pub(super) fn is_empty(&self) -> bool {
        self.success.is_empty()
    }

    /// Adds a scene, and the step that led to it; no step led to the first scene.
    pub(super) fn add(&mut self, step: Option<&Step>, environment: &mut Environment) {
        if let Some(step) = step {
            self.actions.extend(step.sent);
            self.executed.extend(step.executed);
        }
        let robot = environment.robot_state();
        self.eef_pos.extend(robot.eef_pos);
        self.eef_quat_xyzw.extend(robot.eef_quat_xyzw);
        self.joint_pos.extend(robot.joint_pos);
        self.gripper_pos.extend(robot.gripper_pos);
        let qpos = environment.data().qpos(environment.model());
        self.qpos.extend_from_slice(qpos);
        self.goal_truths.extend(environment.goal_truths());
        self.success.push(environment.succeeded());
    }

    pub(super) fn write(&self, path: &Path) -> io::Result<()> {
        let mut npz = ZipWriter::new(BufWriter::new(File::create(path)?));
        let scenes = self.success.len();
        let steps = self.actions.len() / ACTION_WIDTH;
        for (name, rows, values) in [
            ("actions", steps, &self.actions),
            ("executed", steps, &self.executed),
            ("eef_pos", scenes, &self.eef_pos),
            ("eef_quat_xyzw", scenes, &self.eef_quat_xyzw),
            ("joint_pos", scenes, &self.joint_pos),
            ("gripper_pos", scenes, &self.gripper_pos),
            ("qpos", scenes, &self.qpos),
        ] {
            // An empty array still needs its width; only the arrays of actions can be empty.
            let width = values.len().checked_div(rows).unwrap_or(ACTION_WIDTH);
            let encoded: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
            write_array(&mut npz, name, "<f8", &[rows, width], &encoded)?;
        }
        let width = self.goal_truths.len() / scenes.max(1);
        let truths =
            |values: &[bool]| values.iter().map(|value| u8::from(*value)).collect::<Vec<_>>();
        let goal_truths = truths(&self.goal_truths);
        write_array(&mut npz, "goal_truths", "|b1", &[scenes, width], &goal_truths)?;
        write_array(&mut npz, "success", "|b1", &[scenes], &truths(&self.success))?;
        npz.finish()?.flush()
    }
}

fn write_array<W: Write + Seek>(
    npz: &mut ZipWriter<W>,
    name: &str,
    descr: &str,
    shape: &[usize],
    encoded: &[u8],
) -> io::Result<()> {
    npz.start_file(format!("{name}.npy"), SimpleFileOptions::default())?;
    npy::write(npz, descr, shape, encoded)
}
