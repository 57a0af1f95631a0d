//! Answers to valid queries, and refusal of invalid ones.

mod support;

use builtin_policies::student::{Network, Output, PICTURE_BYTES, Query, QueryError};
use support::{OwnedQuery, Weights};

fn network() -> Network {
    Network::from_safetensors(&Weights::random(2).bytes()).expect("weights")
}

#[test]
fn actions_are_limited_and_the_gripper_opens_or_closes() {
    let mut arm = [[0.25; 6]; 8];
    arm[1] = [2.0, -2.0, 1.0, -1.0, 0.0, 0.5];
    let gripper_logits = [0.1, -0.1, 0.0, 9.0, -9.0, 1e-30, -1e-30, 1.0];
    let output = Output { arm, gripper_logits };
    let chunk = output.chunk();
    assert_eq!(chunk[1], [1.0, -1.0, 1.0, -1.0, 0.0, 0.5, -1.0]);
    let gripper = chunk.map(|action| action[6]);
    assert_eq!(gripper, [1.0, -1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0]);
}

#[test]
fn every_input_changes_the_answer() {
    let (network, owned) = (network(), OwnedQuery::random(0));
    let other_owned = OwnedQuery::random(1);
    let (query, other) = (owned.query(), other_owned.query());
    let changed = [
        Query { agentview: other.agentview, ..query },
        Query { wrist: other.wrist, ..query },
        Query { eef_pos: other.eef_pos, ..query },
        Query { eef_rotation: other.eef_rotation, ..query },
        Query { gripper_pos: other.gripper_pos, ..query },
        Query { instruction: other.instruction, ..query },
    ];
    let unchanged = network.outputs(&[query]).expect("an answer")[0];
    for (index, output) in network.outputs(&changed).expect("answers").iter().enumerate() {
        assert_ne!(*output, unchanged, "change {index}");
    }
    let same_words = Query { instruction: "PUT the black-bowl on the plate.", ..query };
    let output = network.outputs(&[same_words]).expect("an answer")[0];
    assert_eq!(output, unchanged);
}

#[test]
fn an_empty_batch_gets_no_answers() {
    assert_eq!(network().act(&[]), Ok(Vec::new()));
}

#[test]
fn pictures_of_other_sizes_are_refused() {
    let (network, owned) = (network(), OwnedQuery::random(0));
    let query = owned.query();
    let small = Query { wrist: &owned.wrist[..128 * 128 * 3], ..query };
    let refusal = network.act(&[query, small]).expect_err("a refusal");
    let expected =
        QueryError::Picture { query: 1, camera: "wrist", found: 49152, expected: PICTURE_BYTES };
    assert_eq!(refusal, expected);
    assert_eq!(
        refusal.to_string(),
        "query 1: the picture of wrist has 49152 bytes; expected are 196608, 256 × 256 pixels of \
         3 bytes: request frames of that size"
    );
    let empty = Query { agentview: &[], ..query };
    let refusal = network.act(&[empty]).expect_err("a refusal").to_string();
    assert!(refusal.starts_with("query 0: the picture of agentview has 0 bytes"));
}

#[test]
fn readings_that_are_not_finite_are_refused() {
    let (network, owned) = (network(), OwnedQuery::random(0));
    let query = owned.query();
    let cases = [
        (Query { eef_pos: [0.0, f64::NAN, 0.0], ..query }, "query 0: number 1 of eef_pos is NaN"),
        (
            Query { eef_rotation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1e300], ..query },
            "query 0: number 8 of eef_rotation is 1000000000",
        ),
        (
            Query { gripper_pos: [f64::NEG_INFINITY, 0.0], ..query },
            "query 0: number 0 of gripper_pos is -inf",
        ),
    ];
    for (query, expected) in cases {
        let refusal = network.act(&[query]).expect_err("a refusal").to_string();
        assert!(refusal.starts_with(expected), "{refusal}");
    }
}

#[test]
fn an_answer_that_overflows_is_an_error_and_no_action() {
    let (network, owned) = (network(), OwnedQuery::random(0));
    let far = Query { eef_pos: [3e38, 3e38, -3e38], ..owned.query() };
    let refusal = network.act(&[owned.query(), far]).expect_err("a refusal");
    assert_eq!(refusal, QueryError::Answer { query: 1 });
}
