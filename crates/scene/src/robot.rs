//! The Panda arm with its gripper, on a pedestal or on the ground: robosuite 1.4.0's models, joined
//! and named as in robosuite.

use crate::arena::RobotStand;
use crate::element::{Element, numbers, parse_numbers};
use crate::error::SceneError;
use crate::part::{Part, add_prefix, is_collision_geom, recolor_collision_geoms};
use crate::sources::AssetRoot;

/// Properties that robosuite and LIBERO set on the arm's joints: friction loss, N·m, and damping,
/// N·m·s (`RobotModel.__init__`, `MountedPanda.__init__`).
const FRICTION_LOSS: f64 = 0.1;
const DAMPING: [f64; 7] = [0.1, 0.1, 0.1, 0.1, 0.1, 0.01, 0.01];
/// Armature of joint i times (i + 1), kg·m²: joint i has the armature `ARMATURE / (i + 1)`.
const ARMATURE: f64 = 5.0;

/// Colours of collision geoms, visible only where collision geoms are drawn.
const ROBOT_COLLISION_RGBA: &str = "0 0.5 0 1";
const MOUNT_COLLISION_RGBA: &str = "0.5 0.5 0 1";
const GRIPPER_COLLISION_RGBA: &str = "0 0 0.5 1";

/// Height of the pedestal's top above the pedestal's origin, m.
const PEDESTAL_TOP: f64 = -0.01;

pub(crate) fn load(robosuite: &AssetRoot, stand: RobotStand) -> Result<Part, SceneError> {
    let load_part = |file: &str, prefix: &str, rgba: &str| -> Result<Part, SceneError> {
        let mut part = Part::load(robosuite, file, "robot model")?;
        name_geoms(&mut part.root);
        add_prefix(&mut part.root, prefix);
        recolor_collision_geoms(part.worldbody_mut(), rgba, None);
        Ok(part)
    };
    let mut robot = load_part("robots/panda/robot.xml", "robot0_", ROBOT_COLLISION_RGBA)?;
    set_joint_properties(&mut robot);

    let (mount_file, mount_top, foot) = match stand {
        RobotStand::Pedestal(foot) => ("mounts/rethink_mount.xml", PEDESTAL_TOP, foot),
        RobotStand::Ground(foot) => ("mounts/null_mount.xml", 0.0, foot),
    };
    let mut mount = load_part(mount_file, "mount0_", MOUNT_COLLISION_RGBA)?;
    let inconsistent = SceneError::Inconsistent;
    let mount_bottom = root_height(&mount).map_err(inconsistent)?;
    let body = root_body(&mut mount).map_err(inconsistent)?;
    body.set("pos", numbers(&[0.0, 0.0, 0.0 - mount_top]));
    robot.merge(&mount, Some("robot0_base")).map_err(inconsistent)?;

    let gripper = load_part("grippers/panda_gripper.xml", "gripper0_", GRIPPER_COLLISION_RGBA)?;
    robot.merge(&gripper, Some("robot0_right_hand")).map_err(inconsistent)?;

    let base = [foot[0], foot[1], foot[2] - (mount_bottom - mount_top)];
    root_body(&mut robot).map_err(inconsistent)?.set("pos", numbers(&base));
    Ok(robot)
}

/// Names unnamed geoms `g0_vis`, `g0_col`, … in document order.
fn name_geoms(root: &mut Element) {
    let (mut collision, mut visual) = (0, 0);
    root.for_each_mut(&mut |element| {
        if element.tag != "geom" || element.name().is_some() {
            return;
        }
        let (count, kind) =
            if is_collision_geom(element) { (&mut collision, "col") } else { (&mut visual, "vis") };
        element.set("name", format!("g{count}_{kind}"));
        *count += 1;
    });
}

fn set_joint_properties(robot: &mut Part) {
    let mut index = 0;
    robot.worldbody_mut().for_each_mut(&mut |element| {
        if element.tag == "joint" && index < DAMPING.len() {
            element.set_default("frictionloss", &FRICTION_LOSS.to_string());
            element.set_default("armature", &(ARMATURE / (index + 1) as f64).to_string());
            element.set("damping", DAMPING[index].to_string());
            index += 1;
        }
    });
}

fn root_body(part: &mut Part) -> Result<&mut Element, String> {
    part.worldbody_mut().children.first_mut().ok_or_else(|| "a model has no body".to_owned())
}

fn root_height(part: &Part) -> Result<f64, String> {
    let pos = part.worldbody()?.children.first().and_then(|body| body.get("pos"));
    match parse_numbers(pos.unwrap_or("0 0 0")).as_deref() {
        Some([_, _, z]) => Ok(*z),
        _ => Err("a model's root body has no valid position".to_owned()),
    }
}
