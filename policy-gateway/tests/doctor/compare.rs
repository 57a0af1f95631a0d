//! `compare` names a mistake planted in one of two servers, and reports nothing for servers that
//! answer alike.

use policy_gateway::doctor::compare::{Comparison, compare};
use policy_gateway::doctor::difference::Kind;
use policy_gateway::doctor::pose;
use policy_gateway::doctor::probe::Probe;
use proto::policy::StateField;

use crate::planted::{Action, NetworkInput, Planted, hash, upside_down};
use crate::scripted::{Running, serve, target};

async fn compared(a: &Running, b: &Running) -> Comparison {
    let probe = async |server: &Running| Probe::connect(&target(&server.address.to_string())).await;
    let (a, b) = (probe(a).await.expect("a server"), probe(b).await.expect("a server"));
    compare(a, b).await.expect("a comparison")
}

/// Compares two policies in both orders, and asserts that the expected kinds of differences are
/// reported. Returns the comparison with the second policy as B.
async fn compare_in_both_orders(first: Planted, second: Planted, expected: &[Kind]) -> Comparison {
    let (first, second) = (serve(first).await, serve(second).await);
    let found = compared(&first, &second).await;
    let reversed = compared(&second, &first).await;
    for comparison in [&found, &reversed] {
        let kinds: Vec<Kind> =
            comparison.differences.iter().map(|difference| difference.kind).collect();
        assert_eq!(kinds, expected, "{comparison:#?}");
    }
    found
}

/// Asserts that a mistake is named with these words, and that nothing else is reported.
async fn assert_named(mistaken: Planted, kind: Kind, words: &str) {
    let found = compare_in_both_orders(Planted::sound(), mistaken, &[kind]).await;
    let text = &found.differences[0].text;
    assert!(text.contains(words), "{words:?} in {text}");
}

/// Returns a policy that changes the axis-angle in its state of position, axis-angle and fingers.
fn rotation(change: impl Fn([f64; 3]) -> [f64; 3] + Send + Sync + 'static) -> Planted {
    Planted::sound().preparing(move |input: &mut NetworkInput| {
        let axis_angle = [input.state[3], input.state[4], input.state[5]];
        input.state[3..6].copy_from_slice(&change(axis_angle));
    })
}

fn acting(change: impl Fn(&mut Action) + Send + Sync + 'static) -> Planted {
    Planted::sound().finishing(move |actions| actions.iter_mut().for_each(&change))
}

pub(crate) const SOUND: [fn() -> Planted; 4] = [
    Planted::sound,
    || Planted::drawing(0.3),
    || {
        let mut unseeded = Planted::drawing(0.1);
        unseeded.described.unseeded = true;
        unseeded.preparing(|input| input.seed = input.earlier_queries)
    },
    // Batch kernels change low-order bits.
    || {
        Planted::sound().preparing(|input| {
            let moved = 1e-5 * hash(&[9, input.earlier_queries]);
            input.state.iter_mut().for_each(|number| *number += moved);
        })
    },
];

#[tokio::test]
async fn vertically_flipped_frames_are_named() {
    let flipping =
        Planted::sound().preparing(|input| input.frames.iter_mut().for_each(upside_down));
    assert_named(flipping, Kind::FrameOrientation, "frames flipped vertically").await;
    let one_camera = Planted::sound().preparing(|input| upside_down(&mut input.frames[1]));
    let words = "frames of robot0_eye_in_hand flipped vertically";
    assert_named(one_camera, Kind::FrameOrientation, words).await;
}

#[tokio::test]
async fn frames_turned_by_180_degrees_are_named() {
    let turning = Planted::sound().preparing(|input| {
        for frame in &mut input.frames {
            let turned: Vec<u8> = frame.rgb.rchunks_exact(3).flatten().copied().collect();
            frame.rgb = turned.into();
        }
    });
    assert_named(turning, Kind::FrameOrientation, "turned by 180°").await;
}

#[tokio::test]
async fn swapped_cameras_and_colour_channels_are_named() {
    let swapping = Planted::sound().preparing(|input| input.frames.reverse());
    assert_named(swapping, Kind::Cameras, "two cameras exchanged").await;
    let bgr = Planted::sound().preparing(|input| {
        for frame in &mut input.frames {
            let pixels = frame.rgb.chunks_exact(3);
            let reversed: Vec<u8> =
                pixels.flat_map(|pixel| [pixel[2], pixel[1], pixel[0]]).collect();
            frame.rgb = reversed.into();
        }
    });
    assert_named(bgr, Kind::Colours, "BGR").await;
}

#[tokio::test]
async fn roll_pitch_yaw_in_place_of_axis_angle_is_named() {
    let mistaken = rotation(|vector| pose::roll_pitch_yaw(pose::from_axis_angle(vector)));
    assert_named(mistaken, Kind::StateDefinition, "position, roll-pitch-yaw and two finger").await;
}

#[tokio::test]
async fn joints_in_place_of_a_pose_are_named() {
    let pose = [StateField::EefPos, StateField::EefQuatXyzw, StateField::GripperPos];
    let joints = [StateField::JointPos, StateField::GripperPos];
    let with_pose = Planted::sound().with_state(&pose);
    let with_joints = Planted::sound().with_state(&joints);
    let found = compare_in_both_orders(with_pose, with_joints, &[Kind::StateDefinition]).await;
    let text = &found.differences[0].text;
    assert!(text.contains("seven joint angles and two finger joints"), "{text}");
    assert_eq!(found.descriptions[0].what, "state");
}

#[tokio::test]
async fn a_quaternion_of_the_other_sign_is_named() {
    let positive = rotation(|vector| {
        let quaternion = pose::from_axis_angle(vector);
        let sign = if quaternion[3] < 0.0 { -1.0 } else { 1.0 };
        pose::axis_angle(quaternion.map(|number| sign * number))
    });
    assert_named(positive, Kind::QuaternionSign, "so that w is not negative").await;
    let negated =
        rotation(|vector| pose::axis_angle(pose::from_axis_angle(vector).map(|number| -number)));
    assert_named(negated, Kind::QuaternionSign, "quaternion's sign flipped").await;
}

#[tokio::test]
async fn a_gripper_in_another_convention_is_named() {
    let inverted = acting(|action| action[6] = -action[6]);
    assert_named(inverted, Kind::GripperConvention, "one opens where the other closes").await;
    let zero_to_one = acting(|action| action[6] = (action[6] + 1.0) / 2.0);
    assert_named(zero_to_one, Kind::GripperConvention, "B = (A + 1) / 2").await;
}

#[tokio::test]
async fn actions_un_normalised_with_other_statistics_are_named() {
    let scaled = acting(|action| {
        for (component, number) in action[..6].iter_mut().enumerate() {
            *number = *number * (0.4 + 0.2 * component as f64) - 0.05;
        }
    });
    assert_named(scaled, Kind::UnNormalisation, "x = A's × 0.400 - 0.050").await;
    let one_scaled = acting(|action| action[2] *= 3.0);
    assert_named(one_scaled, Kind::UnNormalisation, "shifted: z = A's × 3.000.").await;
    let gripper = acting(|action| action[6] *= 0.25);
    assert_named(gripper, Kind::UnNormalisation, "shifted: gripper = A's × 0.250.").await;
}

#[tokio::test]
async fn a_chunk_that_begins_later_is_named() {
    let late = Planted::sound().finishing(|actions| drop(actions.drain(..2)));
    assert_named(late, Kind::ChunkOffset, "action k of B is action k + 2 of A").await;
}

#[tokio::test]
async fn differences_in_seed_use_are_named() {
    type Change = fn(&mut NetworkInput);
    let seeding = |change: Change| Planted::drawing(0.2).preparing(change);
    let cases: [(Change, &str); 3] = [
        (|input| input.seed = 42, "are the same for every seed"),
        (|input| input.seed = input.earlier_queries, "differently every time"),
        (|input| input.seed ^= 0x55, "different noise"),
    ];
    for (change, words) in cases {
        let sound = Planted::drawing(0.2);
        let found = compare_in_both_orders(sound, seeding(change), &[Kind::Seed]).await;
        let text = &found.differences[0].text;
        assert!(text.contains(words), "{words:?} in {text}");
    }
}

#[tokio::test]
async fn a_mistake_is_named_despite_noise_of_different_seeds() {
    let flipping = Planted::drawing(0.05).preparing(|input| {
        input.seed ^= 0x55;
        input.frames.iter_mut().for_each(upside_down);
    });
    compare_in_both_orders(Planted::drawing(0.05), flipping, &[Kind::FrameOrientation]).await;
}

#[tokio::test]
async fn simultaneous_mistakes_are_all_named() {
    let two_mistakes = Planted::sound()
        .preparing(|input| input.frames.iter_mut().for_each(upside_down))
        .finishing(|actions| actions.iter_mut().for_each(|action| action[6] = -action[6]));
    let expected = [Kind::FrameOrientation, Kind::GripperConvention];
    compare_in_both_orders(Planted::sound(), two_mistakes, &expected).await;
    let two_mistakes = Planted::sound().preparing(|input| {
        input.frames.iter_mut().for_each(upside_down);
        input.state[6..].iter_mut().for_each(|number| *number = number.abs());
    });
    let expected = [Kind::FrameOrientation, Kind::StateDefinition];
    compare_in_both_orders(Planted::sound(), two_mistakes, &expected).await;
}

#[tokio::test]
async fn other_weights_have_no_explanation() {
    let other_function = Planted::sound().preparing(|input| input.instruction.push('!'));
    assert_named(other_function, Kind::Unexplained, "none of the differences that are tried").await;
}

#[tokio::test]
async fn description_differences_are_reported_and_are_no_mistakes() {
    let pose = [StateField::EefPos, StateField::EefQuatXyzw, StateField::GripperPos];
    // Converts the quaternion to the axis-angle that the other policy requests.
    let converting = Planted::sound().with_state(&pose).preparing(|input| {
        let quaternion: [f64; 4] = input.state[3..7].try_into().expect("four numbers");
        input.state.splice(3..7, pose::axis_angle(quaternion));
    });
    let found = compare_in_both_orders(Planted::sound(), converting, &[]).await;
    assert_eq!(found.descriptions[0].what, "state");
}

#[tokio::test]
async fn no_difference_is_reported_for_servers_that_answer_alike() {
    let one_by_one = || {
        let mut one_by_one = Planted::sound();
        one_by_one.described.horizon = 1;
        one_by_one.described.execute = 1;
        one_by_one.described.stateful = true;
        one_by_one
    };
    for policy in [&SOUND[..], &[one_by_one]].concat() {
        compare_in_both_orders(policy(), policy(), &[]).await;
    }
}
