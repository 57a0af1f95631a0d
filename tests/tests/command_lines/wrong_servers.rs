//! Clients against unexpected servers: the message names the address, the finding and the remedy,
//! and the client retries only if a retry can help. Real programs on real sockets.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::process::Command;
use std::thread;

use tests::programs::{Process, program};

use crate::authority::Authority;
use crate::compare;

fn unused_address() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("an address")
}

/// Starts a server that answers each connection by a text, or, if it is empty, closes it at once.
fn serve_text(answer: &'static str) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("an address");
    // Ends with the test's process.
    thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            if !answer.is_empty() {
                let _ = stream.read(&mut [0; 4096]);
                let _ = stream.write_all(answer.as_bytes());
            }
        }
    });
    address
}

fn coordinator(data: &Path, arguments: &[String]) -> Process {
    let mut command = Command::new(program("coordinator"));
    command.args(["serve", "--listen", "127.0.0.1:0", "--data"]);
    Process::serve(command.arg(data).args(arguments))
}

fn gateway(arguments: &[String]) -> Process {
    let mut command = Command::new(program("policy-gateway"));
    command.args(["--listen", "127.0.0.1:0", "--route", "noop=builtin:noop"]);
    Process::serve(command.args(arguments))
}

/// Returns `host:port` of a server's URL.
fn host_port(process: &Process) -> String {
    process.url.trim_start_matches("http://").to_owned()
}

/// Beginning of the error about a server that does not answer; the reason follows it.
const NO_ANSWER: &str = "no answer came from it (";

struct Case {
    name: &'static str,
    /// `HOST:PORT`.
    at: String,
    scheme: &'static str,
}

fn case(name: &'static str, scheme: &'static str, at: impl ToString) -> Case {
    Case { name, at: at.to_string(), scheme }
}

fn cases_for_any_client() -> Vec<Case> {
    let web = serve_text("HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n");
    vec![
        case("nothing", "http", unused_address()),
        case("an unknown host", "http", "no-such-host.invalid:7411"),
        case("a web server", "http", web),
        case("a server that closes every connection", "http", serve_text("")),
        case("a web server without TLS", "https", web),
    ]
}

/// Returns cases at servers of the right kind that use TLS, with the processes of the servers. The
/// host in the cases is a name, since the certificates are issued for names.
fn over_tls(
    serve: impl Fn([String; 4]) -> Process,
    trusted: &Authority,
) -> (Vec<Process>, Vec<Case>) {
    let untrusted = Authority::new();
    let servers = [
        ("a server with TLS", "http", trusted.sign(2099)),
        ("a certificate of another authority", "https", untrusted.sign(2099)),
    ];
    let pair = |(name, scheme, arguments)| {
        let process = serve(arguments);
        let url = host_port(&process);
        let (_, port) = url.rsplit_once(':').expect("a port");
        let case = case(name, scheme, format!("localhost:{port}"));
        (process, case)
    };
    servers.map(pair).into_iter().unzip()
}

/// Runs a client in every case, and returns what it prints, with the addresses replaced.
fn sessions(cases: &[Case], client: impl Fn(&str) -> Command) -> String {
    let mut sessions = String::new();
    for case in cases {
        let output = client(&format!("{}://{}", case.scheme, case.at)).output();
        let output = output.expect("the program runs");
        let printed = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
        let text = printed.concat();
        assert_eq!(output.status.code(), Some(1), "{}: {text}", case.name);
        assert!(text.contains(&case.at), "the address is missing: {text}");
        let (host, port) = case.at.rsplit_once(':').expect("a port");
        let text = text.replace(&case.at, &format!("{host}:[port]")).replace(port, "[port]");
        // The network's own words depend on the machine, and on the moment of the end.
        let text =
            match text.split_once(NO_ANSWER).map(|(start, rest)| (start, rest.split_once(')'))) {
                Some((start, Some((_, rest)))) => format!("{start}{NO_ANSWER}[reason]){rest}"),
                _ => text,
            };
        sessions.push_str(&format!("{}, called as {}://:\n{text}\n", case.name, case.scheme));
    }
    sessions
}

/// Returns the command of a worker with simulated slots, which `timeout` ends after 10 s with the
/// exit code 124, because it retries a temporary failure for ever.
fn worker(url: &str, ca: &Path) -> Command {
    let mut command = Command::new("timeout");
    command.arg("10").arg(program("worker"));
    command.args(["--connect", url, "--assets", "primitives"]);
    command.arg("--slot-program").arg(program("simulated_slot")).arg("--ca").arg(ca);
    command
}

#[test]
fn clients_of_a_coordinator_explain_unexpected_servers() {
    let data = tempfile::tempdir().expect("a temporary folder");
    let trusted = Authority::new();
    let other_server = gateway(&[]);
    let numbers = std::cell::Cell::new(0);
    let serve = |arguments: [String; 4]| {
        numbers.set(numbers.get() + 1);
        coordinator(&data.path().join(numbers.get().to_string()), &arguments)
    };
    let (_processes, encrypted) = over_tls(serve, &trusted);
    let mut cases = cases_for_any_client();
    cases.extend(encrypted);
    cases.push(case("a policy server", "http", host_port(&other_server)));
    let client = |url: &str| {
        let mut command = Command::new(program("coordinator"));
        command.args(["campaign", "status", "--retry-secs", "0", "--connect", url, "--ca"]);
        command.arg(trusted.path("ca.pem"));
        command
    };
    compare("server-coordinator", &sessions(&cases, client));

    let sources = scene::Sources::open(&scene::Sources::default_dir());
    if let Err(error) = &sources {
        println!("skipped the worker: failed to {error}");
        return;
    }
    for case in &cases {
        let final_faults =
            ["a web server without TLS", "a certificate of another authority", "a policy server"];
        let expected = if final_faults.contains(&case.name) { 1 } else { 124 };
        let url = format!("{}://{}", case.scheme, case.at);
        let output = worker(&url, &trusted.path("ca.pem")).output().expect("the program runs");
        assert_eq!(output.status.code(), Some(expected), "{}: {output:?}", case.name);
    }
}

#[test]
fn clients_of_a_policy_explain_unexpected_servers() {
    let data = tempfile::tempdir().expect("a temporary folder");
    let trusted = Authority::new();
    let other_server = coordinator(data.path(), &[]);
    let (_processes, encrypted) = over_tls(|arguments| gateway(&arguments), &trusted);
    let mut cases = cases_for_any_client();
    cases.extend(encrypted);
    cases.push(case("a coordinator", "http", host_port(&other_server)));
    let found = sessions(&cases, |url| {
        let mut command = Command::new(program("policy-gateway"));
        command
            .args(["check", &url.replacen("http://", "grpc://", 1), "--ca"])
            .arg(trusted.path("ca.pem"));
        command
    });
    compare("server-policy", &found);
}
