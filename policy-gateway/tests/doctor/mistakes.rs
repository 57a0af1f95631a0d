//! `check` warns of a mistake planted in a server, and of nothing for other servers.

use policy_gateway::doctor::check::Point;
use policy_gateway::doctor::verdict::Verdict;
use proto::policy::{Language, StateField};

use crate::compare::SOUND;
use crate::planted::{NetworkInput, Planted};
use crate::scripted::{findings, serve};

/// Returns the warnings, and a failure of the actions' range.
async fn faults(policy: Planted) -> Vec<(Point, String)> {
    let server = serve(policy).await;
    let findings = findings(&server.address.to_string()).await.into_iter();
    let faults = findings.filter_map(|finding| match finding.verdict {
        // A planted policy checks no versions, keeps no answers for retries, and may round.
        Verdict::Fail { .. } if finding.point != Point::Range => None,
        Verdict::Warn { reason } | Verdict::Fail { reason } => Some((finding.point, reason)),
        _ => None,
    });
    faults.collect()
}

async fn finds(policy: Planted, expected: &[Point], words: &str) {
    let failed = faults(policy).await;
    let points: Vec<Point> = failed.iter().map(|(point, _)| *point).collect();
    assert_eq!(points, expected, "{failed:?}");
    assert!(failed[0].1.contains(words), "{words:?} in {failed:?}");
}

#[tokio::test]
async fn unused_frames_are_found_by_camera() {
    let without_frames = Planted::sound().preparing(|input| input.frames.clear());
    let words = "frames of agentview and robot0_eye_in_hand";
    finds(without_frames, &[Point::Frames], words).await;
    let without_second_camera = Planted::sound().preparing(|input| input.frames.truncate(1));
    finds(without_second_camera, &[Point::Frames], "frames of robot0_eye_in_hand").await;
}

#[tokio::test]
async fn a_gripper_that_never_opens_is_found() {
    let zero_to_one = Planted::sound().finishing(|actions| {
        actions.iter_mut().for_each(|action| action[6] = (action[6] + 1.0) / 2.0);
    });
    finds(zero_to_one, &[Point::Gripper], "answer 1 - 2 g").await;
}

#[tokio::test]
async fn actions_out_of_range_are_found() {
    let large = Planted::sound().finishing(|actions| {
        actions.iter_mut().flatten().for_each(|number| *number *= 40.0);
    });
    finds(large, &[Point::Range], "not un-normalised").await;
}

#[tokio::test]
async fn an_arm_that_does_not_move_is_found() {
    let still = Planted::sound().finishing(|actions| {
        actions.iter_mut().for_each(|action| action[..6].fill(0.0));
    });
    finds(still, &[Point::Motion], "are 0").await;
    let constant = Planted::sound().finishing(|actions| actions.fill([-0.2; 7]));
    finds(constant, &[Point::Motion], "-0.200, -0.200").await;
}

#[tokio::test]
async fn ignored_instructions_are_found_unless_declared() {
    let ignoring_instructions = || Planted::sound().preparing(|input| input.instruction.clear());
    finds(ignoring_instructions(), &[Point::Instructions], "8 other instructions").await;
    let mut declared = ignoring_instructions();
    declared.described.language = Language::Ignored.into();
    assert_eq!(faults(declared).await, []);
}

#[tokio::test]
async fn answers_that_ignore_all_observations_are_found() {
    let absent = Planted::sound().preparing(|input| {
        input.frames.clear();
        input.state.clear();
    });
    let points = [Point::Observations, Point::Frames];
    finds(absent, &points, "8 observations get the same answer").await;
}

#[tokio::test]
async fn a_server_that_samples_is_judged_by_means_of_its_answers() {
    let sampling = |change: fn(&mut NetworkInput)| {
        let mut policy = Planted::drawing(0.1);
        policy.described.unseeded = true;
        policy.preparing(move |input| {
            input.seed = input.earlier_queries;
            change(input);
        })
    };
    let without_frames = sampling(|input| input.frames.clear());
    finds(without_frames, &[Point::Frames], "means of 8 answers").await;
    let absent = sampling(|input| {
        input.frames.clear();
        input.state.clear();
    });
    let points = [Point::Observations, Point::Frames];
    finds(absent, &points, "8 observations get the same answer").await;
}

#[tokio::test]
async fn servers_without_mistakes_pass_every_check() {
    let joints = || {
        let mut joints = Planted::sound().with_state(&[StateField::JointPos]);
        joints.described.cameras.clear();
        joints
    };
    for policy in [&SOUND[..], &[joints]].concat() {
        assert_eq!(faults(policy()).await, []);
    }
}
