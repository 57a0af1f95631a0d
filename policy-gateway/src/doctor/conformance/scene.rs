//! Synthetic observations with every input that a policy can request, in the right shape and of
//! plausible size, and the same in every run. Frames are hashes of pixel positions. State readings
//! are those of an arm at rest. The privileged scene has a box and a basket, and the goal is the
//! box in the basket.

use proto::policy::{
    DescribeResponse, Entity, GoalPredicate, Image, Observation, PrivilegedState, StateField,
    StateReading, entity::Kind,
};

/// Suites, each with the canonical instruction of one task.
pub const TASKS: [(&str, &str); 4] = [
    ("libero_object", "pick up the butter and place it in the basket"),
    (
        "libero_spatial",
        "pick up the black bowl between the plate and the ramekin and place it on the plate",
    ),
    ("libero_goal", "open the middle drawer of the cabinet"),
    ("libero_10", "put both the alphabet soup and the tomato sauce in the basket"),
];

/// Returns the instruction of a suite's task; for an unknown suite, that of the first suite.
pub fn instruction(suite: &str) -> &'static str {
    let task = TASKS.iter().find(|(name, _)| *name == suite);
    task.unwrap_or(&TASKS[0]).1
}

/// Returns the observation at a query index, the same in every episode.
pub fn observation(described: &DescribeResponse, query_index: u32) -> Observation {
    let cameras = described.cameras.iter();
    let images = cameras.map(|camera| Image {
        camera: camera.name.clone(),
        width: camera.width,
        height: camera.height,
        rgb: pixels(u64::from(camera.width) * u64::from(camera.height), query_index).into(),
    });
    let state = described.state().map(|field| StateReading {
        field: field.into(),
        values: reading(field, f64::from(query_index)),
    });
    Observation {
        images: images.collect(),
        state: state.collect(),
        privileged: described.privileged.then(|| privileged(f64::from(query_index))),
    }
}

/// Returns RGB values for `count` pixels, as hashes of position and query index.
fn pixels(count: u64, query_index: u32) -> Vec<u8> {
    let hash = |at: u64| {
        let mixed = (at ^ u64::from(query_index) << 40).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        (mixed >> 56) as u8
    };
    (0..3 * count).map(hash).collect()
}

/// Returns a reading of the Panda's rest pose. The hand's x and the first joint are shifted by a
/// millimetre and a milliradian per query.
fn reading(field: StateField, query: f64) -> Vec<f64> {
    let drift = 1e-3 * query;
    match field {
        StateField::Unspecified => vec![],
        StateField::EefPos => vec![-0.15 + drift, 0.0, 0.25],
        StateField::EefQuatXyzw => vec![1.0, 0.0, 0.0, 0.0],
        StateField::EefAxisAngle => vec![std::f64::consts::PI, 0.0, 0.0],
        StateField::EefRotation => vec![1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0],
        StateField::JointPos => vec![drift, -0.16, 0.0, -2.44, 0.0, 2.23, 0.785],
        StateField::JointVel => vec![0.0; 7],
        StateField::GripperPos => vec![0.04, -0.04],
        StateField::GripperVel => vec![0.0, 0.0],
    }
}

fn privileged(query: f64) -> PrivilegedState {
    let entity = |name: &str, kind: Kind, category: &str, pos: [f64; 3], half: [f64; 3]| Entity {
        name: name.to_owned(),
        kind: kind.into(),
        category: category.to_owned(),
        pos: pos.to_vec(),
        quat: vec![1.0, 0.0, 0.0, 0.0],
        half_extents: half.to_vec(),
        centre: pos.to_vec(),
    };
    let basket = [0.0, 0.25, 0.05];
    PrivilegedState {
        entities: vec![
            entity("butter_1", Kind::Object, "butter", [0.05, -0.1, 0.02], [0.02, 0.04, 0.02]),
            entity("basket_1", Kind::Object, "basket", basket, [0.08, 0.08, 0.05]),
            entity("basket_1_contain_region", Kind::Site, "basket_1", basket, [0.06, 0.06, 0.05]),
        ],
        joints: vec![],
        goal: vec![GoalPredicate {
            predicate: "in".to_owned(),
            arguments: vec!["butter_1".to_owned(), "basket_1_contain_region".to_owned()],
        }],
        grip_pos: vec![-0.15 + 1e-3 * query, 0.0, 0.25],
        grip_quat: vec![0.0, 1.0, 0.0, 0.0],
        gripper_opening: 0.08,
    }
}
