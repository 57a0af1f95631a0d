//! Inverse kinematics of the arm in the reference's compiled model. Reads bodies, joints and site
//! from arrays, without MuJoCo.

use std::path::Path;

use benchmark::{Axis, TaskRef};
use nalgebra::{Quaternion, UnitQuaternion, Vector3, Vector6};
use serde_json::Value;
use sim::perturb::{ArmState, JOINTS, Jacobian, JointRange, JointVector, solve_shifted_pose};

use crate::reference::{Arrays, arrays, check_close, folder, group, integers, models, presets};

/// The chain from the world to the site between the fingertips.
struct Arm {
    links: Vec<Link>,
    ranges: [JointRange; JOINTS],
}

struct Link {
    offset: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
    /// Index of the joint, and its axis in the link's frame; `None` for a fixed link.
    hinge: Option<(usize, Vector3<f64>)>,
}

impl Arm {
    fn read(task: &Path) -> Self {
        let path = task.join("model_arrays.npz");
        let model = arrays(&path);
        let parents = integers(&path, "body_parentid");
        let hinges = integers(&path, "jnt_bodyid");
        let meta = std::fs::read_to_string(task.join("meta.json")).expect("meta.json");
        let meta: Value = serde_json::from_str(&meta).expect("JSON");
        let sites = meta["sites"].as_array().expect("sites");
        let site = sites.iter().position(|name| name == "gripper0_grip_site");
        let site = site.expect("a grip site");

        let mut links = vec![Link {
            offset: group::<3>(&model["site_pos"], site).into(),
            rotation: quaternion(&model, "site_quat", site),
            hinge: None,
        }];
        let mut body = integers(&path, "site_bodyid")[site] as usize;
        while body != 0 {
            let joint = hinges.iter().position(|&owner| owner as usize == body);
            links.push(Link {
                offset: group::<3>(&model["body_pos"], body).into(),
                rotation: quaternion(&model, "body_quat", body),
                hinge: joint.map(|joint| (joint, group::<3>(&model["jnt_axis"], joint).into())),
            });
            body = parents[body] as usize;
        }
        links.reverse();
        Self { links, ranges: std::array::from_fn(|i| group(&model["jnt_range"], i)) }
    }

    fn state_at(&self, joints: &JointVector) -> ArmState {
        let mut position = Vector3::zeros();
        let mut rotation = UnitQuaternion::identity();
        let mut pivots = Vec::new();
        for link in &self.links {
            position += rotation * link.offset;
            rotation *= link.rotation;
            if let Some((joint, axis)) = link.hinge {
                pivots.push((position, rotation * axis));
                rotation *= UnitQuaternion::from_scaled_axis(axis * joints[joint]);
            }
        }
        let columns: Vec<Vector6<f64>> = pivots
            .iter()
            .map(|(pivot, axis)| {
                let linear = axis.cross(&(position - pivot));
                Vector6::new(linear.x, linear.y, linear.z, axis.x, axis.y, axis.z)
            })
            .collect();
        ArmState {
            position,
            rotation: *rotation.to_rotation_matrix().matrix(),
            jacobian: Jacobian::from_columns(&columns),
        }
    }
}

fn quaternion(model: &Arrays, array: &str, index: usize) -> UnitQuaternion<f64> {
    let [w, x, y, z] = group(&model[array], index);
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

/// The reference holds two initial states per task.
#[test]
fn arm_postures_equal_the_reference() {
    let (Some(perturb), Some(tasks)) = (folder("perturb"), folder("tasks")) else {
        return;
    };
    let mut compared = 0;
    for (name, path) in models(&perturb) {
        let task: TaskRef = name.replace("_t", "/").parse().expect("a task");
        let stem = format!("{}/{:02}_{}", task.suite(), task.index(), task.name());
        let arm = Arm::read(&tasks.join(&stem));
        let expected = arrays(&path);
        let states = arrays(&tasks.join(&stem).join("init_dummy10.npz"));
        let state_len = states["state"].len() / 2;
        for (level, config, perturbation) in presets(Axis::Robot) {
            let init_id = usize::from(task.eval_init_ids()[usize::from(config)]);
            if init_id > 1 {
                continue;
            }
            let start = &states["state"][init_id * state_len + 1..];
            let nominal = JointVector::from_column_slice(&start[..JOINTS]);
            let shift = perturbation.robot.expect("set");
            let solution = solve_shifted_pose(|q| arm.state_at(q), &nominal, &arm.ranges, &shift);

            let case = format!("{name} {level} c{config}");
            let index = usize::from(config);
            let joints: [f64; JOINTS] = group(&expected[&format!("{level}_ik_q")], index);
            check_close(solution.joints.as_slice(), &joints, 1e-6, &case);
            let residual = expected[&format!("{level}_ik_res_mm")][index];
            check_close(&[solution.residual_mm], &[residual], 1e-3, &case);
            let residual = expected[&format!("{level}_ik_res_deg")][index];
            check_close(&[solution.residual_deg], &[residual], 1e-3, &case);
            let clamped = integers(&path, &format!("{level}_ik_clamped"))[index];
            assert_eq!(i64::from(solution.clamped_joints), clamped, "{case}");
            compared += 1;
        }
    }
    assert!(compared >= 10, "only {compared} configurations to compare");
    println!("{compared} configurations compared");
}
