//! A reset without an initial state, as robosuite's `reset`: everything is
//! placed by LIBERO's samplers.

use protocol::numpy::LegacyRng;
use scene::placement::{MAX_DRAWS, PoseTarget, Samplers};
use scene::{Scene, SceneError};

use crate::compiled_scene::hide_marker_sites;
use crate::controller::{ARM_JOINTS, RESET_JOINTS, SUBSTEPS};
use crate::environment::Environment;
use crate::error::SimError;
use crate::mujoco::{self, Model, ObjectKind};

/// Where the fingers are at a reset, m (`PandaGripper.init_qpos`).
const RESET_FINGERS: [f64; 2] = [0.020833, -0.020833];

/// What a reset starts from: robosuite's `hard_reset`, whose other sense shows
/// in the scenes that come out of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reset {
    /// The model as compiled, as if it were loaded anew: fixtures where its file
    /// has them until they are placed, nothing perturbed, the gripper's ramp at
    /// its middle.
    Hard,
    /// The model as it is now: fixtures where they were last, which is what
    /// objects on their sites are placed by, and the gripper's ramp where it was.
    Soft,
}

/// The samplers' names as places in MuJoCo's arrays.
pub(crate) struct Resets {
    /// Of each joint sampler, first position coordinates.
    joints: Vec<Vec<usize>>,
    targets: Vec<Target>,
    sites: Vec<usize>,
    /// The fixtures as compiled: body, position, orientation.
    compiled: Vec<(usize, [f64; 3], [f64; 4])>,
}

enum Target {
    /// First position coordinate of a free joint.
    FreeJoint(usize),
    Body(usize),
}

impl Resets {
    /// Resolves the samplers of a scene whose model is as it was compiled.
    pub(crate) fn resolve(scene: &Scene, compiled: &Model) -> Result<Self, SimError> {
        let model = compiled;
        let address = |joint: &String| {
            let id = model.id(ObjectKind::Joint, joint)?;
            Ok::<_, SimError>(model.jnt_qposadr()[id] as usize)
        };
        let samplers = &scene.samplers;
        let joints = samplers
            .joints()
            .iter()
            .map(|sampler| sampler.joints.iter().map(address).collect())
            .collect::<Result<_, _>>()?;
        let mut targets = Vec::new();
        let mut compiled = Vec::new();
        for sampler in samplers.poses() {
            targets.push(match &sampler.target {
                PoseTarget::FreeJoint(joint) => Target::FreeJoint(address(joint)?),
                PoseTarget::Body(body) => {
                    let body = model.id(ObjectKind::Body, body)?;
                    compiled.push((
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
        Ok(Self {
            joints,
            targets,
            sites,
            compiled,
        })
    }
}

impl Environment {
    /// Starts over without an initial state: draws where everything is from
    /// NumPy's legacy generator, in the original's order, the arm at home, fresh
    /// controllers, time 0; then observes.
    ///
    /// `joint_sampler_rounds` is how often the original has loaded its model by
    /// then: 1 at construction, one more with each hard reset. Its list of
    /// samplers of what starts open, closed, on or off grows by that.
    ///
    /// Where a thing finds no room, everything is drawn again, as the original's
    /// wrapper does, which counts as another hard reset if this is one. Returns
    /// the rounds that it came to: what the next reset's count goes on from.
    ///
    /// # Errors
    /// [`SceneError::NoRoom`] if that fails a thousand times.
    pub fn reset(
        &mut self,
        rng: &mut LegacyRng,
        reset: Reset,
        joint_sampler_rounds: u32,
    ) -> Result<u32, SimError> {
        let mut rounds = joint_sampler_rounds;
        let mut attempts = 1;
        while let Err(error) = self.place(rng, reset, rounds) {
            if attempts == MAX_DRAWS {
                return Err(error.into());
            }
            attempts += 1;
            rounds += u32::from(reset == Reset::Hard);
        }
        self.data.forward(&self.model);
        match reset {
            Reset::Hard => self.controller.reset(),
            Reset::Soft => self.controller.reset_arm(),
        }
        self.control_steps = 0;
        // A burner that is on glows from the first step on, not before.
        hide_marker_sites(&self.compiled.scene, &mut self.model);
        for burner in &mut self.burners {
            burner.opacity = self.model.site_rgba()[burner.site * 4 + 3];
        }
        self.observed_substep = SUBSTEPS;
        self.observe_now();
        // Earlier warnings belong to another rollout.
        mujoco::take_warnings();
        Ok(rounds)
    }

    /// One attempt at placing everything.
    fn place(
        &mut self,
        rng: &mut LegacyRng,
        reset: Reset,
        joint_sampler_rounds: u32,
    ) -> Result<(), SceneError> {
        let Self {
            compiled,
            model,
            data,
            ..
        } = self;
        let (scene, resets) = (&compiled.scene, &compiled.resets);
        if reset == Reset::Hard {
            model.copy_own(&compiled.model);
            for (body, pos, quat) in &resets.compiled {
                model.body_pos_mut()[body * 3..][..3].copy_from_slice(pos);
                model.body_quat_mut()[body * 4..][..4].copy_from_slice(quat);
            }
        }
        data.reset(model);
        Samplers::skip_arm_noise(rng);
        let qpos = data.qpos_mut(model);
        qpos[..ARM_JOINTS].copy_from_slice(&RESET_JOINTS);
        qpos[ARM_JOINTS..][..2].copy_from_slice(&RESET_FINGERS);
        for _ in 0..joint_sampler_rounds {
            for (sampler, addresses) in scene.samplers.joints().iter().zip(&resets.joints) {
                let position = sampler.sample(rng);
                for address in addresses {
                    qpos[*address] = position;
                }
            }
        }
        data.kinematics(model);
        let site_position =
            |site: &usize| std::array::from_fn(|axis| data.site_xpos(model)[site * 3 + axis]);
        let sites: Vec<[f64; 3]> = resets.sites.iter().map(site_position).collect();
        let poses = scene.samplers.sample_poses(rng, &sites)?;
        for (target, pose) in resets.targets.iter().zip(poses) {
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
