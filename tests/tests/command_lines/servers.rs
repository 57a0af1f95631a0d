//! Servers that listen where a client expects another one, on real sockets, and a certificate
//! authority for servers with TLS.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair, date_time_ymd};
use tempfile::TempDir;
use tests::programs::{Process, program};

/// Returns an address at which nothing listens.
pub(crate) fn unused_address() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("an address")
}

/// Starts a server that sends a text, reads, and then sends another text. If both are empty, it
/// closes each connection at once.
pub(crate) fn serve_text(first: &'static str, then: &'static str) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("an address");
    // Ends with the test's process.
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            thread::spawn(move || send_texts(stream, first, then));
        }
    });
    address
}

fn send_texts(mut stream: TcpStream, first: &str, then: &str) {
    let _ = stream.write_all(first.as_bytes());
    if first.is_empty() && then.is_empty() {
        return;
    }
    let _ = stream.read(&mut [0; 4096]);
    let _ = stream.write_all(then.as_bytes());
    // Waits until the client disconnects.
    let _ = stream.read(&mut [0; 4096]);
}

/// A certificate authority with its files.
pub(crate) struct Authority {
    folder: TempDir,
    issuer: CertifiedIssuer<'static, KeyPair>,
}

impl Authority {
    pub(crate) fn new() -> Self {
        let mut params = CertificateParams::new(Vec::new()).expect("no names");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let key = KeyPair::generate().expect("a key");
        let issuer = CertifiedIssuer::self_signed(params, key).expect("signed");
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::write(folder.path().join("ca.pem"), issuer.pem()).expect("written");
        Self { folder, issuer }
    }

    /// Returns the path of the authority's certificate, for clients.
    pub(crate) fn file(&self) -> PathBuf {
        self.folder.path().join("ca.pem")
    }

    /// Returns the arguments of a server whose certificate is for `host` and valid until the end of
    /// a year.
    pub(crate) fn arguments(&self, host: &str, until_year: i32) -> [String; 4] {
        let mut params = CertificateParams::new([host.to_owned()]).expect("a name");
        params.not_after = date_time_ymd(until_year, 12, 31);
        let key = KeyPair::generate().expect("a key");
        let certificate = params.signed_by(&key, &self.issuer).expect("signed");
        self.write_files(&certificate.pem(), &key.serialize_pem(), host, until_year)
    }

    /// Returns the arguments of a server that presents the authority's own certificate.
    pub(crate) fn own_arguments(&self) -> [String; 4] {
        let key = self.issuer.key().serialize_pem();
        self.write_files(&self.issuer.pem(), &key, "authority", 0)
    }

    /// Writes a certificate and its key, and returns the arguments of a server that uses them.
    fn write_files(&self, certificate: &str, key: &str, host: &str, year: i32) -> [String; 4] {
        let write = |kind: &str, text: &str| {
            let file = self.folder.path().join(format!("{host}-{year}-{kind}.pem"));
            std::fs::write(&file, text).expect("written");
            // A private key that others may read is refused.
            let private = std::os::unix::fs::PermissionsExt::from_mode(0o600);
            std::fs::set_permissions(&file, private).expect("set");
            file.display().to_string()
        };
        let (certificate, key) = (write("certificate", certificate), write("key", key));
        ["--tls-cert".into(), certificate, "--tls-key".into(), key]
    }
}

pub(crate) fn coordinator(data: &Path, arguments: &[String]) -> Process {
    let mut command = Command::new(program("coordinator"));
    command.args(["serve", "--listen", "127.0.0.1:0", "--data"]);
    Process::serve(command.arg(data).args(arguments))
}

pub(crate) fn gateway(arguments: &[String]) -> Process {
    let mut command = Command::new(program("policy-gateway"));
    command.args(["--listen", "127.0.0.1:0", "--route", "noop=builtin:noop"]);
    Process::serve(command.args(arguments))
}

/// Returns `host:port` of a server's URL.
pub(crate) fn authority(process: &Process) -> String {
    process.url.trim_start_matches("http://").to_owned()
}
