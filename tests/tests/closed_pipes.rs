//! Output whose reader has exited, as with `| head`: every command that prints succeeds and reports
//! no error.

use std::io::pipe;
use std::process::{Command, Stdio};

use tests::programs::{Campaigns, program};

fn check(name: &str, arguments: &[&str]) {
    let (reader, writer) = pipe().expect("a pipe");
    drop(reader);
    let output = Command::new(program(name))
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(writer)
        .stderr(Stdio::piped())
        .output()
        .expect("the program runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{name} {arguments:?}: {stderr}");
    // `ipe` is part of `pipe` and of `Pipe`.
    for words in ["ipe", "panicked", "failed"] {
        assert!(!stderr.contains(words), "{name} {arguments:?}: {stderr}");
    }
}

#[test]
fn a_command_with_a_closed_pipe_reports_no_error() {
    let data = tempfile::tempdir().expect("a temporary folder");
    let campaigns = Campaigns::start(data.path());
    campaigns.create("first", "noop", "libero_object/0", "0-9");
    let connect = ["--connect", &campaigns.coordinator.url];
    let examples = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/openvla_oft");
    let copy = data.path().join("copy.sqlite");
    let copy = copy.to_str().expect("UTF-8");
    let job = "object/t0/camera/L3/c00";
    for arguments in [
        &["campaign", "status"][..],
        &["campaign", "status"],
        &["campaign", "status", "first"],
        &["campaign", "pause", "first"],
        &["campaign", "resume", "first"],
        &["jobs", "first"],
        &["jobs", "first", job],
        &["jobs", "first", "--retry"],
        &["workers"],
        &["report", "first"],
        &["report", "first", "--json"],
        &["report", "first", examples],
        &["export", "first", "--format", "jsonl"],
        &["backup", "--output", copy],
    ] {
        check("coordinator", &[arguments, &connect].concat());
    }
    check("coordinator", &["check", copy]);
    check("coordinator", &["manifest", "--version", "v0.1"]);
    let noop = format!("{}/noop", campaigns.gateway.url.replacen("http://", "grpc://", 1));
    check("policy-gateway", &["check", &noop]);
    if let Err(error) = scene::Sources::open(&scene::Sources::default_dir()) {
        println!("skipped the worker: failed to {error}");
        return;
    }
    check("worker", &["assets"]);
}
