//! Policy servers with TLS and tokens: a gateway with valid credentials is accepted, invalid
//! credentials are reported with a remedy, and no credential is logged. The server is the real
//! program.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use policy_gateway::config;
use tonic::{Code, Status};

use crate::assertions::assert_refused;
use crate::authority::{Authority, write_private};
use crate::program::{listening, program};
use crate::support::{infer, reloadable, reset};

const TOKEN: &str = "worker-secret-0123456789";
const WRONG: &str = "wrong-secret-0123456789";

fn authority() -> Authority {
    let authority = Authority::new();
    write_private(&authority.path("token"), &format!("worker {TOKEN}\n"));
    authority
}

/// Starts a server with a certificate that is valid to the end of a year.
fn serve(authority: &Authority, until_year: i32) -> Server {
    let mut child = program(&["--listen", "127.0.0.1:0", "--route", "noop=builtin:noop"])
        .args(authority.sign(until_year))
        .arg("--token-file")
        .arg(authority.path("token"))
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let line = listening(&mut child);
    let address = line.split_whitespace().next().expect("an address");
    let port = address.rsplit(':').next().expect("a port").to_owned();
    Server { child, port }
}

struct Server {
    child: Child,
    port: String,
}

impl Server {
    /// Stops the server and returns its log.
    fn log(mut self) -> String {
        self.child.kill().expect("the program runs");
        self.child.wait().expect("the program ends");
        let mut log = String::new();
        let stderr = self.child.stderr.take().expect("stderr is piped");
        { stderr }.read_to_string(&mut log).expect("UTF-8");
        log
    }
}

async fn send_query(server: &Server, ca: &Path, token_file: &Path) -> Result<(), Status> {
    send_query_over("https", server, ca, token_file).await
}

async fn send_query_over(
    scheme: &str,
    server: &Server,
    ca: &Path,
    token_file: &Path,
) -> Result<(), Status> {
    let file = tempfile::NamedTempFile::new().expect("a file");
    let text = format!(
        "[policy.x]\nreplicas = [\"{scheme}://localhost:{}\"]\nca = {ca:?}\n\
         token_file = {token_file:?}\n",
        server.port
    );
    std::fs::write(file.path(), text).expect("written");
    let config = config::read(file.path()).expect("a configuration");
    let (gateway, _) = reloadable(config.routes().to_vec()).await;
    let mut client = gateway.client().await;
    client.reset(reset("x", "s")).await?;
    client.infer(infer("x", "s", 0)).await.map(drop)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_tls_server_accepts_valid_credentials_and_invalid_ones_are_named() {
    let authority = authority();
    let server = serve(&authority, 2099);
    let (ca, token) = (authority.path("ca.pem"), authority.path("token"));
    send_query(&server, &ca, &token).await.expect("valid credentials");

    write_private(&authority.path("other-token"), &format!("worker {WRONG}\n"));
    let refused = send_query(&server, &ca, &authority.path("other-token")).await;
    let refused = refused.expect_err("a token that the server does not know");
    assert_eq!(refused.code(), Code::Unavailable);
    assert!(refused.message().contains("`token_file`"), "{refused}");
    assert!(!refused.message().contains(WRONG), "{refused}");

    let other = Authority::new();
    assert_refused(
        send_query(&server, &other.path("ca.pem"), &token).await,
        Code::Unavailable,
        &["invalid peer certificate", "`ca` of the policy"],
    );
    let log = server.log();
    assert!(!log.contains(TOKEN) && !log.contains(WRONG), "{log}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_expired_certificate_is_named() {
    let authority = authority();
    let server = serve(&authority, 2020);
    let expired = send_query(&server, &authority.path("ca.pem"), &authority.path("token")).await;
    let expired = expired.expect_err("expired");
    assert_eq!(expired.code(), Code::Unavailable);
    let text = expired.message();
    assert!(text.contains("expired") && text.contains("--tls-cert"), "{text}");
    drop(server.log());
}

/// The server has no WebSocket, so a trusted connection fails after the TLS handshake, and an
/// untrusted connection fails during the handshake.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_websocket_server_is_trusted_only_if_the_given_authority_signed_its_certificate() {
    let authority = authority();
    let server = serve(&authority, 2099);
    let (ca, token) = (authority.path("ca.pem"), authority.path("token"));
    let other = Authority::new();
    let other_ca = other.path("ca.pem");
    for scheme in ["wss", "vla-evals"] {
        let untrusted = send_query_over(scheme, &server, &other_ca, &token).await;
        let untrusted = untrusted.expect_err("another authority");
        assert!(untrusted.message().contains("invalid peer certificate"), "{untrusted}");
        assert_refused(
            send_query_over(scheme, &server, &ca, &token).await,
            Code::Unavailable,
            &["cannot reach"],
        );
    }
    drop(server.log());
}

/// A program of another user that listens on a free port of the loopback and counts the bytes
/// that it receives.
const STRANGER: &str = "
import os, socket
os.setuid(4242)
listener = socket.create_server(('127.0.0.1', 0))
print('listening on 127.0.0.1:%d' % listener.getsockname()[1], flush=True)
while True:
    if connection := listener.accept()[0]:
        print('got', len(connection.recv(1000)), flush=True)
";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_token_is_sent_in_the_clear_to_a_server_of_another_user() {
    if !is_root() {
        println!("skipped: only root starts programs as another user");
        return;
    }
    let authority = authority();
    let mut child = Command::new("python3")
        .args(["-c", STRANGER])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("python3 runs");
    let mut stdout = BufReader::new(child.stdout.take().expect("stdout is piped"));
    let mut line = String::new();
    stdout.read_line(&mut line).expect("a line");
    let port = line.trim_end().rsplit(':').next().expect("a port").to_owned();
    let server = Server { child, port };
    for scheme in ["grpc", "ws", "vla-eval"] {
        let (ca, token) = (authority.path("ca.pem"), authority.path("token"));
        assert_refused(
            send_query_over(scheme, &server, &ca, &token).await,
            Code::Unavailable,
            &["another user of this machine listens there", "use TLS"],
        );
        let mut received = String::new();
        stdout.read_line(&mut received).expect("a line");
        assert_eq!(received.trim_end(), "got 0", "{scheme}");
    }
    drop(server.log());
}

fn is_root() -> bool {
    let owner = std::fs::metadata("/proc/self").expect("a process");
    std::os::unix::fs::MetadataExt::uid(&owner) == 0
}
