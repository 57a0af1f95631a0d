//! `check` and `compare` as programs: their output and their exit codes.

use std::collections::BTreeSet;

use proto::policy::{DescribeResponse, Setting};
use serde_json::Value;
use tonic::Status;

use crate::json_keys::{documented, keys};
use crate::planted::{Planted, upside_down};
use crate::program::program;
use crate::support::{Running, Scripted, description, gateway, serve};

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
    // A gateway checks versions, which a planted policy does not.
    let routes = [("sound", &sound), ("shifted", &never_opening)];
    let routes = routes.map(|(name, server)| format!("{name}={}", url(server)));
    let gateway = gateway(&[&routes[0], &routes[1]]).await;
    let (sound, flipped) = (format!("{}/sound", url(&gateway)), url(&flipped));
    let never_opening = format!("{}/shifted", url(&gateway));
    let cases: [(&[&str], i32, &str, &str); 4] = [
        (&["compare", &sound, &sound], 0, "pass  the same", "the same"),
        (
            &["compare", &sound, &flipped],
            1,
            "FAIL  frame orientation: B answers as A does",
            "not the same",
        ),
        (&["check", &sound], 0, "pass  the gripper opens", "conforms"),
        (
            &["check", &never_opening],
            0,
            "warn  the gripper opens: its number",
            "conforms; see the warnings if no rollout succeeds",
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
    let invalid: [&[&str]; 3] = [
        &["compare", "builtin:noop"],
        &["compare", "builtin:noop", "http://h:1"],
        &["check", "builtin:noop", "--suite", "libero_90"],
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
    let check = ["check", "builtin:noop", "--json"];
    for (arguments, command, verdict) in [
        (&compare[..], "policy-gateway compare", "is_same"),
        (&check[..], "policy-gateway check", "conforms"),
    ] {
        let ended = run_to_end(arguments).await;
        let printed: Value = serde_json::from_str(&ended.stdout).expect("JSON");
        let mut found = BTreeSet::new();
        keys(&printed, "", &mut found);
        assert_eq!(found, documented(command));
        assert_eq!(printed[verdict], Value::Bool(ended.status == Some(0)));
    }
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
    let cases: [&[&str]; 2] = [&["check", &hostile], &["compare", &sound, &hostile]];
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
