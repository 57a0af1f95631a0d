//! systemd units.

use std::fs;
use std::path::Path;
use std::process::Command;

use tests::programs::program;

use super::{GIVE_BACK_SECS, folder, help, runs, unknown_flags};

const UNITS: [(&str, &str); 3] = [
    ("rollout-coordinator.service", "coordinator"),
    ("rollout-gateway.service", "policy-gateway"),
    ("rollout-worker.service", "worker"),
];

fn unit(name: &str) -> String {
    fs::read_to_string(folder("systemd").join(name)).expect("a unit")
}

fn warnings(units: &[(&str, String)]) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let paths = units.iter().map(|(name, text)| {
        let path = folder.path().join(name);
        fs::write(&path, text).expect("a unit");
        path
    });
    let mut verify = Command::new("systemd-analyze");
    verify.args(["verify", "--man=no"]).args(paths);
    let output = verify.output().expect("systemd-analyze runs");
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    // systemd may also warn about this machine's own units.
    stderr.lines().filter(|line| line.contains("rollout-")).collect()
}

/// Returns the text of a unit, with the program that was built for the tests.
fn unit_with_test_program(name: &str, program_name: &str) -> String {
    let installed = format!("/usr/local/bin/{program_name}");
    let text = unit(name);
    assert_eq!(text.matches(&installed).count(), 1, "{name}");
    text.replace(&installed, &program(program_name).display().to_string())
}

#[test]
fn systemd_accepts_the_units() {
    if !runs("systemd-analyze", "--version") {
        println!("skipped systemd_accepts_the_units: no systemd-analyze");
        return;
    }
    let units = UNITS.map(|(name, program)| (name, unit_with_test_program(name, program)));
    assert_eq!(warnings(&units), "");
    // An unknown setting is reported.
    let (name, program) = UNITS[2];
    let wrong = unit_with_test_program(name, program).replace("KillMode", "KilMode");
    assert!(warnings(&[(name, wrong)]).contains("KilMode"));
}

/// Returns the values of a setting, in the order of its lines.
fn values<'a>(unit: &'a str, setting: &str) -> Vec<&'a str> {
    let lines = unit.lines();
    lines.filter_map(|line| line.strip_prefix(setting)).collect()
}

#[test]
fn units_use_only_flags_and_variables_that_programs_have() {
    for (name, program) in UNITS {
        let text = unit(name);
        let started = values(&text, "ExecStart=").concat();
        let mut words: Vec<String> = started.split_whitespace().map(str::to_owned).collect();
        assert!(Path::new(&words[0]).ends_with(program), "{name}: {words:?}");
        words[0] = program.to_owned();
        assert_eq!(unknown_flags(&words), [""; 0], "{name}");
        // Line breaks in the help may be anywhere.
        let help = help(&words).split_whitespace().collect::<Vec<_>>().join(" ");
        let set = values(&text, "Environment=");
        assert!(!set.is_empty(), "{name}");
        for variable in set {
            let variable = variable.split('=').next().expect("a name");
            // The variable follows a general convention; the programs have no option for it.
            if variable == "XDG_CACHE_HOME" {
                continue;
            }
            assert!(help.contains(&format!("[env: {variable}=")), "{name}: {variable}");
        }
    }
}

#[test]
fn server_units_allow_the_open_files_that_programs_request() {
    // Upper limit of `transport::raise_file_limit`.
    for (name, _) in &UNITS[..2] {
        assert_eq!(values(&unit(name), "LimitNOFILE="), ["65536"], "{name}");
    }
}

#[test]
fn a_worker_has_given_back_its_rollouts_before_it_is_killed() {
    let text = unit("rollout-worker.service");
    let number = |setting| -> u32 { values(&text, setting).concat().parse().expect("seconds") };
    let (drain, killed) = (number("Environment=ROLLOUT_DRAIN_SECS="), number("TimeoutStopSec="));
    assert!(drain + GIVE_BACK_SECS <= killed, "{drain} of {killed} s");
}
