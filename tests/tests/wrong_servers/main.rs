//! Tests every client against unexpected servers: the message names the address, the finding and
//! the remedy, in this project's own words, and the client retries only if a retry can help.
//! Real programs on real sockets.

mod grpc;
mod servers;

use std::path::Path;
use std::process::Command;

use servers::{Authority, authority, coordinator, gateway, serve_text, unused_address};
use tests::phrases::raw_phrase;
use tests::programs::{Process, program};

/// Expected message of a client about a server.
struct Case {
    /// `HOST:PORT`.
    at: String,
    /// True if the client connects over TLS.
    is_encrypted: bool,
    /// Words of the finding and of the remedy.
    expected: Vec<&'static str>,
    /// True if the client must not retry.
    is_final: bool,
}

fn case(at: impl ToString, scheme: &str, is_final: bool, expected: &[&'static str]) -> Case {
    Case {
        at: at.to_string(),
        is_encrypted: scheme == "https",
        expected: expected.to_vec(),
        is_final,
    }
}

/// Returns cases that clients of any kind can meet.
fn cases_for_any_client() -> Vec<Case> {
    let mail = serve_text("220 mail.example ESMTP\r\n", "");
    let web = serve_text("", "HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n");
    vec![
        case(unused_address(), "http", false, &["nothing listens there", "start it"]),
        case("no-such-host.invalid:7411", "http", false, &["no address", "`no-such-host.invalid`"]),
        case(serve_text("SSH-2.0-OpenSSH_9.6\r\n", ""), "http", true, &["SSH server"]),
        case(mail, "http", true, &["\"220 mail.example ESMTP\""]),
        case(web, "http", true, &["web server", "HTTP/1.1 400 Bad Request"]),
        case(serve_text("", ""), "http", false, &["closes the connection or sends nothing"]),
        case(web, "https", true, &["does not use TLS"]),
    ]
}

/// Returns cases at servers of the right kind that use TLS, with the processes of the servers. The
/// host in the cases is a name, since the certificates are issued for names.
fn over_tls(
    serve: impl Fn([String; 4]) -> Process,
    trusted: &Authority,
) -> (Vec<Process>, Vec<Case>) {
    let untrusted = Authority::new();
    let processes = [
        trusted.arguments("localhost", 2099),
        untrusted.arguments("localhost", 2099),
        trusted.arguments("localhost", 2020),
        trusted.arguments("gpu-3.example", 2099),
        untrusted.own_arguments(),
    ]
    .map(serve);
    let at = |index: usize| {
        let (_, port) = authority(&processes[index])
            .rsplit_once(':')
            .map_or_else(|| panic!("a port"), |(host, port)| (host.to_owned(), port.to_owned()));
        format!("localhost:{port}")
    };
    let cases = vec![
        case(at(0), "http", true, &["uses TLS", "https://"]),
        case(at(1), "https", true, &["not signed by the authority", "ca"]),
        case(at(2), "https", true, &["expired", "days ago", "--tls-cert"]),
        case(at(3), "https", true, &["for gpu-3.example, not for `localhost`"]),
        case(at(4), "https", true, &["certificate"]),
    ];
    (processes.into(), cases)
}

/// Runs a client and checks its message.
fn check(client: &str, case: &Case, mut command: Command) {
    let output = command.output().expect("the program runs");
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).expect("UTF-8"));
    let text = text.concat();
    let context = format!("{client} at {}:\n{text}", case.at);
    assert!(!output.status.success(), "{context}");
    for words in case.expected.iter().chain([&&*case.at]) {
        assert!(text.contains(words), "no {words:?}: {context}");
    }
    assert_eq!(raw_phrase(&text), None, "{context}");
    if case.is_final {
        // Another program answers at the address: a coordinator cannot be started there.
        assert!(!text.contains("coordinator serve`"), "{context}");
        assert!(!text.contains("trying again"), "{context}");
    }
}

fn list_command(case: &Case, ca: &Path) -> Command {
    let scheme = if case.is_encrypted { "https" } else { "http" };
    let mut command = Command::new(program("coordinator"));
    let url = format!("{scheme}://{}", case.at);
    command.args(["campaign", "list", "--retry-secs", "0", "--connect", &url]);
    command.arg("--ca").arg(ca);
    command
}

/// Returns the command of a worker with simulated slots. `timeout` ends the worker after 10 s,
/// because it retries a temporary failure for ever.
fn worker_command(case: &Case, ca: &Path) -> Command {
    let scheme = if case.is_encrypted { "grpcs" } else { "grpc" };
    let mut command = Command::new("timeout");
    command.arg("10");
    let url = format!("{scheme}://{}", case.at);
    command.arg(program("worker")).args(["--connect", &url, "--assets", "primitives"]);
    command.arg("--slot-program").arg(program("simulated_slot"));
    command.arg("--ca").arg(ca);
    command
}

/// Returns true if this machine can run a worker; otherwise prints that workers are skipped.
fn has_sources() -> bool {
    let sources = scene::Sources::open(&scene::Sources::default_dir());
    if let Err(error) = &sources {
        println!("skipped the workers: failed to {error}");
    }
    sources.is_ok()
}

#[tokio::test(flavor = "multi_thread")]
async fn clients_of_a_coordinator_explain_unexpected_servers() {
    let data = tempfile::tempdir().expect("a temporary folder");
    let trusted = Authority::new();
    let other_server = gateway(&[]);
    let clear = coordinator(&data.path().join("clear"), &[]);
    let numbers = std::cell::Cell::new(0);
    let serve = |arguments: [String; 4]| {
        numbers.set(numbers.get() + 1);
        coordinator(&data.path().join(numbers.get().to_string()), &arguments)
    };
    let (_processes, encrypted) = over_tls(serve, &trusted);
    let mut servers = grpc::Servers::new();
    let client_cases = [
        case(
            authority(&other_server),
            "http",
            true,
            &["a policy server or policy-gateway is there", "--connect"],
        ),
        case(authority(&clear), "https", true, &["does not use TLS", "http://"]),
        case(grpc::serve_path("/none", &mut servers).await, "http", true, &["not a coordinator"]),
    ];
    let old = "/rollout.coordinator.v1.OperatorService/ListCampaigns";
    let old = case(grpc::serve_path(old, &mut servers).await, "http", true, &["same version"]);
    let cases = cases_for_any_client().into_iter().chain(encrypted).chain(client_cases);
    for case in cases {
        check("coordinator campaign list", &case, list_command(&case, &trusted.file()));
        if has_sources() {
            check("worker", &case, worker_command(&case, &trusted.file()));
        }
    }
    // The older server implements only the call that lists campaigns.
    let mut command = Command::new(program("coordinator"));
    command.args(["workers", "--connect", &format!("http://{}", old.at)]);
    check("coordinator workers", &old, command);
    if has_sources() {
        check("worker", &old, worker_command(&old, &trusted.file()));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn clients_of_a_policy_explain_unexpected_servers() {
    let data = tempfile::tempdir().expect("a temporary folder");
    let trusted = Authority::new();
    let other_server = coordinator(data.path(), &[]);
    let clear = gateway(&[]);
    let (_processes, encrypted) = over_tls(|arguments| gateway(&arguments), &trusted);
    let mut servers = grpc::Servers::new();
    let client_cases = [
        case(authority(&other_server), "http", true, &["a coordinator is there"]),
        case(authority(&clear), "https", true, &["does not use TLS"]),
        case(grpc::serve_path("/none", &mut servers).await, "http", true, &["not a policy server"]),
    ];
    for case in cases_for_any_client().into_iter().chain(encrypted).chain(client_cases) {
        let scheme = if case.is_encrypted { "https" } else { "grpc" };
        let url = format!("{scheme}://{}", case.at);
        let mut checking = Command::new(program("policy-gateway"));
        checking.args(["check", &url, "--ca"]).arg(trusted.file());
        check("policy-gateway check", &case, checking);

        let config = data.path().join("gateway.toml");
        let text = format!("[policy.x]\nreplicas = [{url:?}]\nca = {:?}\n", trusted.file());
        std::fs::write(&config, text).expect("written");
        let mut serving = Command::new(program("policy-gateway"));
        serving.args(["--listen", "127.0.0.1:0", "--config"]).arg(&config);
        let gateway = Process::serve(&mut serving);
        let mut indirect = Command::new(program("policy-gateway"));
        indirect.args(["check", &gateway.url]);
        check("policy-gateway check through a gateway", &case, indirect);

        if has_sources() {
            let mut rollout = Command::new(program("worker"));
            rollout.args(["rollout", "--id", "object/t0/clean/i00", "--assets", "primitives"]);
            rollout.args(["--endpoint", &url, "--ca"]).arg(trusted.file());
            rollout.arg("--no-video").arg("--output").arg(data.path().join("rollout"));
            check("worker rollout", &case, rollout);
        }
    }
}
