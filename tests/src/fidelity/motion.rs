//! Comparison of motion with the original's: settling, smooth steps, contact-rich
//! steps, and predicates on recorded states.

use std::collections::BTreeMap;

use anyhow::{Context, Result, ensure};
use sim::Environment;
use sim::episode::NO_OP;

use super::findings::{ContactFindings, Findings, Worst};
use super::frames::Comparison;
use super::reference::{Array, ReferenceTask, read_npz};

const SETTLING_STEPS: usize = 10;
/// Largest deviation of the original under tiny torque noise at which it counts as insensitive, m
/// or rad.
const INSENSITIVE: f64 = 1e-11;

type Arrays = BTreeMap<String, Array>;

/// Loads each recorded initial state, settles, and replays its smooth motion.
pub(super) fn compare_smooth(
    task: &ReferenceTask,
    environment: &mut Environment,
    findings: &mut Findings,
    frames: &mut Comparison<'_>,
) -> Result<()> {
    let start = task.arrays("init_dummy10.npz")?;
    for init in 0..array(&start, "state")?.len() {
        environment.load(array(&start, "state")?.row(init));
        let mut compare_state =
            |environment: &Environment, qpos: &str, success: &str| -> Result<()> {
                let place = || format!("state {init}, {qpos}");
                compare_positions(
                    &mut findings.settled,
                    environment,
                    array(&start, qpos)?.row(init),
                    place,
                );
                let expected = array(&start, success)?.values[init] != 0.0;
                findings.success_flags += usize::from(environment.succeeded() != expected);
                Ok(())
            };
        compare_state(environment, "qpos0", "success0")?;
        for _ in 0..SETTLING_STEPS {
            environment.step(&NO_OP)?;
        }
        compare_state(environment, "qpos10", "success10")?;
        frames.compare(environment, init, 0)?;
        let recorded = format!("traj_{init}.npz");
        if task.path(&recorded).is_file() {
            compare_trajectory(&task.arrays(&recorded)?, init, environment, findings, frames)?;
        }
    }
    Ok(())
}

fn compare_trajectory(
    recorded: &Arrays,
    init: usize,
    environment: &mut Environment,
    findings: &mut Findings,
    frames: &mut Comparison<'_>,
) -> Result<()> {
    let (actions, qpos) = (array(recorded, "actions")?, array(recorded, "qpos")?);
    let success = array(recorded, "success")?;
    compare_observation(recorded, 0, init, environment, &mut findings.observed)?;
    for step in 1..=actions.len() {
        let succeeded = environment.step(&action(actions.row(step - 1))?)?;
        let place = || format!("state {init}, step {step}");
        compare_positions(&mut findings.smooth, environment, qpos.row(step), place);
        findings.success_flags += usize::from(succeeded != (success.values[step] != 0.0));
        compare_observation(recorded, step, init, environment, &mut findings.observed)?;
        if step == actions.len() {
            frames.compare(environment, init, step)?;
        }
    }
    Ok(())
}

fn compare_observation(
    recorded: &Arrays,
    step: usize,
    init: usize,
    environment: &mut Environment,
    worst: &mut Worst,
) -> Result<()> {
    let robot = environment.robot_state();
    let readings: [(&str, Vec<f64>); 6] = [
        ("obs_eef_pos", robot.eef_pos.to_vec()),
        ("obs_eef_quat", robot.eef_quat_xyzw.to_vec()),
        ("obs_gripper_qpos", robot.gripper_pos.to_vec()),
        ("obs_joint_pos_cos", robot.joint_pos.map(f64::cos).to_vec()),
        ("obs_joint_pos_sin", robot.joint_pos.map(f64::sin).to_vec()),
        ("obs_joint_vel", robot.joint_vel.to_vec()),
    ];
    for (name, ours) in readings {
        let expected = array(recorded, name)?.row(step);
        let place = || format!("state {init}, step {step}, {name}");
        worst.add(largest_difference(&ours, expected), place);
    }
    Ok(())
}

/// Sets every recorded state and compares the truth of each predicate.
pub(super) fn compare_predicates(
    task: &ReferenceTask,
    environment: &mut Environment,
    findings: &mut Findings,
) -> Result<()> {
    if !task.path("predicates.npz").is_file() {
        return Ok(());
    }
    let recorded = task.arrays("predicates.npz")?;
    let (qpos, truth) = (array(&recorded, "qpos")?, array(&recorded, "truth")?);
    let at_rest = vec![0.0; environment.model().nv()];
    for state in 0..qpos.len() {
        environment.load(&[&[0.0], qpos.row(state), &at_rest].concat());
        for (ours, theirs) in environment.goal_truths().iter().zip(truth.row(state)) {
            findings.predicates.0 += usize::from(*ours != (*theirs != 0.0));
            findings.predicates.1 += 1;
        }
    }
    Ok(())
}

pub(super) fn compare_contact(
    task: &ReferenceTask,
    environment: &mut Environment,
) -> Result<Option<ContactFindings>> {
    let Some(path) = task.contact_path() else {
        return Ok(None);
    };
    let recorded = read_npz(&path)?;
    let (actions, qpos) = (array(&recorded, "actions")?, array(&recorded, "qpos")?);
    let success = array(&recorded, "success")?;
    environment.load(&array(&recorded, "state")?.values);
    for _ in 0..SETTLING_STEPS {
        environment.step(&NO_OP)?;
    }
    let mut differences = Vec::new();
    let mut success_flags = 0;
    for step in 0..=actions.len() {
        let succeeded = match step {
            0 => environment.succeeded(),
            _ => environment.step(&action(actions.row(step - 1))?)?,
        };
        let ours = environment.data().qpos(environment.model());
        differences.push(largest_difference(ours, qpos.row(step)));
        success_flags += usize::from(succeeded != (success.values[step] != 0.0));
    }
    Ok(Some(ContactFindings {
        success_flags,
        ..judge_contact(&differences, task.contact_sensitivity()?.as_deref())
    }))
}

/// Compares, at each step, how far joint positions are from the original's with the original's own
/// sensitivity, its deviation under tiny torque noise. Without a measured sensitivity, the effect
/// of rounding alone is unknown, so that differences are reported but not judged.
fn judge_contact(differences: &[f64], sampled: Option<&[f64]>) -> ContactFindings {
    let mut findings = ContactFindings::default();
    let mut is_insensitive = sampled.is_some();
    for (step, &difference) in differences.iter().enumerate() {
        findings.worst = larger(findings.worst, difference);
        let Some(sensitivity) = sampled.and_then(|sampled| sensitivity_at(sampled, step)) else {
            // The measurement of the sensitivity is shorter than the recording.
            is_insensitive = false;
            continue;
        };
        is_insensitive &= sensitivity <= INSENSITIVE;
        if is_insensitive {
            findings.worst_while_insensitive = larger(findings.worst_while_insensitive, difference);
        } else {
            let multiple = difference / sensitivity;
            findings.sensitivities = Some(larger(findings.sensitivities.unwrap_or(0.0), multiple));
        }
    }
    findings
}

/// Returns the original's sensitivity at a step, from samples of its running maximum at every
/// 20th step; between two samples, the later one applies.
fn sensitivity_at(sampled: &[f64], step: usize) -> Option<f64> {
    const SAMPLE_INTERVAL: usize = 20;
    sampled.get(step.div_ceil(SAMPLE_INTERVAL).saturating_sub(1)).copied()
}

fn compare_positions(
    worst: &mut Worst,
    environment: &Environment,
    expected: &[f64],
    place: impl FnOnce() -> String,
) {
    let ours = environment.data().qpos(environment.model());
    worst.add(largest_difference(ours, expected), place);
}

fn largest_difference(ours: &[f64], theirs: &[f64]) -> f64 {
    if ours.len() != theirs.len() {
        return f64::NAN;
    }
    let differences = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs());
    differences.fold(0.0, larger)
}

/// Returns the larger of two numbers; NaN counts as the largest.
fn larger(worst: f64, value: f64) -> f64 {
    if value <= worst || worst.is_nan() { worst } else { value }
}

fn action(values: &[f64]) -> Result<[f64; 7]> {
    ensure!(values.len() == 7, "an action has 7 numbers, not {}", values.len());
    Ok(values.try_into()?)
}

fn array<'a>(arrays: &'a Arrays, name: &str) -> Result<&'a Array> {
    arrays.get(name).with_context(|| format!("the reference has no array `{name}`"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fidelity::{Limits, RendererRelation};

    fn violations(differences: &[f64], sampled: Option<&[f64]>) -> Vec<String> {
        let findings =
            Findings { contact: Some(judge_contact(differences, sampled)), ..Findings::default() };
        findings.violations(&Limits::new(RendererRelation::AnotherRenderer))
    }

    #[test]
    fn without_a_measured_sensitivity_only_success_flags_are_judged() {
        let differences = [0.0, 1e-6, 0.06];
        assert_eq!(violations(&differences, None), [""; 0]);
        assert_eq!(judge_contact(&differences, None).worst, 0.06);
    }

    #[test]
    fn a_measured_sensitivity_bounds_the_differences() {
        // Insensitive in the first 20 steps only.
        let sampled = [1e-13, 1e-5];
        let mut differences = vec![1e-12; 41];
        differences[30] = 9e-4;
        assert_eq!(violations(&differences, Some(&sampled)), [""; 0]);
        differences[30] = 2e-3;
        let found = violations(&differences, Some(&sampled));
        assert!(found[0].contains("200 × the original's"), "{found:?}");
        differences[30] = 0.0;
        differences[10] = 1e-8;
        let found = violations(&differences, Some(&sampled));
        assert_eq!(found, ["contact-rich steps: 1.000e-8"]);
        differences[10] = f64::NAN;
        assert_eq!(violations(&differences, Some(&sampled)).len(), 1);
    }
}
