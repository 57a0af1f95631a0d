//! Tests that systemd, Kubernetes and the programs accept the files of `deploy`.

mod kubernetes;
mod systemd;

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::process::Command;

use tests::documents::folder::checkout;
use tests::programs::program;

fn folder(name: &str) -> PathBuf {
    checkout().join("deploy").join(name)
}

fn runs(tool: &str, argument: &str) -> bool {
    Command::new(tool).arg(argument).output().is_ok()
}

/// Seconds that a worker needs, after its time to drain, to give back unfinished rollouts.
const GIVE_BACK_SECS: u32 = 30;

/// Returns the help of a command line's program. The first word is the program; a second
/// word without dashes is its command.
fn help(words: &[String]) -> String {
    let (name, arguments) = words.split_first().expect("a program");
    let mut help = Command::new(program(name));
    help.env_clear();
    let command = arguments.first().filter(|word| !word.starts_with('-'));
    let output = help.args(command).arg("--help").output().expect("help");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn unknown_flags(words: &[String]) -> Vec<String> {
    let (name, arguments) = words.split_first().expect("a program");
    let help = help(words);
    let known: BTreeSet<&str> = help
        .split(|character: char| !character.is_ascii_alphanumeric() && character != '-')
        .filter(|word| word.starts_with("--"))
        .collect();
    assert!(known.contains("--help"), "{name}: {help}");
    let flags = arguments.iter().filter(|word| word.starts_with("--"));
    let flags = flags.map(|word| word.split_once('=').map_or(word.as_str(), |(flag, _)| flag));
    let unknown = flags.filter(|flag| !known.contains(flag));
    unknown.map(|flag| format!("{name}: {flag}")).collect()
}
