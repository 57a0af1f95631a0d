//! Synthetic situations, equal in every run: a table with texture at every scale and no symmetry,
//! with a different arm pose and task in each situation.

use std::f64::consts::PI;

use benchmark::{Suite, TaskRef};
use policy_backends::openpi::frame::resize;
use proto::policy::entity::Kind;
use proto::policy::{
    CameraRequest, DescribeResponse, Entity, GoalPredicate, Image, Observation, PrivilegedState,
    StateField, StateReading,
};

use crate::doctor::pose::{self, Quaternion};

const COUNT: usize = 8;
/// Side of the frames, pixels, as in LIBERO.
const SIDE: usize = 256;
/// Index of the situation in which the colourful object fills much of the frame, as before a
/// grasp.
const CLOSE_UP: usize = 5;

/// Situation of the robot, from which observations for servers with different inputs follow.
#[derive(Clone, Debug)]
pub struct Situation {
    pub instruction: String,
    index: usize,
    hand: Hand,
    joints: [f64; 7],
    velocities: [f64; 7],
}

pub fn situations(suite: Suite) -> Vec<Situation> {
    let tasks: Vec<TaskRef> = suite.tasks().collect();
    let situation = |index: usize| {
        let mut random = Random(index as u64 + 1);
        let hand = Hand::generate(&mut random, index);
        let rest = [0.0, -0.16, 0.0, -2.44, 0.0, 2.23, PI / 4.0];
        Situation {
            instruction: tasks[index % tasks.len()].instruction(),
            index,
            hand,
            joints: rest.map(|angle| angle + 0.35 * random.number()),
            velocities: rest.map(|_| 0.2 * random.number()),
        }
    };
    (0..COUNT).map(situation).collect()
}

impl Situation {
    pub fn observation(&self, described: &DescribeResponse) -> Observation {
        let image = |camera: &CameraRequest| {
            let size = [camera.width, camera.height];
            let rgb = frame(&camera.name, self.index);
            let rgb = resize(&rgb, [SIDE; 2], size.map(|side| side as usize));
            Image { camera: camera.name.clone(), width: size[0], height: size[1], rgb: rgb.into() }
        };
        let reading = |field: StateField| StateReading {
            field: field.into(),
            values: self.reading(field),
            ..StateReading::default()
        };
        Observation {
            images: described.cameras.iter().map(image).collect(),
            state: described.state().map(reading).collect(),
            privileged: described.privileged.then(|| privileged(&self.hand, self.index)),
        }
    }

    pub(crate) fn reading(&self, field: StateField) -> Vec<f64> {
        let hand = &self.hand;
        match field {
            StateField::Unspecified => vec![],
            StateField::EefPos => hand.position.to_vec(),
            StateField::EefQuatXyzw => hand.quaternion.to_vec(),
            StateField::EefAxisAngle => pose::axis_angle(hand.quaternion).to_vec(),
            StateField::EefRotation => pose::matrix(hand.quaternion).to_vec(),
            StateField::JointPos => self.joints.to_vec(),
            StateField::JointVel => self.velocities.to_vec(),
            StateField::GripperPos => vec![hand.opening, -hand.opening],
            StateField::GripperVel => vec![0.01, -0.01],
        }
    }

    pub(crate) fn quaternion(&self) -> Quaternion {
        self.hand.quaternion
    }
}

/// SplitMix64 generator, which is the same on every platform.
struct Random(u64);

impl Random {
    /// Returns the next number, between -1 and 1.
    fn number(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        2.0 * unit(mix(self.0)) - 1.0
    }
}

fn mix(mut bits: u64) -> u64 {
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

/// Maps bits to a number between 0 and 1.
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

#[derive(Clone, Debug)]
struct Hand {
    position: [f64; 3],
    quaternion: Quaternion,
    /// Opening of each finger, m.
    opening: f64,
}

impl Hand {
    /// Generates a hand that points roughly downwards. The sign of w, which distinguishes the two
    /// quaternions of an orientation, alternates between situations.
    fn generate(random: &mut Random, index: usize) -> Self {
        let sign = if index.is_multiple_of(2) { 1.0 } else { -1.0 };
        let [y, z, w] = [0.15, 0.3, 0.12].map(|size| size * random.number());
        let quaternion = [1.0, y, z, sign * (0.08 + w.abs())];
        let norm = quaternion.iter().map(|number| number * number).sum::<f64>().sqrt();
        Self {
            position: [
                -0.1 + 0.12 * random.number(),
                0.18 * random.number(),
                0.2 + 0.12 * random.number(),
            ],
            quaternion: quaternion.map(|number| number / norm),
            opening: 0.022 + 0.018 * random.number(),
        }
    }
}

/// Returns a scene with a box and a basket, whose goal is the box in the basket.
fn privileged(hand: &Hand, index: usize) -> PrivilegedState {
    let entity = |name: &str, kind: Kind, category: &str, pos: [f64; 3], half: [f64; 3]| Entity {
        name: name.to_owned(),
        kind: kind.into(),
        category: category.to_owned(),
        pos: pos.to_vec(),
        quat: vec![1.0, 0.0, 0.0, 0.0],
        half_extents: half.to_vec(),
        centre: pos.to_vec(),
    };
    let mut random = Random(1000 + index as u64);
    let butter = [0.05 + 0.06 * random.number(), -0.1 + 0.06 * random.number(), 0.02];
    let basket = [0.0, 0.25, 0.05];
    PrivilegedState {
        entities: vec![
            entity("butter_1", Kind::Object, "butter", butter, [0.02, 0.04, 0.02]),
            entity("basket_1", Kind::Object, "basket", basket, [0.08, 0.08, 0.05]),
            entity("basket_1_contain_region", Kind::Site, "basket_1", basket, [0.06, 0.06, 0.05]),
        ],
        joints: vec![],
        goal: vec![GoalPredicate {
            predicate: "in".to_owned(),
            arguments: vec!["butter_1".to_owned(), "basket_1_contain_region".to_owned()],
        }],
        grip_pos: hand.position.to_vec(),
        grip_quat: vec![0.0, 1.0, 0.0, 0.0],
        gripper_opening: 2.0 * hand.opening,
    }
}

/// Object on the table. Positions, from the frame's lower left corner, and sizes are shares of the
/// frame's side.
struct TableObject {
    centre: [f64; 2],
    half: [f64; 2],
    is_round: bool,
    colour: [f64; 3],
}

fn objects(random: &mut Random, index: usize) -> Vec<TableObject> {
    // Only the first object is colourful, so that a policy that searches for colour finds exactly
    // one object.
    let colours =
        [[225.0, 35.0, 45.0], [150.0, 110.0, 75.0], [90.0, 120.0, 165.0], [205.0, 205.0, 190.0]];
    let mut objects: Vec<TableObject> = colours
        .into_iter()
        .map(|colour| TableObject {
            centre: [0; 2].map(|_| 0.5 + 0.36 * random.number()),
            half: [0; 2].map(|_| 0.085 + 0.04 * random.number()),
            is_round: random.number() < 0.0,
            colour,
        })
        .collect();
    let (first, size) = (&mut objects[0], if index == CLOSE_UP { 0.2 } else { 0.055 });
    (first.half, first.is_round) = ([size, 0.9 * size], true);
    // Draws the colourful object last, in front of the others.
    objects.rotate_left(1);
    objects
}

/// Renders a camera's frame: a lit table with grain and spots, and objects on it.
fn frame(camera: &str, index: usize) -> Vec<u8> {
    let name = camera.bytes().fold(17, |sum, byte| mix(sum ^ u64::from(byte)));
    let mut random = Random(name ^ index as u64);
    let objects = objects(&mut random, index);
    let light = [random.number(), random.number()].map(|number| 25.0 * number);
    let spots = spots(name ^ index as u64);
    let mut rgb = Vec::with_capacity(3 * SIDE * SIDE);
    for row in 0..SIDE {
        for column in 0..SIDE {
            let place = [column, row].map(|pixel| (pixel as f64 + 0.5) / SIDE as f64);
            let grain = mix(name ^ (index * SIDE * SIDE + row * SIDE + column) as u64);
            let lit = 40.0 * (place[1] - 0.4)
                + light[0] * place[0]
                + light[1] * place[0] * place[1]
                + spots(column, row)
                + 24.0 * (unit(grain) - 0.5);
            let inside = objects.iter().rev().find(|object| object.covers(place));
            let colour = inside.map_or([132.0, 122.0, 108.0], |object| object.colour);
            rgb.extend(colour.map(|level| (level + lit).clamp(0.0, 255.0) as u8));
        }
    }
    rgb
}

impl TableObject {
    fn covers(&self, place: [f64; 2]) -> bool {
        let [x, y] = [0, 1].map(|axis| (place[axis] - self.centre[axis]) / self.half[axis]);
        if self.is_round { x * x + y * y <= 1.0 } else { x.abs() <= 1.0 && y.abs() <= 1.0 }
    }
}

/// Returns smooth noise with spots of two sizes, in levels, by column and row.
fn spots(key: u64) -> impl Fn(usize, usize) -> f64 {
    let layer = move |cell: usize, column: usize, row: usize| {
        let corner = |x: usize, y: usize| unit(mix(key ^ mix((cell * 4096 + y) as u64) ^ x as u64));
        let ease = |pixel: usize| {
            let t = (pixel % cell) as f64 / cell as f64;
            t * t * (3.0 - 2.0 * t)
        };
        let (x, y) = (column / cell, row / cell);
        let interpolate = |from: f64, to: f64, share: f64| from + (to - from) * share;
        let across = |y: usize| interpolate(corner(x, y), corner(x + 1, y), ease(column));
        interpolate(across(y), across(y + 1), ease(row)) - 0.5
    };
    move |column, row| 36.0 * layer(48, column, row) + 24.0 * layer(11, column, row)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn situations_are_reproducible_differ_and_have_either_sign_of_w() {
        let camera = |name: &str| CameraRequest { name: name.to_owned(), width: 64, height: 48 };
        let described = DescribeResponse {
            cameras: ["agentview", "robot0_eye_in_hand"].map(camera).into(),
            state: vec![StateField::EefPos.into()],
            ..DescribeResponse::default()
        };
        let generated = situations(Suite::Goal);
        let observe = |situations: &[Situation]| -> Vec<Observation> {
            situations.iter().map(|situation| situation.observation(&described)).collect()
        };
        let observations = observe(&generated);
        assert_eq!(observations, observe(&situations(Suite::Goal)));
        for (index, observation) in observations.iter().enumerate() {
            assert_eq!(observation.images[0].rgb.len(), 3 * 64 * 48);
            assert_ne!(observation.images[0].rgb, observation.images[1].rgb);
            for earlier in 0..index {
                assert_ne!(observation.images[0].rgb, observations[earlier].images[0].rgb);
                assert_ne!(observation.state, observations[earlier].state);
                assert_ne!(generated[index].instruction, generated[earlier].instruction);
            }
        }
        let negative = generated.iter().filter(|situation| situation.quaternion()[3] < 0.0);
        assert_eq!(negative.count(), COUNT / 2);
    }
}
