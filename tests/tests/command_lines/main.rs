//! Command lines of all programs: each command's help, and its output and exit code on wrong input,
//! as snapshots in the folder `snapshots`, a file a case. After a change of words,
//! `INSTA_UPDATE=always INSTA_FORCE_PASS=1 cargo nextest run -p tests --test command_lines` writes
//! them again, for the reviewer to read as a diff.

#[path = "../../../coordinator/tests/it/authority.rs"]
mod authority;
mod errors;
mod wrong_servers;

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};

use tests::programs::program;

const PROGRAMS: [&str; 3] = ["coordinator", "worker", "policy-gateway"];
/// An address at which no server listens.
const UNUSED_ADDRESS: &str = "127.0.0.1:9";

/// Returns a command in a folder, whose environment has only the paths of programs and libraries.
fn command(name: &str, arguments: &[&str], folder: &Path) -> Command {
    let mut command = Command::new("timeout");
    command.args(["--signal=TERM", "60"]).arg(program(name)).args(arguments);
    command.current_dir(folder).env_clear().env("HOME", folder);
    command.env("PATH", std::env::var_os("PATH").expect("a path"));
    // The programs need it to find the build's libraries.
    let libraries = std::env::var_os("LD_LIBRARY_PATH");
    command.envs(libraries.map(|folders| ("LD_LIBRARY_PATH", folders)));
    command
}

/// Runs a command, and returns its arguments, exit code and output, with the folder's path
/// replaced.
fn session(name: &str, arguments: &[&str], variables: &[(&str, &str)], folder: &Path) -> String {
    let mut command = command(name, arguments, folder);
    let output = command.envs(variables.iter().copied()).output().expect("an output");
    let code = output.status.code().expect("no signal ended it");
    assert!(code < 3, "{name} {arguments:?} ended with {code}: {output:?}");
    let printed =
        [output.stdout, output.stderr].map(|text| String::from_utf8(text).expect("UTF-8"));
    let variables = variables.iter().map(|(name, value)| format!("{name}={value} "));
    let line = [&[name], arguments].concat().join(" ");
    let text = format!("$ {}{line}\n{}", variables.collect::<String>(), printed.concat());
    let text = text.replace(&folder.display().to_string(), "[folder]");
    match code {
        0 => text,
        code => format!("{text}[exit code {code}]\n"),
    }
}

fn compare(name: &str, text: &str) {
    let mut settings = insta::Settings::clone_current();
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.bind(|| insta::assert_snapshot!(name, text));
}

/// Collects the help of a command and of all commands below it, in files named after them.
fn help(name: &str, words: &[&str], folder: &Path, pages: &mut Vec<(String, String)>) {
    let text = session(name, &[words, &["--help"]].concat(), &[], folder);
    let commands = text.split_once("\nCommands:\n").map_or("", |(_, commands)| commands);
    let commands = commands.lines().take_while(|line| !line.is_empty());
    let starts = commands.filter_map(|line| line.strip_prefix("  "));
    for word in starts.filter_map(|line| line.split(' ').next()) {
        if !["", "help"].contains(&word) {
            help(name, &[words, &[word]].concat(), folder, pages);
        }
    }
    pages.push(([&["help", name], words].concat().join("-"), text));
}

#[test]
fn every_command_has_the_reviewed_help() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut pages = Vec::new();
    for name in PROGRAMS {
        help(name, &[], folder.path(), &mut pages);
    }
    assert!(pages.len() > 30, "{} commands", pages.len());
    pages.iter().for_each(|(name, text)| compare(name, text));
}

/// Runs a server until it listens, sends SIGTERM, and returns its output and exit code.
fn serve(name: &str, words: &[&str], variables: &[(&str, &str)], folder: &Path) -> (String, i32) {
    let mut command = command(name, words, folder);
    let mut child =
        command.envs(variables.iter().copied()).stdout(Stdio::piped()).spawn().expect("a process");
    let mut out = BufReader::new(child.stdout.take().expect("piped"));
    let mut output = String::new();
    out.read_line(&mut output).expect("a line");
    // `timeout` forwards the signal.
    let id = child.id().to_string();
    assert!(Command::new("kill").args(["-TERM", &id]).status().expect("kill").success());
    out.read_to_string(&mut output).expect("the rest");
    let code = child.wait().expect("an exit status").code();
    (output, code.expect("no signal ended it"))
}

#[test]
fn server_options_come_from_the_environment_unless_the_command_line_sets_them() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let variables =
        [("ROLLOUT_DATA", "data"), ("ROLLOUT_LISTEN", "127.0.0.1:0"), ("ROLLOUT_MIN_FREE_MIB", "")];
    for (words, data) in [(&["serve"][..], "data"), (&["serve", "--data", "other"], "other")] {
        let (output, code) = serve("coordinator", words, &variables, folder.path());
        assert!(output.contains(&format!("data in {data}")), "{output}");
        assert!(output.ends_with("stopped\n"), "{output}");
        assert_eq!(code, 0, "a server that is asked to stop succeeds");
    }
    let routes = "expert=builtin:expert;noop=builtin:noop";
    let variables = [("ROLLOUT_ROUTE", routes), ("ROLLOUT_LISTEN", "127.0.0.1:0")];
    let (output, code) = serve("policy-gateway", &[], &variables, folder.path());
    assert!(output.starts_with("listening on 127.0.0.1:"), "{output}");
    assert_eq!(code, 0);
}
