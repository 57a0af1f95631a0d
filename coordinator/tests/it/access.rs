//! Refused callers: without a token, with a wrong token or the token of another role, with messages
//! or names that are too long, and clients that cannot trust the coordinator's certificate. Runs
//! the real program on real sockets. Refusals leave the database's rows unchanged.

use std::fs::{File, Permissions};
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use proto::coordinator as wire;
use proto::coordinator::operator_service_client::OperatorServiceClient;
use proto::coordinator::worker_service_client::WorkerServiceClient;
use tempfile::TempDir;
use tonic::codegen::InterceptedService;
use tonic::transport::Channel;
use tonic::{Code, Request, Status};

use crate::assertions::{assert_contains, assert_refused};
use crate::authority::{Authority, write_private};
use crate::harness::{registration, rows, small_spec};
use crate::process::{Serve, coordinator, fail, succeed, text};

pub(crate) const WORKER: &str = "worker-secret-0123456789";
pub(crate) const OPERATOR: &str = "operator-secret-0123456789";
pub(crate) const VIEWER: &str = "viewer-secret-0123456789";
/// Length of an oversized name, characters.
const MILLION: usize = 1_000_000;

/// A coordinator that requires tokens, with its log.
pub(crate) struct GuardedCoordinator {
    folder: TempDir,
    serve: Serve,
}

impl GuardedCoordinator {
    pub(crate) fn start(arguments: &[&str]) -> GuardedCoordinator {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let tokens = format!("worker {WORKER}\noperator {OPERATOR}\nviewer {VIEWER}\n");
        write_private(&folder.path().join("tokens"), &tokens);
        let log = File::create(folder.path().join("log")).expect("a log");
        let tokens = folder.path().join("tokens");
        let tokens = ["--token-file", tokens.to_str().expect("UTF-8")];
        let arguments = [&tokens, arguments].concat();
        let data = folder.path().join("data");
        let serve = Serve::start_with(&data, &arguments, log.into());
        GuardedCoordinator { folder, serve }
    }

    pub(crate) fn url(&self) -> &str {
        &self.serve.url
    }

    async fn channel(&self) -> Channel {
        let endpoint = Channel::from_shared(self.serve.url.clone()).expect("a URL");
        endpoint.connect().await.expect("a connection")
    }

    /// Returns all rows of the database, to be compared instead of its bytes, which change at every
    /// checkpoint.
    async fn rows(&self) -> Vec<String> {
        rows(&self.folder.path().join("data")).await
    }

    /// Counts the lines of the log that contain a word. No token may be in the log.
    pub(crate) fn logged(&self, word: &str) -> usize {
        let log = std::fs::read_to_string(self.folder.path().join("log")).expect("a log");
        for secret in [WORKER, OPERATOR, VIEWER, "wrong-secret"] {
            assert!(!log.contains(secret), "a token is in the log:\n{log}");
        }
        log.lines().filter(|line| line.contains(word)).count()
    }
}

type WithToken = Box<dyn FnMut(Request<()>) -> Result<Request<()>, Status>>;

fn with_token(channel: &Channel, token: Option<&str>) -> InterceptedService<Channel, WithToken> {
    let value = token.map(|token| format!("Bearer {token}").parse().expect("a header"));
    let add_token: WithToken = Box::new(move |mut request: Request<()>| {
        if let Some(value) = &value {
            request
                .metadata_mut()
                .insert("authorization", tonic::metadata::MetadataValue::clone(value));
        }
        Ok(request)
    });
    InterceptedService::new(channel.clone(), add_token)
}

async fn register(channel: &Channel, token: Option<&str>, id: &str) -> Result<(), Status> {
    let mut service = WorkerServiceClient::new(with_token(channel, token));
    service.register(registration(id, "primitives")).await?;
    Ok(())
}

async fn create(channel: &Channel, token: Option<&str>, spec: String) -> Result<(), Status> {
    let mut service = OperatorServiceClient::new(with_token(channel, token));
    service.create_campaign(wire::CreateCampaignRequest { spec, priority: 0 }).await?;
    Ok(())
}

async fn list(channel: &Channel, token: Option<&str>) -> Result<(), Status> {
    let mut service = OperatorServiceClient::new(with_token(channel, token));
    service.list_campaigns(wire::ListCampaignsRequest {}).await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn unauthenticated_callers_are_refused_logged_once_and_change_nothing() {
    let guarded = GuardedCoordinator::start(&[]);
    let channel = guarded.channel().await;
    let before = guarded.rows().await;
    let spec = || small_spec("stranger").to_string();
    for token in [None, Some("wrong-secret-0123456789"), Some("x")] {
        for _ in 0..3 {
            assert_refused(register(&channel, token, "w").await, Code::Unauthenticated, &[]);
            let refused = create(&channel, token, spec()).await;
            assert_refused(refused, Code::Unauthenticated, &[]);
        }
    }
    assert_eq!(guarded.logged("was refused"), 1);
    assert_eq!(guarded.rows().await, before);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_allows_only_the_calls_of_its_role() {
    let guarded = GuardedCoordinator::start(&[]);
    let channel = guarded.channel().await;
    let before = guarded.rows().await;
    let spec = || small_spec("one").to_string();
    for (role, token) in [("worker", WORKER), ("viewer", VIEWER)] {
        let refused = create(&channel, Some(token), spec()).await;
        let refused = refused.expect_err(role);
        assert_eq!(refused.code(), Code::PermissionDenied, "{refused}");
        assert!(refused.message().contains(role), "{refused}");
        assert!(refused.message().contains("operator"), "{refused}");
    }
    for token in [OPERATOR, VIEWER] {
        let refused = register(&channel, Some(token), "w").await;
        assert_eq!(refused.expect_err(token).code(), Code::PermissionDenied);
        list(&channel, Some(token)).await.expect("may read");
    }
    // A worker may read nothing: neither campaigns nor results.
    let refused = list(&channel, Some(WORKER)).await.expect_err("a worker");
    assert_eq!(refused.code(), Code::PermissionDenied);
    assert_eq!(guarded.logged("was refused"), 1);
    assert_eq!(guarded.rows().await, before);

    create(&channel, Some(OPERATOR), spec()).await.expect("an operator");
    register(&channel, Some(WORKER), "w").await.expect("a worker");
    assert_ne!(guarded.rows().await, before);
}

#[tokio::test(flavor = "multi_thread")]
async fn names_of_a_million_characters_are_refused_in_every_field() {
    let guarded = GuardedCoordinator::start(&[]);
    let channel = guarded.channel().await;
    let before = guarded.rows().await;
    let long = "n".repeat(MILLION);
    let mut worker = WorkerServiceClient::new(with_token(&channel, Some(WORKER)));
    for field in ["worker_id", "host", "asset_pack", "asset_pack_digest", "renderer"] {
        let mut request = registration("w", "primitives");
        match field {
            "worker_id" => request.worker_id = long.clone(),
            "host" => request.host = long.clone(),
            "asset_pack" => request.asset_pack = long.clone(),
            "asset_pack_digest" => request.asset_pack_digest = long.clone(),
            _ => request.renderer = long.clone(),
        }
        let refused = worker.register(request).await.expect_err(field);
        assert_eq!(refused.code(), Code::InvalidArgument, "{field}: {refused}");
        assert!(refused.message().len() < 1_000, "{field} is echoed");
    }
    for key in ["name", "tasks"] {
        let mut spec = small_spec("named");
        spec[key] = match key {
            "name" => long.clone().into(),
            _ => vec![long.clone()].into(),
        };
        let refused = create(&channel, Some(OPERATOR), spec.to_string()).await;
        let refused = refused.expect_err(key);
        assert_eq!(refused.code(), Code::InvalidArgument, "{key}: {refused}");
        assert!(refused.message().len() < 5_000, "{key} is echoed");
    }
    let refused = register(&channel, Some(&long), "w").await;
    refused.expect_err("a token of a megabyte");
    assert_eq!(guarded.logged("was refused"), 1);
    assert_eq!(guarded.rows().await, before);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_oversized_message_is_refused_before_it_is_read() {
    let guarded = GuardedCoordinator::start(&[]);
    let channel = guarded.channel().await;
    let before = guarded.rows().await;
    let mut worker = WorkerServiceClient::new(with_token(&channel, Some(WORKER)));
    let refused = worker
        .release(wire::ReleaseRequest {
            error: "e".repeat(4 << 20),
            ..wire::ReleaseRequest::default()
        })
        .await
        .expect_err("four megabytes");
    assert_eq!(refused.code(), Code::OutOfRange, "{refused}");
    assert_eq!(guarded.logged("was refused"), 1);
    assert_eq!(guarded.rows().await, before);
}

fn list_over_tls(guarded: &GuardedCoordinator, ca: &Path) -> Output {
    let port = guarded.serve.url.rsplit(':').next().expect("a port");
    let tokens = guarded.folder.path().join("tokens");
    let (ca, tokens) = (ca.to_str().expect("UTF-8"), tokens.to_str().expect("UTF-8"));
    let url = format!("https://localhost:{port}");
    let list = ["campaign", "status", "--connect", &url, "--retry-secs", "1"];
    coordinator(&[&list[..], &["--ca", ca, "--token-file", tokens]].concat())
}

#[tokio::test(flavor = "multi_thread")]
async fn over_tls_a_token_is_accepted_and_untrusted_certificates_are_refused() {
    let authority = Authority::new();
    let valid = authority.sign(3_000);
    let guarded = GuardedCoordinator::start(&valid.each_ref().map(String::as_str));
    succeed(list_over_tls(&guarded, &authority.path("ca.pem")));
    let before = guarded.rows().await;
    let untrusted = Authority::new();
    let message = &fail(list_over_tls(&guarded, &untrusted.path("ca.pem")), 1);
    assert!(message.contains("invalid peer certificate"), "{message}");
    assert_eq!(guarded.rows().await, before);
}

#[test]
fn an_address_in_use_is_named_before_a_database_is_created() {
    let (folder, serve) = Serve::anew();
    let address = serve.url.trim_start_matches("http://");
    let data = folder.path().join("second");
    let data = data.to_str().expect("UTF-8");
    let message = &fail(coordinator(&["serve", "--listen", address, "--data", data]), 1);
    assert_contains(message, &[address, "choose another address with --listen"]);
    assert!(!folder.path().join("second").exists());
}

/// Regression: on a shared machine, every user could call a coordinator that listened
/// on loopback, delete its campaigns and set its policies' endpoints.
#[test]
fn other_users_of_the_machine_are_refused_unless_insecure_loopback() {
    /// User id of `nobody`.
    const NOBODY: u32 = 65_534;
    if !rustix::process::geteuid().is_root() {
        println!(
            "skipped other_users_of_the_machine_are_refused_unless_insecure_loopback: not root"
        );
        return;
    }
    for (flags, is_allowed) in [(&[][..], false), (&["--insecure-loopback"][..], true)] {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let serve = Serve::start_with(folder.path(), flags, Stdio::null());
        let listed = Command::new(env!("CARGO_BIN_EXE_coordinator"))
            .args(["campaign", "status", "--connect", &serve.url])
            .env_clear()
            .current_dir("/")
            .uid(NOBODY)
            .gid(NOBODY)
            .output()
            .expect("runs");
        let message = text(&listed.stderr);
        assert_eq!(listed.status.success(), is_allowed, "{message}");
        assert_eq!(message.contains("--insecure-loopback"), !is_allowed, "{message}");
        serve.run(&["campaign", "status"], 0, &[]);
    }
}

#[test]
fn readable_secrets_are_refused_and_stored_files_are_private() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name);
    let [tokens, key, certificate, data] = ["tokens", "key.pem", "cert.pem", "deep/data"].map(path);
    for (file, content) in [
        (&tokens, format!("worker {WORKER}\noperator {OPERATOR}\n")),
        (&key, "a key".to_owned()),
        (&certificate, "a certificate".to_owned()),
    ] {
        write_private(file, &content);
    }
    let [tokens_text, key_text, certificate_text, data_text] =
        [&tokens, &key, &certificate, &data].map(|path| path.to_str().expect("UTF-8"));
    let with_tokens = ["serve", "--data", data_text, "--token-file", tokens_text];
    let with_key =
        ["serve", "--data", data_text, "--tls-cert", certificate_text, "--tls-key", key_text];
    let as_client = ["campaign", "status", "--token-file", tokens_text];
    for (arguments, exposed) in
        [(&with_tokens[..], &tokens), (&with_key[..], &key), (&as_client[..], &tokens)]
    {
        for mode in [0o644, 0o640, 0o602] {
            std::fs::set_permissions(exposed, Permissions::from_mode(mode)).expect("set");
            let message = &fail(coordinator(arguments), 1);
            let remedy = format!("`chmod 600 {}`", exposed.display());
            let shown = format!("{mode:04o}");
            assert!(message.contains(&remedy) && message.contains(&shown), "{message}");
            assert!(!message.contains(OPERATOR), "{message}");
        }
        std::fs::set_permissions(exposed, Permissions::from_mode(0o600)).expect("set");
        assert!(!data.exists());
    }
    let serve = Serve::start_with(
        &data,
        &["--token-file", tokens_text],
        File::create(path("log")).expect("a log").into(),
    );
    let mode = |path: &Path| path.metadata().expect("an existing file").mode() & 0o777;
    assert_eq!(mode(&data), 0o700);
    let database = data.join("coordinator.sqlite");
    for suffix in ["", "-wal", "-shm"] {
        let file = PathBuf::from(format!("{}{suffix}", database.display()));
        assert_eq!(mode(&file), 0o600, "{}", file.display());
    }
    drop(serve);
    // A database that others may read is made private, too.
    std::fs::set_permissions(&database, Permissions::from_mode(0o644)).expect("set");
    let _serve = Serve::start(&data);
    assert_eq!(mode(&database), 0o600);
}

/// Anyone who can reach the port can open connections and make no request that is admitted.
#[tokio::test(flavor = "multi_thread")]
async fn connections_without_an_admitted_request_are_closed_and_do_not_exhaust_the_limit() {
    /// Limit on the number of open files of the coordinator.
    const FILES: usize = 128;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let limited = Command::new("sh")
        .args(["-c", "ulimit -n \"$1\"; shift; exec \"$@\"", "sh"])
        .arg(FILES.to_string())
        .arg(env!("CARGO_BIN_EXE_coordinator"))
        .args(["serve", "--listen", "127.0.0.1:0", "--data"])
        .arg(folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let serve = Serve::wait_until_listening(limited.expect("starts"));
    assert!(serve.is_ready(), "the coordinator does not listen");
    let address = serve.url.strip_prefix("http://").expect("a URL");
    let connect = || {
        let mut connection = TcpStream::connect(address).expect("a connection");
        // The preface of HTTP/2 and empty settings.
        let greeting = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
        connection.write_all(greeting).expect("sent");
        connection
    };
    let mut idle: Vec<TcpStream> = (0..FILES + 12).map(|_| connect()).collect();
    serve.worker("honest").await;
    let listed = serve.command(&["workers", "--retry-secs", "5"]);
    assert!(listed.status.success(), "{}", text(&listed.stderr));
    assert!(text(&listed.stdout).contains("honest"));
    let mut last = idle.pop().expect("a connection");
    last.set_read_timeout(Some(Duration::from_secs(120))).expect("set");
    let end = last.read_to_end(&mut vec![]);
    assert!(
        end.is_ok() || end.is_err_and(|error| error.kind() == ErrorKind::ConnectionReset),
        "the connection is still open"
    );
}
