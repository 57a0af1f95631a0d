//! Command lines of all programs: exit codes as documented in docs/OPERATING.md, and options from
//! the environment.

use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Output, Stdio};

use tests::documents::folder::checkout;
use tests::programs::program;

const PROGRAMS: [&str; 3] = ["coordinator", "worker", "policy-gateway"];
/// An address at which no server listens.
const UNUSED_ADDRESS: &str = "127.0.0.1:9";

/// Returns a command whose environment has only `variables`, and the variables with the paths of
/// programs and libraries.
fn command(name: &str, arguments: &[&str], variables: &[(&str, &str)]) -> Command {
    let mut command = Command::new("timeout");
    command.args(["--signal=TERM", "60"]).arg(program(name));
    command.args(arguments);
    command.env_clear().env("PATH", std::env::var_os("PATH").expect("a path"));
    // The programs need these to find the build's libraries.
    for variable in ["HOME", "LD_LIBRARY_PATH"] {
        command.envs(std::env::var_os(variable).map(|value| (variable, value)));
    }
    command.envs(variables.iter().copied());
    command
}

fn run(name: &str, arguments: &[&str], variables: &[(&str, &str)]) -> Output {
    command(name, arguments, variables).output().expect("an output")
}

/// Runs a server until it listens, sends SIGTERM, and returns its output and exit code.
fn serve(name: &str, arguments: &[&str], variables: &[(&str, &str)]) -> (String, i32) {
    let mut command = command(name, arguments, variables);
    let mut child = command.stdout(Stdio::piped()).spawn().expect("a process");
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

/// Returns the exit codes in the table of docs/OPERATING.md.
fn documented_codes() -> Vec<i32> {
    let page = std::fs::read_to_string(checkout().join("docs/OPERATING.md")).expect("the page");
    let section = page.split("\n## ").find(|part| part.starts_with("Exit codes"));
    let rows = section.expect("the section").lines();
    let code = |row: &str| row.strip_prefix("| ")?.split(' ').next()?.parse().ok();
    rows.filter_map(code).collect()
}

#[test]
fn exit_codes_equal_the_documented_table() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (data, missing) = (path("data"), path("missing"));
    let manifest = path("manifest.jsonl");
    let url = format!("http://{UNUSED_ADDRESS}");
    let grpc = format!("grpc://{UNUSED_ADDRESS}");
    let expand = ["manifest", "expand", "--version", "v0.1", "--output", &manifest];
    let serves = ["serve", "--data", &data, "--listen", "127.0.0.1:0"];
    let (output, ended) = serve("coordinator", &serves, &[]);
    assert!(output.ends_with("stopped\n"), "{output}");
    let gateway = ["--listen", "127.0.0.1:0", "--route", "expert=builtin:expert"];
    let (_, gateway_ended) = serve("policy-gateway", &gateway, &[]);
    let mut found = vec![("coordinator serve".to_owned(), 0, ended)];
    found.push(("policy-gateway".to_owned(), 0, gateway_ended));
    let mut check = |code: i32, name: &str, arguments: &[&str]| {
        let output = run(name, arguments, &[]);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(code == 0 || !errors.is_empty(), "{name} {arguments:?}");
        let ended = output.status.code().expect("no signal ended it");
        found.push((format!("{name} {arguments:?}: {errors}"), code, ended));
    };
    for name in PROGRAMS {
        check(0, name, &["--version"]);
        check(0, name, &["--help"]);
        check(0, name, &["completions", "bash"]);
        check(2, name, &["--nonsense"]);
        check(2, name, &["nonsense"]);
        check(2, name, &["completions"]);
        check(2, name, &["completions", "no-shell"]);
    }
    check(0, "coordinator", &["check", &data]);
    check(0, "coordinator", &expand);
    check(0, "coordinator", &["manifest", "check", &manifest]);
    let empty = path("empty.jsonl");
    std::fs::write(&empty, "{}\n").expect("written");
    check(1, "coordinator", &["manifest", "check", &empty]);
    check(1, "coordinator", &["campaign", "list", "--connect", &url, "--retry-secs", "0"]);
    check(2, "coordinator", &["report", "--from", &missing]);
    check(2, "coordinator", &["manifest", "check", &missing]);
    check(2, "coordinator", &["check", &missing]);
    check(2, "coordinator", &[]);
    check(2, "coordinator", &["serve"]);
    check(2, "coordinator", &["serve", "--data", &data, "--listen", "0.0.0.0:0"]);
    check(2, "coordinator", &["campaign", "create", "--name", "a b"]);
    check(1, "worker", &["--connect", &url, "--assets", &missing]);
    check(1, "worker", &["bench", "--assets", &missing]);
    check(2, "worker", &[]);
    check(2, "worker", &["--connect", UNUSED_ADDRESS, "--assets", "primitives"]);
    check(1, "policy-gateway", &["compare", &grpc, &grpc]);
    check(1, "policy-gateway", &["--config", &missing]);
    check(2, "policy-gateway", &[]);
    check(2, "policy-gateway", &["--route", "nonsense"]);
    check(2, "policy-gateway", &[&gateway[2..], &["--listen", "0.0.0.0:0"]].concat());
    for (label, expected, code) in &found {
        assert_eq!(code, expected, "{label}");
    }
    let mut codes: Vec<i32> = found.iter().map(|(_, expected, _)| *expected).collect();
    codes.sort_unstable();
    codes.dedup();
    assert_eq!(documented_codes(), codes);
}

/// Returns the options in a program's help, each with its environment variable; `None` for an
/// option without a variable.
fn options(name: &str, words: &[&str]) -> Vec<(String, Option<String>)> {
    let help = run(name, &[words, &["--help"]].concat(), &[]);
    let help = String::from_utf8(help.stdout).expect("UTF-8");
    // The help of an option may span several lines, with line breaks anywhere. An option's first
    // line is indented by at most six columns, its text by more.
    let mut described: Vec<(String, String)> = Vec::new();
    for line in help.lines() {
        let indent = line.len() - line.trim_start().len();
        let mut words = line.split_whitespace().skip_while(|word| word.ends_with(','));
        let flag = words.next().and_then(|word| word.strip_prefix("--"));
        if let Some(flag) = flag.filter(|_| indent <= 6) {
            described.push((flag.to_owned(), String::new()));
        }
        if let Some((_, text)) = described.last_mut() {
            *text += " ";
            *text += line.trim();
        }
    }
    let variable = |text: &str| {
        let (_, rest) = text.split_once("[env: ")?;
        rest.split(['=', ']']).next().map(str::to_owned)
    };
    let options = described.into_iter();
    let options = options.map(|(flag, text)| (flag, variable(&text)));
    let mut options: Vec<(String, Option<String>)> = options.collect();
    options.retain(|(flag, _)| flag != "help" && flag != "version");
    assert!(options.len() > 5, "{name}: {help}");
    options
}

#[test]
fn every_server_option_has_a_variable_in_help_and_manual() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let manual = folder.path().to_str().expect("UTF-8");
    for (name, words, page) in [
        ("coordinator", &["serve"][..], "coordinator-serve.1"),
        ("worker", &[], "worker.1"),
        ("policy-gateway", &[], "policy-gateway.1"),
    ] {
        let output = run(name, &["manual", manual], &[]);
        assert!(output.status.success(), "{name}: no manual");
        let page = std::fs::read_to_string(folder.path().join(page)).expect("a page");
        for (flag, variable) in options(name, words) {
            let expected = match flag.as_str() {
                "connect" => "COORDINATOR_URL".to_owned(),
                flag => format!("ROLLOUT_{}", flag.replace('-', "_").to_uppercase()),
            };
            assert!(page.contains(&expected), "{expected} of {name}: {page}");
            assert_eq!(variable, Some(expected), "{name} --{flag}");
        }
    }
}

#[test]
fn server_options_come_from_the_environment_unless_the_command_line_sets_them() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (data, other) = (path("data"), path("other"));
    let variables =
        [("ROLLOUT_DATA", &*data), ("ROLLOUT_LISTEN", "127.0.0.1:0"), ("ROLLOUT_MIN_FREE_MIB", "")];
    let (output, code) = serve("coordinator", &["serve"], &variables);
    assert!(output.contains(&format!("data in {data}")), "{output}");
    assert_eq!(code, 0);
    let (output, _) = serve("coordinator", &["serve", "--data", &other], &variables);
    assert!(output.contains(&format!("data in {other}")), "{output}");

    let routes = "expert=builtin:expert;noop=builtin:noop";
    let variables = [("ROLLOUT_ROUTE", routes), ("ROLLOUT_LISTEN", "127.0.0.1:0")];
    let (output, code) = serve("policy-gateway", &[], &variables);
    assert!(output.starts_with("listening on 127.0.0.1:"), "{output}");
    assert_eq!(code, 0);

    let missing = path("missing");
    let variables = [
        ("COORDINATOR_URL", "http://127.0.0.1:9"),
        ("ROLLOUT_ASSETS", &*missing),
        ("ROLLOUT_SLOTS", "2"),
    ];
    let output = run("worker", &[], &variables);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains(&missing), "{stderr}");
}

#[test]
fn an_invalid_variable_is_refused_by_servers_and_ignored_by_other_commands() {
    for (name, arguments, variable, value) in [
        ("coordinator", &["serve", "--data", "d"][..], "ROLLOUT_LISTEN", "here"),
        ("coordinator", &["serve", "--data", "d"], "ROLLOUT_INSECURE", "perhaps"),
        ("worker", &["--connect", "http://h:1"], "ROLLOUT_SLOTS", "many"),
        ("policy-gateway", &["--listen", "127.0.0.1:0"], "ROLLOUT_ROUTE", "nonsense"),
    ] {
        let output = run(name, arguments, &[(variable, value)]);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        let named = format!("the value comes from the environment variable {variable}");
        assert!(stderr.contains(&named) && stderr.contains(value), "{stderr}");
    }
    // An error about a value on the command line does not name a variable.
    let arguments = ["serve", "--data", "d", "--listen", "there"];
    let output = run("coordinator", &arguments, &[("ROLLOUT_LISTEN", "127.0.0.1:0")]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(stderr.contains("there") && !stderr.contains("the environment"), "{stderr}");
    // Commands that lack these options ignore the variables, which a systemd unit may set.
    for (name, arguments) in [
        ("worker", &["assets", "list", "primitives"][..]),
        ("worker", &["completions", "bash"]),
        ("policy-gateway", &["completions", "bash"]),
        ("coordinator", &["completions", "bash"]),
    ] {
        let variables = ["LISTEN", "SLOTS", "ROUTE", "RENDERER", "INSECURE"];
        let variables = variables.map(|name| (format!("ROLLOUT_{name}"), "nonsense"));
        let variables = variables.each_ref().map(|(name, value)| (name.as_str(), *value));
        let output = run(name, arguments, &variables);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{name} {arguments:?}: {stderr}");
    }
}
