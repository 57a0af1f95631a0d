//! Every flag of every program with values that most flags refuse: each refusal is in this
//! project's own words. The flags are taken from the programs' help.

use std::path::Path;
use std::process::{Command, Output};

use tests::phrases::raw_phrase;
use tests::programs::program;

/// Values that most flags refuse.
const VALUES: [&str; 5] = ["", "0", "-1", "x y", "99999999999999999999"];
/// Options that keep a valid command from having any effect.
const HARMLESS: [(&str, &str); 4] = [
    ("--connect", "http://127.0.0.1:9"),
    ("--retry-secs", "0"),
    ("--hub", "http://127.0.0.1:9"),
    ("--listen", "192.0.2.1:1"),
];

/// A command of a program, and its flags.
struct CommandFlags {
    words: Vec<String>,
    /// Flags that take a value.
    flags: Vec<String>,
}

fn run(name: &str, arguments: &[&str], folder: &Path) -> Output {
    Command::new("timeout")
        .arg("60")
        .arg(program(name))
        .args(arguments)
        .current_dir(folder)
        .env("ROLLOUT_SOURCES", folder)
        .env_remove("COORDINATOR_URL")
        .env_remove("ROLLOUT_TOKENS")
        .output()
        .expect("the program runs")
}

/// Returns the commands of a program below a command, as its help lists them.
fn commands(name: &str, words: &[&str], folder: &Path) -> Vec<CommandFlags> {
    let help = run(name, &[words, &["--help"]].concat(), folder);
    let help = String::from_utf8(help.stdout).expect("UTF-8");
    let (mut found, mut flags, mut is_list) = (vec![], vec![], false);
    for line in help.lines() {
        if !line.starts_with(' ') {
            is_list = line == "Commands:";
        }
        let indent = line.len() - line.trim_start().len();
        let mut parts = line.split_whitespace().skip_while(|part| part.ends_with(','));
        let Some(first) = parts.next() else { continue };
        if is_list && indent == 2 && first != "help" {
            found.extend(commands(name, &[words, &[first]].concat(), folder));
        }
        let takes_value = parts.next().is_some_and(|next| next.starts_with('<'));
        if first.starts_with("--") && indent <= 6 && takes_value {
            flags.push(first.to_owned());
        }
    }
    found.push(CommandFlags { words: words.iter().map(ToString::to_string).collect(), flags });
    found
}

fn check(name: &str) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let commands = commands(name, &[], folder.path());
    let mut tried = 0;
    for command in &commands {
        for flag in &command.flags {
            for value in VALUES {
                let mut arguments: Vec<&str> = command.words.iter().map(String::as_str).collect();
                let argument = format!("{flag}={value}");
                arguments.push(&argument);
                for (other, harmless_value) in HARMLESS {
                    if flag != other && command.flags.iter().any(|known_flag| known_flag == other) {
                        arguments.extend([other, harmless_value]);
                    }
                }
                let output = run(name, &arguments, folder.path());
                let stderr = String::from_utf8_lossy(&output.stderr);
                let context = format!("{name} {arguments:?}: {stderr}");
                let code = output.status.code();
                assert!(code.is_some_and(|code| code < 3), "{code:?}: {context}");
                if code != Some(0) {
                    // The usage line follows the message and may repeat words.
                    let error = stderr.split("Usage:").next().unwrap_or_default();
                    assert_eq!(raw_phrase(error), None, "{context}");
                }
                tried += 1;
            }
        }
    }
    assert!(tried > 50, "few flags of {name} were found: {tried}");
}

#[test]
fn the_coordinator_refuses_wrong_values_in_its_own_words() {
    check("coordinator");
}

#[test]
fn the_worker_refuses_wrong_values_in_its_own_words() {
    check("worker");
}

#[test]
fn the_gateway_refuses_wrong_values_in_its_own_words() {
    check("policy-gateway");
}

#[test]
fn a_range_is_named_with_its_ends_and_its_unit() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let cases: [(&str, &[&str], &str); 10] = [
        ("coordinator", &["serve", "--lease-secs", "0"], "seconds, 1 to 3600"),
        ("coordinator", &["serve", "--min-free-mib", "x"], "whole number of MiB"),
        ("coordinator", &["jobs", "list", "c", "--limit", "0"], "rollouts, 1 or more"),
        ("coordinator", &["campaign", "list", "--retry-secs=-1"], "seconds, 0 to"),
        ("worker", &["preview", "--task", "10"], "a whole number, 0 to 9"),
        ("worker", &["preview", "--config", "10"], "a whole number, 0 to 9"),
        ("worker", &["bench", "--execute", "0"], "control steps, 1 to 1000"),
        ("worker", &["--slots", "0"], "slots, 1 or more"),
        ("policy-gateway", &["record", "--max-mib", "0"], "MiB, 1 to"),
        ("policy-gateway", &["--listen", "localhost"], "127.0.0.1:7411"),
    ];
    for (name, arguments, expected) in cases {
        let output = run(name, arguments, folder.path());
        let stderr = String::from_utf8_lossy(&output.stderr);
        let flat = stderr.split_whitespace().collect::<Vec<_>>().join(" ");
        assert_eq!(output.status.code(), Some(2), "{name} {arguments:?}: {stderr}");
        assert!(flat.contains(expected), "{name} {arguments:?}: {stderr}");
    }
}
