//! Reset without an initial state, like robosuite's `reset`: LIBERO's samplers place all objects
//! and fixtures.

use benchmark::numpy::LegacyRng;
use scene::SceneError;
use scene::placement::{PoseTarget, Samplers};

use crate::controller::ARM_JOINTS;
use crate::error::SimError;
use crate::mujoco::{Data, Model, ObjectKind};

/// Finger positions at a reset, m (`PandaGripper.init_qpos`).
const RESET_FINGERS: [f64; 2] = [0.020833, -0.020833];

/// Starting point of a reset: robosuite's `hard_reset`, whose two modes lead to different scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reset {
    /// Starts from the compiled model: fixtures at their poses in the MJCF until they are placed,
    /// nothing perturbed, the gripper's ramp at its middle.
    Hard,
    /// Starts from the current model: objects on sites of fixtures are placed relative to the
    /// fixtures' last poses, and the gripper's ramp keeps its position.
    Soft,
}

/// The samplers, resolved to indices in MuJoCo's arrays.
pub(crate) struct Resets {
    /// For each joint sampler: indices in qpos of the first positions of the sampler's joints.
    joints: Vec<Vec<usize>>,
    targets: Vec<Target>,
    sites: Vec<usize>,
    /// Poses of the fixtures in the compiled model: body, position, orientation.
    compiled_fixtures: Vec<(usize, [f64; 3], [f64; 4])>,
}

enum Target {
    /// Index in qpos of a free joint's first position.
    FreeJoint(usize),
    Body(usize),
}

impl Resets {
    pub(crate) fn resolve(samplers: &Samplers, model: &Model) -> Result<Self, SimError> {
        let address = |joint: &String| {
            let id = model.id(ObjectKind::Joint, joint)?;
            Ok::<_, SimError>(model.jnt_qposadr()[id] as usize)
        };
        let joints = samplers
            .joints()
            .iter()
            .map(|sampler| sampler.joints.iter().map(address).collect())
            .collect::<Result<_, _>>()?;
        let mut targets = Vec::new();
        let mut compiled_fixtures = Vec::new();
        for sampler in samplers.poses() {
            targets.push(match &sampler.target {
                PoseTarget::FreeJoint(joint) => Target::FreeJoint(address(joint)?),
                PoseTarget::Body(body) => {
                    let body = model.id(ObjectKind::Body, body)?;
                    compiled_fixtures.push((
                        body,
                        std::array::from_fn(|axis| model.body_pos()[body * 3 + axis]),
                        std::array::from_fn(|index| model.body_quat()[body * 4 + index]),
                    ));
                    Target::Body(body)
                }
            });
        }
        let sites = samplers
            .sites()
            .iter()
            .map(|site| model.id(ObjectKind::Site, site))
            .collect::<Result<_, _>>()?;
        Ok(Self { joints, targets, sites, compiled_fixtures })
    }

    pub(crate) fn restore_fixtures(&self, model: &mut Model) {
        for (body, pos, quat) in &self.compiled_fixtures {
            model.body_pos_mut()[body * 3..][..3].copy_from_slice(pos);
            model.body_quat_mut()[body * 4..][..4].copy_from_slice(quat);
        }
    }

    /// One attempt, starting from the fixtures' current poses.
    pub(crate) fn place(
        &self,
        samplers: &Samplers,
        model: &mut Model,
        data: &mut Data,
        rng: &mut LegacyRng,
        joint_sampler_rounds: u32,
        arm: &[f64; ARM_JOINTS],
    ) -> Result<(), SceneError> {
        data.reset(model);
        Samplers::skip_arm_noise(rng);
        let qpos = data.qpos_mut(model);
        qpos[..ARM_JOINTS].copy_from_slice(arm);
        qpos[ARM_JOINTS..][..2].copy_from_slice(&RESET_FINGERS);
        for _ in 0..joint_sampler_rounds {
            for (sampler, addresses) in samplers.joints().iter().zip(&self.joints) {
                let position = sampler.sample(rng);
                for address in addresses {
                    qpos[*address] = position;
                }
            }
        }
        data.kinematics(model);
        let site_position =
            |site: &usize| std::array::from_fn(|axis| data.site_xpos(model)[site * 3 + axis]);
        let sites: Vec<[f64; 3]> = self.sites.iter().map(site_position).collect();
        let poses = samplers.sample_poses(rng, &sites)?;
        for (target, pose) in self.targets.iter().zip(poses) {
            match *target {
                Target::FreeJoint(address) => {
                    let qpos = &mut data.qpos_mut(model)[address..];
                    qpos[..3].copy_from_slice(&pose.pos);
                    qpos[3..7].copy_from_slice(&pose.quat);
                }
                Target::Body(body) => {
                    model.body_pos_mut()[body * 3..][..3].copy_from_slice(&pose.pos);
                    model.body_quat_mut()[body * 4..][..4].copy_from_slice(&pose.quat);
                }
            }
        }
        Ok(())
    }
}
