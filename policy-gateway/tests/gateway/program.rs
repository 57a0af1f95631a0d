//! The program itself: its line of output, its exit codes and its signals.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};

use proto::policy::policy_client::PolicyClient;
use tonic::Code;
use tonic::transport::Endpoint;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;
use transport::{ClientArguments, Role};

use crate::assertions::assert_refused;
use crate::support::{client, describe};

pub(crate) fn program(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_policy-gateway"));
    command.args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

pub(crate) fn listening(child: &mut Child) -> String {
    let mut line = String::new();
    let stdout = child.stdout.as_mut().expect("stdout is piped");
    BufReader::new(stdout).read_line(&mut line).expect("a line");
    let address = line.trim_end().strip_prefix("listening on ");
    address.expect("the announced line").to_owned()
}

pub(crate) fn address(child: &mut Child) -> SocketAddr {
    listening(child).parse().expect("an address")
}

// Two threads: the client must see the connection close while the test waits
// for the program to end.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_program_names_its_port_serves_and_stops_on_sigterm() {
    let mut child = program(&["--listen", "127.0.0.1:0", "--route", "noop=builtin:noop"])
        .spawn()
        .expect("the program starts");
    let address = address(&mut child);
    assert_ne!(address.port(), 0);
    let described = client(address).await.describe(describe("noop")).await.expect("a description");
    assert_eq!(described.get_ref().name, "noop");

    let killed = Command::new("kill").arg(child.id().to_string()).status().expect("kill runs");
    assert!(killed.success());
    assert!(child.wait().expect("the program ends").success());
}

// Two threads: the client's connection is served while the test waits for a line of the log.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sighup_reloads_the_configuration_unless_it_is_invalid() {
    let file = tempfile::NamedTempFile::new().expect("a file");
    let write = |text: &str| std::fs::write(file.path(), text).expect("written");
    write("[policy.stand]\nreplicas = [\"builtin:noop\"]");
    let path = file.path().to_str().expect("UTF-8");
    let mut child = program(&["--listen", "127.0.0.1:0", "--config", path])
        .spawn()
        .expect("the program starts");
    let mut client = client(address(&mut child)).await;
    let mut lines = BufReader::new(child.stderr.take().expect("stderr is piped")).lines();
    let pid = child.id().to_string();
    let mut hang_up = |expected: &str| {
        let sent = Command::new("kill").args(["-HUP", &pid]).status();
        assert!(sent.expect("kill runs").success());
        let line = lines.find(|line| line.as_ref().is_ok_and(|text| text.contains(expected)));
        let line = line.expect(expected).expect("UTF-8");
        assert!(!line.contains('\x1b'), "colours in a file: {line:?}");
    };

    write("[policy.stand]\nreplicas = [\"nobody\"]");
    hang_up("failed to use");
    client.describe(describe("stand")).await.expect("the earlier route");
    write("[policy.work]\nreplicas = [\"builtin:expert\"]");
    hang_up("again");
    client.describe(describe("work")).await.expect("the new route");

    child.kill().expect("the program runs");
    child.wait().expect("the program ends");
}

#[tokio::test]
async fn a_taken_port_is_named_and_the_exit_code_is_1() {
    let holder = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let taken = holder.local_addr().expect("a bound address").to_string();
    let output = program(&["--listen", &taken, "--route", "x=builtin:noop"])
        .output()
        .expect("the program runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains(&format!("failed to listen on {taken}")), "{stderr}");
}

#[test]
fn a_check_with_a_closed_pipe_exits_with_its_verdict() {
    let mut server = program(&["--listen", "127.0.0.1:0", "--route", "noop=builtin:noop"])
        .spawn()
        .expect("the program starts");
    let url = format!("grpc://{}", address(&mut server));
    let mut check =
        program(&["check", &url, "--suite", "libero_10"]).spawn().expect("the program starts");
    drop(check.stdout.take());
    let ended = check.wait().expect("the program ends");
    server.kill().expect("the program runs");
    server.wait().expect("the program ends");
    assert!(ended.success(), "{ended}");
}

fn token_file() -> tempfile::NamedTempFile {
    let file = tempfile::NamedTempFile::new().expect("a file");
    let tokens = "worker worker-secret-0123456789\nviewer viewer-secret-0123456789\n";
    std::fs::write(file.path(), tokens).expect("written");
    file
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_gateway_with_tokens_answers_workers_and_all_health_checks() {
    let tokens = token_file();
    let path = tokens.path().to_str().expect("UTF-8");
    let guarded = ["--listen", "127.0.0.1:0", "--route", "noop=builtin:noop"];
    let mut child = program(&[&guarded[..], &["--token-file", path]].concat())
        .spawn()
        .expect("the program starts");
    let address = address(&mut child);

    let refused = client(address).await.describe(describe("noop")).await;
    assert_refused(refused, Code::Unauthenticated, &[]);
    let endpoint = Endpoint::from_shared(format!("http://{address}")).expect("a URL");
    let health =
        HealthClient::new(endpoint.connect_lazy()).check(HealthCheckRequest::default()).await;
    health.expect("health is for everybody");

    let client_of = |role| {
        let arguments = ClientArguments { token_file: Some(tokens.path().to_owned()), ca: None };
        let access = arguments.access(&[role]).expect("a token");
        let connection = access.connect_lazy(endpoint.clone()).expect("no TLS");
        PolicyClient::new(connection)
    };
    let answered = client_of(Role::Worker).describe(describe("noop")).await;
    assert_eq!(answered.expect("a worker").get_ref().name, "noop");
    let refused = client_of(Role::Viewer).describe(describe("noop")).await;
    assert_refused(refused, Code::PermissionDenied, &[]);

    // A token file named in the environment is enough to check a policy.
    let url = format!("grpc://{address}");
    let checked = program(&["check", &format!("{url}/noop")])
        .env("ROLLOUT_TOKEN_FILE", path)
        .output()
        .expect("the program runs");
    let printed = String::from_utf8_lossy(&checked.stdout);
    assert!(printed.contains("pass  the description is consistent"), "{printed}");
    child.kill().expect("the program runs");
    child.wait().expect("the program ends");
}
