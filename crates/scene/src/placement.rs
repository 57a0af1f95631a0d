//! Placement at a reset, as by LIBERO's samplers: joints that start open, closed, on or off, then
//! fixtures and objects. Random draws reproduce NumPy's legacy generator exactly, including
//! rejections, order and arithmetic, and including LIBERO's defects: orientations are written in
//! another order than they are read ([`crate::rotation`]), and an object on a site of a carrier
//! (another object or a fixture) is offset from the carrier's new position by the site's *world*
//! position before the carrier was moved, as if that were the position in the carrier's frame.

mod plan;

use benchmark::numpy::LegacyRng;

use crate::error::SceneError;
use crate::object::Footprint;
use crate::rotation::{Rotation, single_precision_matrix};

#[derive(Debug, Clone, PartialEq)]
pub struct FixturePose {
    pub root_body: String,
    /// Position, world frame, m.
    pub pos: [f64; 3],
    /// Orientation, world frame, w x y z.
    pub quat: [f64; 4],
}

/// Number of attempts at placing one object, after which LIBERO draws the whole placement again.
const MAX_ATTEMPTS: usize = 5000;
/// LIBERO's wrapper never gives up; a scene with enough room needs one or two draws.
pub const MAX_DRAWS: usize = 1000;
const ARM_JOINTS: usize = 7;
/// LIBERO has appended all joint samplers twice by then: at construction and in the reset.
const CAMPAIGN_JOINT_ROUNDS: usize = 2;

/// Samplers of everything that a reset of a task draws at random, in the order of the draws.
#[derive(Debug, Clone)]
pub struct Samplers {
    joints: Vec<JointSampler>,
    poses: Vec<PoseSampler>,
    sites: Vec<String>,
}

/// Samples one position for the joints of an instance that starts open, closed, on or off.
#[derive(Debug, Clone)]
pub struct JointSampler {
    pub joints: Vec<String>,
    /// Range of the position, m or rad.
    range: [f64; 2],
}

#[derive(Debug, Clone)]
pub struct PoseSampler {
    instance: String,
    place: String,
    base: Base,
    /// Rectangles relative to the base, m, by their bounds in x and y.
    ranges: Vec<[[f64; 2]; 2]>,
    /// Height of the underside above the base, m.
    z_offset: f64,
    footprint: Footprint,
    avoids_others: bool,
    rotation: Rotation,
    pub target: PoseTarget,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PoseTarget {
    FreeJoint(String),
    Body(String),
}

/// Other instances are indices of earlier pose samplers.
#[derive(Debug, Clone)]
enum Base {
    /// A point in the world, m.
    Point([f64; 3]),
    /// The top of another object.
    Top(usize),
    /// A site of another object or fixture, the carrier, added to the carrier's top or origin.
    Site { carrier: usize, is_relative_to_top: bool, site: usize },
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Position, world frame, m.
    pub pos: [f64; 3],
    /// Orientation, w x y z as MuJoCo reads it; normalised only to single precision.
    pub quat: [f64; 4],
}

impl Samplers {
    /// One round of samplers; LIBERO appends a round whenever it loads its model.
    pub fn joints(&self) -> &[JointSampler] {
        &self.joints
    }

    pub fn poses(&self) -> &[PoseSampler] {
        &self.poses
    }

    pub fn sites(&self) -> &[String] {
        &self.sites
    }

    /// Robosuite's noise on the arm's joints, drawn first, which LIBERO scales by zero.
    pub fn skip_arm_noise(rng: &mut LegacyRng) {
        for _ in 0..ARM_JOINTS {
            rng.randn();
        }
    }

    /// Draws in the order of [`poses`](Self::poses). `site_positions` of [`sites`](Self::sites) are
    /// in the world frame, m, after the joints were set and before anything was placed.
    pub fn sample_poses(
        &self,
        rng: &mut LegacyRng,
        site_positions: &[[f64; 3]],
    ) -> Result<Vec<Pose>, SceneError> {
        let mut poses: Vec<Pose> = Vec::with_capacity(self.poses.len());
        for sampler in &self.poses {
            let (origin, site) = match sampler.base {
                Base::Point(origin) => (origin, [0.0; 3]),
                Base::Top(carrier) => (self.top(carrier, &poses), [0.0; 3]),
                Base::Site { carrier, is_relative_to_top, site } => {
                    let origin = if is_relative_to_top {
                        self.top(carrier, &poses)
                    } else {
                        poses[carrier].pos
                    };
                    (origin, rotate(poses[carrier].quat, site_positions[site]))
                }
            };
            poses.push(sampler.sample(rng, origin, site, &poses, &self.poses)?);
        }
        Ok(poses)
    }

    /// The released initial states do not contain the fixtures' poses, so a reset is reproduced.
    pub(crate) fn campaign_fixtures(&self, env_seed: u32) -> Result<Vec<FixturePose>, SceneError> {
        let mut rng = LegacyRng::seed(env_seed);
        let mut rounds = CAMPAIGN_JOINT_ROUNDS;
        for _ in 1..MAX_DRAWS {
            if let Ok(fixtures) = self.draw_fixtures(&mut rng, rounds) {
                return Ok(fixtures);
            }
            // LIBERO reloads its model before each new attempt.
            rounds += 1;
        }
        self.draw_fixtures(&mut rng, rounds)
    }

    fn draw_fixtures(
        &self,
        rng: &mut LegacyRng,
        joint_rounds: usize,
    ) -> Result<Vec<FixturePose>, SceneError> {
        Self::skip_arm_noise(rng);
        for sampler in std::iter::repeat_n(&self.joints, joint_rounds).flatten() {
            sampler.sample(rng);
        }
        // Instances that stand on other instances are sampled after all fixtures.
        let mut poses = Vec::new();
        let mut fixtures = Vec::new();
        for sampler in &self.poses {
            let Base::Point(origin) = sampler.base else {
                break;
            };
            let pose = sampler.sample(rng, origin, [0.0; 3], &poses, &self.poses)?;
            poses.push(pose);
            if let PoseTarget::Body(root_body) = &sampler.target {
                fixtures.push(FixturePose {
                    root_body: root_body.clone(),
                    pos: pose.pos,
                    quat: pose.quat,
                });
            }
        }
        Ok(fixtures)
    }

    fn top(&self, carrier: usize, poses: &[Pose]) -> [f64; 3] {
        let [x, y, z] = poses[carrier].pos;
        [x, y, z + self.poses[carrier].footprint.top]
    }
}

impl JointSampler {
    /// Samples a position, m or rad.
    pub fn sample(&self, rng: &mut LegacyRng) -> f64 {
        rng.uniform(self.range[0], self.range[1])
    }
}

impl PoseSampler {
    /// Samples around `origin` + `site`; `placed` are the poses of the first of `samplers`.
    fn sample(
        &self,
        rng: &mut LegacyRng,
        origin: [f64; 3],
        site: [f64; 3],
        placed: &[Pose],
        samplers: &[Self],
    ) -> Result<Pose, SceneError> {
        let attempts = if self.ranges.is_empty() { 0 } else { MAX_ATTEMPTS };
        for _ in 0..attempts {
            let range = &self.ranges[rng.randint(self.ranges.len() as u32) as usize];
            // A radius above half of the range reverses the shortened bounds; LIBERO still draws.
            let [x, y] = range.map(|[low, high]| rng.uniform(low, high));
            let pos = [
                x + origin[0] + site[0],
                y + origin[1] + site[1],
                self.z_offset + origin[2] + site[2] - self.footprint.bottom,
            ];
            let mut obstacles = placed.iter().zip(samplers);
            if !self.avoids_others
                || obstacles.all(|(pose, sampler)| self.is_clear(pos, pose.pos, sampler.footprint))
            {
                let quat = self.rotation.sample(rng);
                return Ok(Pose { pos, quat });
            }
        }
        Err(SceneError::NoRoom {
            object: self.instance.clone(),
            region: self.place.clone(),
            attempts,
        })
    }

    fn is_clear(&self, pos: [f64; 3], obstacle_pos: [f64; 3], obstacle: Footprint) -> bool {
        let distance = (pos[0] - obstacle_pos[0]).hypot(pos[1] - obstacle_pos[1]);
        let is_beside = distance > obstacle.radius + self.footprint.radius;
        let is_above = pos[2] - obstacle_pos[2] > obstacle.top - self.footprint.bottom;
        is_beside || is_above
    }
}

fn rotate(quat: [f64; 4], [x, y, z]: [f64; 3]) -> [f64; 3] {
    single_precision_matrix(quat).map(|row| row[0] * x + row[1] * y + row[2] * z)
}
