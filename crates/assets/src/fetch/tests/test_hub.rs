//! A hub on this machine that serves a small tree over HTTP, and can be told
//! what to do wrong.

use std::io::{BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread;

use sha2::{Digest, Sha256};

use crate::manifest::hex;

/// The commit that it has.
pub(super) const COMMIT: &str = "0123456789abcdef0123456789abcdef01234567";
/// The file that the listing gives a SHA-256 of, and that is served from
/// another address.
pub(super) const LARGE: &str = "scenes/large texture.png";
/// A file of known size only.
pub(super) const SMALL: &str = "scenes/room.xml";

/// What it does wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    None,
    /// Every connection ends half-way through what it should send.
    CutsMidway,
    /// The same, and it knows no ranges.
    CutsOnceWithoutRanges,
    /// The large file has not the bytes that the listing speaks of.
    WrongBytes,
    /// The files are not for everybody.
    Forbidden,
    /// The first two answers are 503.
    BusyAtFirst,
    /// The listing has a path out of the pack.
    LeadsOut,
}

/// The bytes of a file.
pub(super) fn content(path: &str) -> Vec<u8> {
    match path {
        LARGE => (0..400_000_u32).map(|n| (n % 251) as u8).collect(),
        SMALL => b"<mujoco/>".repeat(20),
        _ => Vec::new(),
    }
}

/// A running hub.
pub(super) struct TestHub {
    address: SocketAddr,
    seen: Arc<Mutex<Vec<String>>>,
}

impl TestHub {
    /// Serves until the test's process ends.
    pub(super) fn start(fault: Fault) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address");
        let seen: Arc<Mutex<Vec<String>>> = Arc::default();
        let log = Arc::clone(&seen);
        thread::spawn(move || {
            for stream in listener.incoming() {
                let stream = stream.expect("a connection");
                // A client that hangs up is not the hub's concern.
                let _ = serve(stream, fault, &log);
            }
        });
        Self { address, seen }
    }

    pub(super) fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// `PATH` or `PATH from BYTE` of every request.
    pub(super) fn seen(&self) -> Vec<String> {
        self.seen.lock().expect("not poisoned").clone()
    }
}

fn serve(stream: TcpStream, fault: Fault, log: &Mutex<Vec<String>>) -> std::io::Result<()> {
    let mut lines = BufReader::new(stream.try_clone()?).lines();
    let request = lines.next().unwrap_or(Ok(String::new()))?;
    let path = request.split(' ').nth(1).unwrap_or_default().to_owned();
    let mut from = 0;
    for line in lines {
        let line = line?;
        if let Some(range) = line.to_ascii_lowercase().strip_prefix("range: bytes=") {
            from = range.trim_end_matches('-').parse().unwrap_or(0);
        }
        if line.is_empty() {
            break;
        }
    }
    let earlier = {
        let mut seen = log.lock().expect("not poisoned");
        seen.push(match from {
            0 => path.clone(),
            _ => format!("{path} from {from}"),
        });
        seen.len() - 1
    };
    if fault == Fault::BusyAtFirst && earlier < 2 {
        return send(stream, "503 Service Unavailable", "", b"");
    }
    let prefix = "/api/datasets/lerobot/libero-assets";
    if path == format!("{prefix}/revision/main") {
        let answer = format!("{{\"id\": \"x\", \"sha\": \"{COMMIT}\"}}");
        return send(stream, "200 OK", "", answer.as_bytes());
    }
    if let Some(query) = path.strip_prefix(&format!("{prefix}/tree/{COMMIT}?")) {
        return list(stream, query, prefix, fault);
    }
    if fault == Fault::Forbidden {
        return send(stream, "403 Forbidden", "", b"no");
    }
    let large = LARGE.replace(' ', "%20");
    if path == format!("/datasets/lerobot/libero-assets/resolve/{COMMIT}/{large}") {
        return send(stream, "302 Found", "Location: /store/large\r\n", b"");
    }
    if path == "/store/large" {
        return send_file(stream, LARGE, from, fault, earlier);
    }
    if path == format!("/datasets/lerobot/libero-assets/resolve/{COMMIT}/{SMALL}") {
        return send_file(stream, SMALL, from, fault, earlier);
    }
    send(stream, "404 Not Found", "", b"")
}

/// Two pages.
fn list(stream: TcpStream, query: &str, prefix: &str, fault: Fault) -> std::io::Result<()> {
    if query.contains("cursor=2") {
        let size = content(SMALL).len();
        let path = if fault == Fault::LeadsOut {
            "scenes/../../room.xml"
        } else {
            SMALL
        };
        let answer = format!("[{{\"type\": \"file\", \"path\": \"{path}\", \"size\": {size}}}]");
        return send(stream, "200 OK", "", answer.as_bytes());
    }
    let large = content(LARGE);
    let (size, digest) = (large.len(), hex(&Sha256::digest(&large)));
    let answer = format!(
        "[{{\"type\": \"directory\", \"path\": \"scenes\", \"size\": 0}},
          {{\"type\": \"file\", \"path\": \".gitattributes\", \"size\": 5}},
          {{\"type\": \"file\", \"path\": \"{LARGE}\", \"size\": {size},
            \"lfs\": {{\"oid\": \"{digest}\", \"size\": {size}, \"pointerSize\": 131}}}}]"
    );
    let next = format!("Link: <{prefix}/tree/{COMMIT}?recursive=true&cursor=2>; rel=\"next\"\r\n");
    send(stream, "200 OK", &next, answer.as_bytes())
}

fn send_file(
    mut stream: TcpStream,
    path: &str,
    from: usize,
    fault: Fault,
    earlier: usize,
) -> std::io::Result<()> {
    let mut whole = content(path);
    if fault == Fault::WrongBytes && path == LARGE {
        whole[1000] ^= 1;
    }
    let knows_ranges = fault != Fault::CutsOnceWithoutRanges;
    let from = if knows_ranges { from } else { 0 };
    let rest = &whole[from..];
    let status = if from > 0 {
        "206 Partial Content"
    } else {
        "200 OK"
    };
    let range = format!("bytes {from}-{}/{}", whole.len() - 1, whole.len());
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Length: {}\r\nContent-Range: {range}\r\n\
         Connection: close\r\n\r\n",
        rest.len()
    )?;
    let cut = match fault {
        Fault::CutsMidway => rest.len() > 100_000,
        Fault::CutsOnceWithoutRanges => earlier < 5,
        _ => false,
    };
    let sent = if cut { rest.len() / 2 } else { rest.len() };
    stream.write_all(&rest[..sent])
}

fn send(mut stream: TcpStream, status: &str, headers: &str, body: &[u8]) -> std::io::Result<()> {
    write!(
        stream,
        "HTTP/1.1 {status}\r\n{headers}Content-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    )?;
    stream.write_all(body)
}
