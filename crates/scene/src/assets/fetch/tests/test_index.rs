//! A local package index that serves small wheels over HTTP and can simulate faults.

use std::io::{BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::ops::Range;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use flate2::Compression;
use flate2::write::DeflateEncoder;
use sha2::{Digest, Sha256};

use crate::assets::table::{Table, Text};

/// A large file, the first one in the first wheel.
pub(super) const LARGE: &str = "scenes/large texture.png";
/// A small file, the last one in the first wheel.
pub(super) const SMALL: &str = "scenes/room.xml";
pub(super) const IN_SECOND_WHEEL: &str = "textures/wall.png";
/// A file between [`LARGE`] and [`SMALL`] in the first wheel; no test requests the file.
pub(super) const UNWANTED: &str = "scenes/unwanted.stl";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    None,
    HtmlPages,
    /// Every answer with more than 100,000 bytes of a wheel ends half-way.
    CutsMidway,
    NoRanges,
    /// A range request gets the whole wheel, and the first connection ends half-way.
    NoRangesAndCutsOnce,
    /// The large file has a wrong byte in every transfer.
    WrongBytes,
    /// The large file has a wrong byte in its first transfer.
    WrongBytesOnce,
    BusyAtFirst,
    Forbidden,
    NoProject,
    NoWheel,
    /// The first answer with a wheel stops half-way, and the connection stays open.
    Stalls,
    Slow,
    /// Pages arrive byte by byte: no single read times out, but the whole page does.
    SlowPages,
    /// Wheels arrive byte by byte: no single read times out, but the next mebibyte does.
    SlowWheels,
    WrongSize,
    NeedsCredentials,
}

pub(super) fn content(path: &str) -> Vec<u8> {
    let noise = |count: u32| {
        let mut state = 1_u32;
        let next = move |_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        (0..count).map(next).collect()
    };
    match path {
        LARGE => noise(400_000),
        UNWANTED => noise(300_000),
        IN_SECOND_WHEEL => noise(3_000),
        _ => b"<mujoco/>".repeat(20),
    }
}

pub(super) struct Wheels {
    bytes: [Vec<u8>; 2],
    pub(super) table: &'static Table,
}

impl Wheels {
    pub(super) fn name(wheel: usize) -> String {
        format!("part_{wheel}-1.0-py3-none-any.whl")
    }

    pub(super) fn make() -> Self {
        let mut bytes = [Vec::new(), Vec::new()];
        let mut files = "heading\n".to_owned();
        for (wheel, path) in [(0, LARGE), (0, UNWANTED), (0, SMALL), (1, IN_SECOND_WHEEL)] {
            let content = content(path);
            let whole = &mut bytes[wheel];
            whole.extend_from_slice(b"a local header of some bytes");
            let offset = whole.len();
            let mut encoder = DeflateEncoder::new(whole, Compression::default());
            encoder.write_all(&content).expect("into memory");
            let stored = encoder.finish().expect("into memory").len() - offset;
            let sha256 = hex::encode(Sha256::digest(&content));
            let (size, wheel) = (content.len(), wheel + 1);
            files += &format!("{path}\t{size}\t{sha256}\t{wheel}\t{offset}\t{stored}\n");
        }
        let mut wheels = "heading\n".to_owned();
        for (wheel, bytes) in bytes.iter_mut().enumerate() {
            bytes.extend_from_slice(b"the directory of the archive");
            let (name, size) = (Self::name(wheel), bytes.len());
            let sha256 = hex::encode(Sha256::digest(&bytes));
            wheels += &format!("part-{wheel}\t1.0\t{name}\t{size}\t{sha256}\n");
        }
        let text =
            Text { wheels: wheels.leak(), files: files.leak(), models: "heading\n", digest: "0" };
        let table = Table::parse(text).expect("well-formed");
        Self { bytes, table: Box::leak(Box::new(table)) }
    }

    pub(super) fn write(&self, folder: &std::path::Path) {
        for (wheel, bytes) in self.bytes.iter().enumerate() {
            std::fs::write(folder.join(Self::name(wheel)), bytes).expect("writes");
        }
    }
}

pub(super) struct TestIndex {
    address: SocketAddr,
    server: Arc<Server>,
}

struct Server {
    wheels: Wheels,
    fault: Fault,
    requests: Mutex<Vec<String>>,
}

impl TestIndex {
    pub(super) fn start(fault: Fault) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("an address");
        let server = Arc::new(Server { wheels: Wheels::make(), fault, requests: Mutex::default() });
        let serving = Arc::clone(&server);
        thread::spawn(move || {
            for stream in listener.incoming() {
                let server = Arc::clone(&serving);
                // Errors of disconnected clients are ignored.
                thread::spawn(move || drop(server.serve(stream.expect("a connection"))));
            }
        });
        Self { address, server }
    }

    pub(super) fn url(&self) -> String {
        format!("http://{}/simple", self.address)
    }

    pub(super) fn url_with_credentials(&self) -> String {
        format!("http://user:secret%21@{}/simple/", self.address)
    }

    pub(super) fn table(&self) -> &'static Table {
        self.server.wheels.table
    }

    /// Returns all requests, each as `PATH` or `PATH FIRST-LAST`.
    pub(super) fn requests(&self) -> Vec<String> {
        self.server.requests.lock().expect("not poisoned").clone()
    }

    pub(super) fn wheel_requests(&self) -> Vec<String> {
        let mut requests = self.requests();
        requests.retain(|request| request.contains(".whl"));
        requests
    }
}

struct Request {
    path: String,
    range: Option<Range<usize>>,
    is_authorized: bool,
}

impl Server {
    fn serve(&self, stream: TcpStream) -> std::io::Result<()> {
        let mut lines = BufReader::new(stream.try_clone()?).lines();
        let Some(request) = self.read(&mut lines)? else {
            return Ok(());
        };
        let earlier = {
            let mut requests = self.requests.lock().expect("not poisoned");
            let range = request.range.as_ref();
            let range = range.map(|range| format!(" {}-{}", range.start, range.end - 1));
            requests.push(format!("{}{}", request.path, range.unwrap_or_default()));
            requests.len() - 1
        };
        if self.fault == Fault::BusyAtFirst && earlier < 2 {
            return send(stream, "503 Service Unavailable", "", b"");
        }
        if self.fault == Fault::NeedsCredentials && !request.is_authorized {
            return send(stream, "401 Unauthorized", "", b"");
        }
        for wheel in 0..2 {
            if request.path == format!("/simple/part-{wheel}/") {
                return self.send_page(stream, wheel);
            }
            if request.path == format!("/files/{}", Wheels::name(wheel)) {
                return self.send_wheel(stream, wheel, request.range);
            }
        }
        send(stream, "404 Not Found", "", b"")
    }

    fn read(
        &self,
        lines: &mut impl Iterator<Item = std::io::Result<String>>,
    ) -> std::io::Result<Option<Request>> {
        let Some(first) = lines.next() else {
            return Ok(None);
        };
        let path = first?.split(' ').nth(1).unwrap_or_default().to_owned();
        let (mut range, mut is_authorized) = (None, false);
        for line in lines {
            let line = line?;
            if line.is_empty() {
                break;
            }
            // Base64 of `user:secret!`.
            is_authorized |= line.eq_ignore_ascii_case("authorization: Basic dXNlcjpzZWNyZXQh");
            if let Some(bytes) = line.to_ascii_lowercase().strip_prefix("range: bytes=") {
                let (first, last) = bytes.split_once('-').expect("two ends");
                let last: usize = last.parse().expect("a number");
                range = Some(first.parse().expect("a number")..last + 1);
            }
        }
        Ok(Some(Request { path, range, is_authorized }))
    }

    fn send_page(&self, stream: TcpStream, wheel: usize) -> std::io::Result<()> {
        let name = match self.fault {
            Fault::NoProject => return send(stream, "404 Not Found", "", b""),
            Fault::NoWheel => format!("part_{wheel}-2.0-py3-none-any.whl"),
            _ => Wheels::name(wheel),
        };
        if self.fault == Fault::HtmlPages {
            let page = format!("<a href=\"../../files/{name}#sha256=0\">{name}</a>");
            return send(stream, "200 OK", "Content-Type: text/html\r\n", page.as_bytes());
        }
        let page = format!(
            "{{\"name\": \"part-{wheel}\", \"files\": [
                {{\"filename\": \"part_{wheel}-1.0.tar.gz\", \"url\": \"/files/x.tar.gz\"}},
                {{\"filename\": \"{name}\", \"url\": \"/files/{name}\", \"hashes\": {{}}}}]}}"
        );
        let kind = "Content-Type: application/vnd.pypi.simple.v1+json\r\n";
        if self.fault == Fault::SlowPages {
            send_head(&stream, "200 OK", kind, page.len())?;
            return send_slowly(stream, page.as_bytes());
        }
        send(stream, "200 OK", kind, page.as_bytes())
    }

    fn send_wheel(
        &self,
        mut stream: TcpStream,
        wheel: usize,
        range: Option<Range<usize>>,
    ) -> std::io::Result<()> {
        let mut whole = self.wheels.bytes[wheel].clone();
        let is_first = self.wheel_request_count() == 1;
        match self.fault {
            Fault::Forbidden => return send(stream, "403 Forbidden", "", b"no"),
            Fault::WrongBytes => whole[1000] ^= 1,
            Fault::WrongBytesOnce if is_first => whole[1000] ^= 1,
            Fault::WrongSize => whole.push(0),
            _ => {}
        }
        let supports_ranges = !matches!(self.fault, Fault::NoRanges | Fault::NoRangesAndCutsOnce);
        let range = range.filter(|_| supports_ranges);
        let (status, headers, part) = match range {
            None => ("200 OK", String::new(), &whole[..]),
            Some(Range { start, end }) => {
                let (last, total) = (end - 1, whole.len());
                let range = format!("Content-Range: bytes {start}-{last}/{total}\r\n");
                ("206 Partial Content", range, &whole[start..end])
            }
        };
        send_head(&stream, status, &headers, part.len())?;
        let half = part.len() / 2;
        match self.fault {
            Fault::CutsMidway if part.len() > 100_000 => stream.write_all(&part[..half]),
            Fault::NoRangesAndCutsOnce if is_first => stream.write_all(&part[..half]),
            Fault::Stalls if is_first => {
                stream.write_all(&part[..half])?;
                stream.flush()?;
                // Waits until the client has closed this connection.
                let _ = BufReader::new(&stream).read_line(&mut String::new());
                Ok(())
            }
            Fault::SlowWheels => send_slowly(stream, part),
            Fault::Slow => {
                for piece in part.chunks(part.len().div_ceil(8)) {
                    stream.write_all(piece)?;
                    stream.flush()?;
                    thread::sleep(Duration::from_millis(50));
                }
                Ok(())
            }
            _ => stream.write_all(part),
        }
    }

    fn wheel_request_count(&self) -> usize {
        let requests = self.requests.lock().expect("not poisoned");
        requests.iter().filter(|request| request.contains(".whl")).count()
    }
}

fn send(mut stream: TcpStream, status: &str, headers: &str, body: &[u8]) -> std::io::Result<()> {
    send_head(&stream, status, headers, body.len())?;
    stream.write_all(body)
}

fn send_head(
    mut stream: &TcpStream,
    status: &str,
    headers: &str,
    bytes: usize,
) -> std::io::Result<()> {
    write!(
        stream,
        "HTTP/1.1 {status}\r\n{headers}Content-Length: {bytes}\r\nConnection: close\r\n\r\n"
    )
}

/// Sends a byte every 20 milliseconds; fails once the client has closed the connection.
fn send_slowly(mut stream: TcpStream, body: &[u8]) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    for byte in body.chunks(1) {
        stream.write_all(byte)?;
        thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}
