//! Synthetic situations, equal in every run: a table with texture at every scale and no symmetry,
//! with a different arm pose and task in each situation.

use std::f64::consts::PI;

use benchmark::{Suite, TaskRef};
use proto::policy::{DescribeResponse, Image, PrivilegedState, StateField};

use crate::doctor::{conformance::scene, situation::Situation};

pub(crate) const COUNT: usize = 8;
/// Side of the frames, pixels, as in LIBERO.
const SIDE: usize = 256;
/// Index of the situation in which the colourful object fills much of the frame, as before a
/// grasp.
const CLOSE_UP: usize = 5;

/// Generates situations for a suite, with frames of these cameras.
pub fn situations(suite: Suite, cameras: &[&str]) -> Vec<Situation> {
    let tasks: Vec<TaskRef> = suite.tasks().collect();
    let situation = |index: usize| {
        let mut random = Random(index as u64 + 1);
        let hand = Hand::generate(&mut random, index);
        let frames = cameras.iter().map(|camera| frame(camera, index));
        Situation {
            suite: suite.name().to_owned(),
            instruction: tasks[index % tasks.len()].instruction(),
            frames: frames.collect(),
            readings: hand.readings(&mut random),
            privileged: Some(privileged(&hand, index)),
        }
    };
    (0..COUNT).map(situation).collect()
}

pub fn cameras<'a>(described: &[&'a DescribeResponse]) -> Vec<&'a str> {
    let cameras = described.iter().flat_map(|description| &description.cameras);
    let mut names: Vec<&str> = cameras.map(|camera| camera.name.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    names
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

struct Hand {
    position: [f64; 3],
    /// Orientation as a quaternion, x y z w.
    quaternion: [f64; 4],
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

    fn readings(&self, random: &mut Random) -> Vec<(StateField, Vec<f64>)> {
        let rest = [0.0, -0.16, 0.0, -2.44, 0.0, 2.23, PI / 4.0];
        let mut around = |centre: f64, size: f64| centre + size * random.number();
        vec![
            (StateField::EefPos, self.position.to_vec()),
            (StateField::EefQuatXyzw, self.quaternion.to_vec()),
            (StateField::JointPos, rest.map(|angle| around(angle, 0.35)).to_vec()),
            (StateField::JointVel, rest.map(|_| around(0.0, 0.2)).to_vec()),
            (StateField::GripperPos, vec![self.opening, -self.opening]),
            (StateField::GripperVel, vec![0.01, -0.01]),
        ]
    }
}

fn privileged(hand: &Hand, index: usize) -> PrivilegedState {
    let described = DescribeResponse { privileged: true, ..DescribeResponse::default() };
    let mut state = scene::observation(&described, 0).privileged.unwrap_or_default();
    let mut random = Random(1000 + index as u64);
    let moved = [0.06 * random.number(), 0.06 * random.number(), 0.0];
    if let Some(object) = state.entities.first_mut() {
        for position in [&mut object.pos, &mut object.centre] {
            position.iter_mut().zip(moved).for_each(|(number, shift)| *number += shift);
        }
    }
    state.grip_pos = hand.position.to_vec();
    state.gripper_opening = 2.0 * hand.opening;
    state
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
fn frame(camera: &str, index: usize) -> Image {
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
    Image { camera: camera.to_owned(), width: SIDE as u32, height: SIDE as u32, rgb: rgb.into() }
}

impl TableObject {
    fn covers(&self, place: [f64; 2]) -> bool {
        let [x, y] = [0, 1].map(|axis| (place[axis] - self.centre[axis]) / self.half[axis]);
        match self.is_round {
            true => x * x + y * y <= 1.0,
            false => x.abs() <= 1.0 && y.abs() <= 1.0,
        }
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
    fn situations_are_reproducible_and_differ_from_each_other() {
        let cameras = ["agentview", "robot0_eye_in_hand"];
        let generated = situations(Suite::Goal, &cameras);
        let regenerated = situations(Suite::Goal, &cameras);
        assert_eq!(generated.len(), COUNT);
        for (index, situation) in generated.iter().enumerate() {
            assert_eq!(situation.frames, regenerated[index].frames);
            assert_ne!(situation.frames[0].rgb, situation.frames[1].rgb);
            for earlier in &generated[..index] {
                assert_ne!(situation.frames[0].rgb, earlier.frames[0].rgb);
                assert_ne!(situation.readings, earlier.readings);
                assert_ne!(situation.instruction, earlier.instruction);
            }
        }
    }

    #[test]
    fn quaternions_have_either_sign_of_w() {
        let signs = situations(Suite::Object, &[]);
        let signs = signs.iter().filter_map(Situation::quaternion);
        let negative = signs.filter(|sign| sign[3] < 0.0).count();
        assert_eq!(negative, COUNT / 2);
    }
}
