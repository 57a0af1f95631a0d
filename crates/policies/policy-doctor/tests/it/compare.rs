//! `compare` names a mistake planted in one of two servers, and reports nothing for servers that
//! answer alike.

use libero_ctrl::Suite;
use policy_doctor::{
    compare::{Comparison, compare},
    difference::Kind,
    pose,
    server::Server,
    synthetic,
};
use proto::policy::StateField;

use crate::{
    planted::{Action, Planted, Seen, halved_and_doubled, hash, upside_down},
    scripted::{Running, serve},
};

async fn server(url: &str) -> Server {
    let spec = url.parse().expect("a back-end");
    let server = Server::connect(&spec, &transport::Access::none(), "libero_goal").await;
    server.expect("it describes itself")
}

async fn compared(a: &str, b: &str) -> Comparison {
    let (a, b) = (server(a).await, server(b).await);
    let cameras = synthetic::cameras(&[&a.described, &b.described]);
    let situations = synthetic::situations(Suite::Goal, &cameras);
    compare(a, b, situations).await.expect("both answer")
}

fn url(server: &Running) -> String {
    format!("grpc://{}", server.address)
}

/// Compares two policies in either order; returns the comparison with the second one as B.
async fn both_ways(one: Planted, other: Planted, expected: &[Kind]) -> Comparison {
    let (one, other) = (serve(one).await, serve(other).await);
    let found = compared(&url(&one), &url(&other)).await;
    let back = compared(&url(&other), &url(&one)).await;
    for comparison in [&found, &back] {
        let kinds: Vec<Kind> = comparison
            .differences
            .iter()
            .map(|difference| difference.kind)
            .collect();
        assert_eq!(kinds, expected, "{comparison:#?}");
    }
    found
}

/// Asserts that a mistake is named with these words, and that nothing else is reported.
async fn names(mistaken: Planted, kind: Kind, words: &str) {
    let found = both_ways(Planted::sound(), mistaken, &[kind]).await;
    let text = &found.differences[0].text;
    assert!(text.contains(words), "{words:?} in {text}");
}

/// Returns a policy that changes the axis-angle in its state of position, axis-angle and fingers.
fn rotation(change: impl Fn([f64; 3]) -> [f64; 3] + Send + Sync + 'static) -> Planted {
    Planted::sound().preparing(move |seen: &mut Seen| {
        let own = [seen.state[3], seen.state[4], seen.state[5]];
        seen.state[3..6].copy_from_slice(&change(own));
    })
}

/// Returns a policy that changes every action.
fn acting(change: impl Fn(&mut Action) + Send + Sync + 'static) -> Planted {
    Planted::sound().finishing(move |actions| actions.iter_mut().for_each(&change))
}

/// Policies without a mistake.
pub(crate) const SOUND: [fn() -> Planted; 4] = [
    Planted::sound,
    || Planted::drawing(0.3),
    || {
        let mut unseeded = Planted::drawing(0.1);
        unseeded.described.unseeded = true;
        unseeded.preparing(|seen| seen.seed = seen.asked_before)
    },
    // Batch kernels change low-order bits.
    || {
        Planted::sound().preparing(|seen| {
            let moved = 1e-5 * hash(&[9, seen.asked_before]);
            seen.state.iter_mut().for_each(|number| *number += moved);
        })
    },
];

#[tokio::test]
async fn frames_fed_upside_down_are_named() {
    let flipping = Planted::sound().preparing(|seen| seen.frames.iter_mut().for_each(upside_down));
    names(
        flipping,
        Kind::FrameOrientation,
        "frames flipped vertically",
    )
    .await;
    let one = Planted::sound().preparing(|seen| upside_down(&mut seen.frames[1]));
    let words = "frames of robot0_eye_in_hand flipped vertically";
    names(one, Kind::FrameOrientation, words).await;
}

#[tokio::test]
async fn frames_fed_turned_are_named() {
    let turning = Planted::sound().preparing(|seen| {
        for frame in &mut seen.frames {
            let turned: Vec<u8> = frame.rgb.rchunks_exact(3).flatten().copied().collect();
            frame.rgb = turned.into();
        }
    });
    names(turning, Kind::FrameOrientation, "turned by 180°").await;
}

#[tokio::test]
async fn frames_scaled_down_on_the_way_are_named() {
    let shrinking =
        Planted::sound().preparing(|seen| seen.frames.iter_mut().for_each(halved_and_doubled));
    names(
        shrinking,
        Kind::FrameSize,
        "scaled to 64 × 64 pixels and back (means",
    )
    .await;
}

#[tokio::test]
async fn cameras_and_colours_in_each_others_places_are_named() {
    let swapping = Planted::sound().preparing(|seen| seen.frames.reverse());
    names(swapping, Kind::Cameras, "two cameras exchanged").await;
    let bgr = Planted::sound().preparing(|seen| {
        for frame in &mut seen.frames {
            let pixels = frame.rgb.chunks_exact(3);
            let reversed: Vec<u8> = pixels
                .flat_map(|pixel| [pixel[2], pixel[1], pixel[0]])
                .collect();
            frame.rgb = reversed.into();
        }
    });
    names(bgr, Kind::Colours, "BGR").await;
}

#[tokio::test]
async fn roll_pitch_yaw_in_place_of_axis_angle_is_named() {
    let mistaken = rotation(|own| pose::roll_pitch_yaw(pose::from_axis_angle(own)));
    names(
        mistaken,
        Kind::StateDefinition,
        "position, roll-pitch-yaw and two finger",
    )
    .await;
}

#[tokio::test]
async fn joints_in_place_of_a_pose_are_named() {
    let pose = [
        StateField::EefPos,
        StateField::EefQuatXyzw,
        StateField::GripperPos,
    ];
    let joints = [StateField::JointPos, StateField::GripperPos];
    let (posed, jointed) = (Planted::sound(), Planted::sound());
    let (posed, jointed) = (posed.with_state(&pose), jointed.with_state(&joints));
    let found = both_ways(posed, jointed, &[Kind::StateDefinition]).await;
    let text = &found.differences[0].text;
    assert!(
        text.contains("seven joint angles and two finger joints"),
        "{text}"
    );
    assert_eq!(found.descriptions[0].what, "state");
}

#[tokio::test]
async fn a_quaternion_of_the_other_sign_is_named() {
    let positive = rotation(|own| {
        let quaternion = pose::from_axis_angle(own);
        let sign = if quaternion[3] < 0.0 { -1.0 } else { 1.0 };
        pose::axis_angle(quaternion.map(|number| sign * number))
    });
    names(positive, Kind::QuaternionSign, "so that w is not negative").await;
    let other = rotation(|own| pose::axis_angle(pose::from_axis_angle(own).map(|number| -number)));
    names(other, Kind::QuaternionSign, "quaternion's sign flipped").await;
}

#[tokio::test]
async fn a_gripper_in_another_convention_is_named() {
    let inverted = acting(|action| action[6] = -action[6]);
    names(
        inverted,
        Kind::GripperConvention,
        "one opens where the other closes",
    )
    .await;
    let share = acting(|action| action[6] = (action[6] + 1.0) / 2.0);
    names(share, Kind::GripperConvention, "B = (A + 1) / 2").await;
}

#[tokio::test]
async fn a_gripper_in_another_scale_is_named() {
    let scaled = acting(|action| action[6] *= 0.25);
    names(scaled, Kind::GripperScale, "A's × 0.250").await;
}

#[tokio::test]
async fn actions_un_normalised_with_other_statistics_are_named() {
    let moved = acting(|action| {
        for (at, number) in action[..6].iter_mut().enumerate() {
            *number = *number * (0.4 + 0.2 * at as f64) - 0.05;
        }
    });
    names(moved, Kind::UnNormalisation, "x = A's × 0.400 - 0.050").await;
    let one = acting(|action| action[2] *= 3.0);
    names(one, Kind::UnNormalisation, "moved: z = A's × 3.000.").await;
}

#[tokio::test]
async fn a_chunk_that_begins_later_is_named() {
    let late = Planted::sound().finishing(|actions| drop(actions.drain(..2)));
    names(
        late,
        Kind::ChunkOffset,
        "action k of B is action k + 2 of A",
    )
    .await;
}

#[tokio::test]
async fn differences_in_seed_use_are_named() {
    type Change = fn(&mut Seen);
    let seeding = |change: Change| Planted::drawing(0.2).preparing(change);
    let cases: [(Change, &str); 4] = [
        (|seen| seen.seed += 1, "one more than its own"),
        (|seen| seen.seed = 42, "seed 42, whatever its own seed is"),
        (|seen| seen.seed = seen.asked_before, "otherwise every time"),
        (|seen| seen.seed ^= 0x55, "other noise"),
    ];
    for (change, words) in cases {
        let honest = Planted::drawing(0.2);
        let found = both_ways(honest, seeding(change), &[Kind::Seed]).await;
        let text = &found.differences[0].text;
        assert!(text.contains(words), "{words:?} in {text}");
    }
}

#[tokio::test]
async fn a_mistake_is_named_through_noise_of_other_seeds() {
    let flipping = Planted::drawing(0.05).preparing(|seen| {
        seen.seed ^= 0x55;
        seen.frames.iter_mut().for_each(upside_down);
    });
    both_ways(Planted::drawing(0.05), flipping, &[Kind::FrameOrientation]).await;
}

#[tokio::test]
async fn mistakes_that_come_together_are_named_together() {
    let both = Planted::sound()
        .preparing(|seen| seen.frames.iter_mut().for_each(upside_down))
        .finishing(|actions| actions.iter_mut().for_each(|action| action[6] = -action[6]));
    let expected = [Kind::FrameOrientation, Kind::GripperConvention];
    both_ways(Planted::sound(), both, &expected).await;
    let both = Planted::sound().preparing(|seen| {
        seen.frames.iter_mut().for_each(upside_down);
        seen.state[6..]
            .iter_mut()
            .for_each(|number| *number = number.abs());
    });
    let expected = [Kind::FrameOrientation, Kind::StateDefinition];
    both_ways(Planted::sound(), both, &expected).await;
}

#[tokio::test]
async fn other_weights_have_no_explanation() {
    let other = Planted::sound().preparing(|seen| seen.instruction.push('!'));
    names(other, Kind::Unexplained, "no difference that is looked for").await;
}

#[tokio::test]
async fn description_differences_are_reported_and_are_no_mistakes() {
    let pose = [
        StateField::EefPos,
        StateField::EefQuatXyzw,
        StateField::GripperPos,
    ];
    // Converts the quaternion to the axis-angle that the other policy requests.
    let converting = Planted::sound().with_state(&pose).preparing(|seen| {
        let quaternion: [f64; 4] = seen.state[3..7].try_into().expect("four numbers");
        seen.state.splice(3..7, pose::axis_angle(quaternion));
    });
    let found = both_ways(Planted::sound(), converting, &[]).await;
    assert_eq!(found.descriptions[0].what, "state");
}

#[tokio::test]
async fn servers_that_answer_alike_are_not_accused() {
    let one_by_one = || {
        let mut one_by_one = Planted::sound();
        one_by_one.described.horizon = 1;
        one_by_one.described.execute = 1;
        one_by_one.described.stateful = true;
        one_by_one
    };
    for policy in [&SOUND[..], &[one_by_one]].concat() {
        both_ways(policy(), policy(), &[]).await;
    }
    for builtin in ["builtin:expert", "builtin:noop"] {
        let comparison = compared(builtin, builtin).await;
        assert!(comparison.differences.is_empty(), "{comparison:#?}");
    }
}
