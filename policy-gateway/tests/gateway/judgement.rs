//! `compare` and `doctor` as programs: their output and their exit codes.

use std::collections::BTreeSet;

use policy_backends::recorder::RecordInto;
use policy_gateway::config::RouteSpec;
use proto::policy::{
    DescribeResponse, Image, InferRequest, Observation, Setting, StateField, StateReading,
};
use serde_json::Value;
use tonic::Status;

use crate::assertions::assert_contains;
use crate::{
    json_keys::{documented, keys},
    planted::{Planted, SIDE, hash, upside_down},
    program::program,
    support::{Running, Scripted, description, infer, reloadable, reset, serve},
};

struct CommandOutput {
    status: Option<i32>,
    stdout: String,
    stderr: String,
}

/// Runs a command to its end while the servers of this test run.
async fn run_to_end(arguments: &[&str]) -> CommandOutput {
    let mut command = program(arguments);
    let output = tokio::task::spawn_blocking(move || command.output());
    let output = output.await.expect("the program runs").expect("the program starts");
    CommandOutput {
        status: output.status.code(),
        stdout: String::from_utf8(output.stdout).expect("UTF-8"),
        stderr: String::from_utf8(output.stderr).expect("UTF-8"),
    }
}

fn url(server: &Running) -> String {
    format!("grpc://{}", server.address)
}

fn policy_with_flipped_frames() -> Planted {
    Planted::sound().preparing(|input| input.frames.iter_mut().for_each(upside_down))
}

fn policy_with_shifted_gripper() -> Planted {
    Planted::sound().finishing(|actions| {
        actions.iter_mut().for_each(|action| action[6] = (action[6] + 1.0) / 2.0);
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_exit_code_is_0_or_1_and_the_output_fits_80_columns() {
    let (sound, flipped, never_opening) = (
        serve(Planted::sound()).await,
        serve(policy_with_flipped_frames()).await,
        serve(policy_with_shifted_gripper()).await,
    );
    let (sound, flipped) = (url(&sound), url(&flipped));
    let cases: [(&[&str], i32, &str, &str); 4] = [
        (&["compare", &sound, &sound], 0, "pass  the same", "the same"),
        (
            &["compare", &sound, &flipped],
            1,
            "FAIL  frame orientation: B answers as A does",
            "not the same",
        ),
        (&["doctor", &sound], 0, "pass  the gripper opens", "no fault found"),
        (
            &["doctor", &url(&never_opening), "--episodes", "3"],
            1,
            "FAIL  the gripper opens: its number",
            "faults found: see FAIL above",
        ),
    ];
    for (arguments, status, expected_line, last) in cases {
        let ended = run_to_end(arguments).await;
        let CommandOutput { stdout: printed, stderr, .. } = &ended;
        assert_eq!(ended.status, Some(status), "{printed}{stderr}");
        let lines: Vec<&str> = printed.lines().collect();
        assert!(lines.iter().any(|line| line.starts_with(expected_line)), "{printed}");
        assert_eq!(lines.last(), Some(&last), "{printed}");
        let widest = lines.iter().map(|line| line.chars().count()).max();
        assert!(widest <= Some(80), "{printed}");
    }
}

#[tokio::test]
async fn usage_errors_exit_with_2() {
    let invalid: [&[&str]; 4] = [
        &["compare", "builtin:noop"],
        &["compare", "builtin:noop", "http://h:1"],
        &["doctor", "builtin:noop", "--suite", "libero_90"],
        &["doctor", "builtin:noop", "--answer-within", "0"],
    ];
    for arguments in invalid {
        assert_eq!(run_to_end(arguments).await.status, Some(2), "{arguments:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn json_has_the_keys_that_are_documented() {
    let mut flipped = policy_with_flipped_frames();
    flipped.described.execute = 4;
    let (sound, flipped) = (serve(Planted::sound()).await, serve(flipped).await);
    let (sound, flipped) = (url(&sound), url(&flipped));
    let compare = ["compare", &sound, &flipped, "--json"];
    let doctor = ["doctor", &sound, "--episodes", "3", "--json"];
    for (arguments, command, verdict) in [
        (&compare[..], "policy-gateway compare", "is_same"),
        (&doctor[..], "policy-gateway doctor", "is_sound"),
    ] {
        let ended = run_to_end(arguments).await;
        let printed: Value = serde_json::from_str(&ended.stdout).expect("JSON");
        let mut found = BTreeSet::new();
        keys(&printed, "", &mut found);
        assert_eq!(found, documented(command));
        assert_eq!(printed[verdict], Value::Bool(ended.status == Some(0)));
    }
}

/// Records three episodes of two observations with noise in their frames.
async fn record(folder: &std::path::Path) {
    let server = serve(Planted::sound()).await;
    let route: RouteSpec = format!("x={}", url(&server)).parse().expect("a route");
    let record = Some(RecordInto { folder: folder.to_owned(), max_bytes: 1 << 30 });
    let (gateway, handle) = reloadable(vec![RouteSpec { record, ..route }]).await;
    let mut client = gateway.client().await;
    for session in ["one", "two", "three"] {
        client.reset(reset("x", session)).await.expect("an episode");
        for query_index in 0..2 {
            let key = u64::from(query_index) + session.len() as u64 * 7;
            let frame = |camera: &str, slot: u64| Image {
                camera: camera.to_owned(),
                width: SIDE as u32,
                height: SIDE as u32,
                rgb: (0..3 * (SIDE * SIDE) as u64)
                    .map(|index| (127.0 + 100.0 * hash(&[key, slot, index / 40])) as u8)
                    .collect::<Vec<u8>>()
                    .into(),
            };
            let reading = |field: StateField, values: &[f64]| StateReading {
                field: field.into(),
                values: values.to_vec(),
            };
            let shift = 0.1 * hash(&[key]);
            let observation = Observation {
                images: vec![frame("agentview", 0), frame("robot0_eye_in_hand", 1)],
                state: vec![
                    reading(StateField::EefPos, &[0.1 + shift, 0.2, 0.3 - shift]),
                    reading(StateField::EefAxisAngle, &[3.0, shift, 0.1]),
                    reading(StateField::GripperPos, &[0.03, -0.03]),
                ],
                privileged: None,
            };
            let query =
                InferRequest { observation: Some(observation), ..infer("x", session, query_index) };
            client.infer(query).await.expect("an answer");
        }
    }
    drop((client, handle));
    gateway.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn recorded_observations_replace_synthetic_observations() {
    let folder = tempfile::tempdir().expect("a folder");
    record(folder.path()).await;
    let recorded = folder.path().to_str().expect("UTF-8");
    let (sound, flipped) =
        (serve(Planted::sound()).await, serve(policy_with_flipped_frames()).await);
    let (sound, flipped) = (url(&sound), url(&flipped));
    let compared = run_to_end(&["compare", &sound, &flipped, "--recorded", recorded]).await;
    assert_eq!(compared.status, Some(1), "{}", compared.stderr);
    let words: Vec<&str> = compared.stdout.split_whitespace().collect();
    let words = words.join(" ");
    assert_contains(&words, &["frames flipped vertically", "to 6 observations"]);

    let joints = serve(Planted::sound().with_state(&[StateField::JointPos])).await;
    let lacking = run_to_end(&["doctor", &url(&joints), "--recorded", recorded]).await;
    assert_eq!(lacking.status, Some(1));
    assert!(lacking.stderr.contains("JOINT_POS"), "{}", lacking.stderr);
}

/// Text with control sequences that set a terminal's clipboard and reverse the reading direction.
const HOSTILE: &str = "a\u{202e}b\x1b]52;c;cm0gLXJm\x07c\r\u{9b}2K";

/// Returns a policy whose description and errors contain the text.
fn hostile() -> Scripted {
    let described = DescribeResponse {
        name: HOSTILE.to_owned(),
        checkpoint: HOSTILE.to_owned(),
        settings: vec![Setting { name: HOSTILE.to_owned(), value: HOSTILE.to_owned() }],
        ..description(HOSTILE, 1)
    };
    Scripted::new(described, |_| Err(Status::internal(HOSTILE)))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_command_prints_control_sequences() {
    let (hostile, sound) = (serve(hostile()).await, serve(Planted::sound()).await);
    let (hostile, sound) = (url(&hostile), url(&sound));
    let cases: [&[&str]; 3] =
        [&["check", &hostile], &["doctor", &hostile], &["compare", &sound, &hostile]];
    let mut printed = String::new();
    for arguments in cases {
        let ended = run_to_end(arguments).await;
        assert_eq!(ended.status, Some(1), "{arguments:?}: {}", ended.stderr);
        for text in [&ended.stdout, &ended.stderr] {
            let controls_terminal = |c: char| (c.is_control() && c != '\n') || c == '\u{202e}';
            assert!(!text.contains(controls_terminal), "{arguments:?}: {text:?}");
        }
        printed += &ended.stdout;
    }
    assert!(printed.contains("\u{fffd}]52;c;"), "the server's text is printed: {printed}");
}
