//! Servers that listen where a client expects another one, on real sockets.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::process::Command;
use std::thread;

use tests::programs::{Process, program};

/// Returns an address at which nothing listens.
pub(crate) fn unused_address() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("an address")
}

/// Starts a server that answers each connection by a text, or, if it is empty, closes it at once.
pub(crate) fn serve_text(answer: &'static str) -> SocketAddr {
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
pub(crate) fn host_port(process: &Process) -> String {
    process.url.trim_start_matches("http://").to_owned()
}
