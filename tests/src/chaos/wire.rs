//! Fault-injecting TCP proxy between two programs: forwards connections and, on request, cuts,
//! blocks, delays or duplicates them, or drops the responses. The server behind it may restart
//! at another port without a change of the address for clients.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;
use std::{slice, thread};

/// Size of the forwarding buffer, bytes.
const BUFFER_BYTES: usize = 16 << 10;

/// A proxy between two programs; closed when dropped.
pub struct Wire {
    address: SocketAddr,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    /// Address of the server; without one, connections are closed at once.
    target: Mutex<Option<SocketAddr>>,
    /// Both ends of every open connection; closed ones are removed when the next connection opens.
    open: Mutex<Vec<Weak<TcpStream>>>,
    /// Delay before each forwarded buffer, milliseconds.
    delay_ms: AtomicU64,
    /// True if the bytes of new connections are sent twice.
    duplicates: AtomicBool,
    /// True if the server's responses are dropped.
    loses_answers: AtomicBool,
    /// True if connections are refused.
    is_blocked: AtomicBool,
    is_closed: AtomicBool,
}

impl Wire {
    /// Creates a wire without a server.
    pub fn new() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let wire =
            Self { address: listener.local_addr().expect("an address"), state: Arc::default() };
        let state = Arc::clone(&wire.state);
        thread::spawn(move || {
            for client in listener.incoming().flatten() {
                if state.is_closed.load(Ordering::Relaxed) {
                    return;
                }
                let state = Arc::clone(&state);
                thread::spawn(move || state.forward(client));
            }
        });
        wire
    }

    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Sets the server for new connections; `None` closes them at once.
    pub fn set_target(&self, url: Option<&str>) {
        let address = url.map(|url| {
            let bare = url.trim_start_matches("http://");
            bare.parse().expect("an address")
        });
        *self.state.target.lock().expect("no panic") = address;
    }

    pub fn cut(&self) {
        let mut open = self.state.open.lock().expect("no panic");
        for stream in open.drain(..).filter_map(|stream| stream.upgrade()) {
            // The other end may have closed the connection already.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    /// Cuts all open connections, and refuses new ones while blocked.
    pub fn block(&self, is_blocked: bool) {
        self.state.is_blocked.store(is_blocked, Ordering::SeqCst);
        self.cut();
    }

    pub fn delay(&self, by: Duration) {
        let millis = u64::try_from(by.as_millis()).expect("a short time");
        self.state.delay_ms.store(millis, Ordering::Relaxed);
    }

    /// Duplicates requests: sends a client's bytes to the server over a second connection too,
    /// whose responses are discarded. Applies only to new connections, so that the second
    /// connection receives all bytes of the first.
    pub fn duplicate(&self, duplicates: bool) {
        self.state.duplicates.store(duplicates, Ordering::Relaxed);
        self.cut();
    }

    /// Drops the server's responses, while requests still arrive. Affected connections are cut
    /// at the end.
    pub fn lose_answers(&self, loses: bool) {
        self.state.loses_answers.store(loses, Ordering::Relaxed);
        if !loses {
            self.cut();
        }
    }
}

impl Default for Wire {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.state.is_closed.store(true, Ordering::Relaxed);
        self.cut();
        // Wakes the listener, which checks for closing on each connection.
        let _ = TcpStream::connect(self.address);
    }
}

impl State {
    fn forward(&self, client: TcpStream) {
        let target = *self.target.lock().expect("no panic");
        let connect = || target.and_then(|target| TcpStream::connect(target).ok());
        if self.is_blocked.load(Ordering::SeqCst) {
            return;
        }
        let Some(server) = connect() else { return };
        let second = self.duplicates.load(Ordering::Relaxed).then(connect);
        let mut servers = vec![Arc::new(server)];
        servers.extend(second.flatten().map(Arc::new));
        let client = Arc::new(client);
        self.register([&client].into_iter().chain(&servers));
        // If the wire was blocked before this connection was registered, nothing has cut it.
        if self.is_blocked.load(Ordering::SeqCst) {
            return;
        }
        thread::scope(|threads| {
            let discards = &self.loses_answers;
            for (place, server) in servers.iter().enumerate() {
                // Responses on the duplicate connection are discarded.
                let receivers = if place == 0 { slice::from_ref(&client) } else { &[] };
                threads.spawn(move || self.copy(server, receivers, discards));
            }
            self.copy(&client, &servers, &AtomicBool::new(false));
        });
    }

    fn register<'a>(&self, streams: impl Iterator<Item = &'a Arc<TcpStream>>) {
        let mut open = self.open.lock().expect("no panic");
        open.retain(|stream| stream.strong_count() > 0);
        for stream in streams {
            // A stream that cannot be set up is about to fail anyway.
            let _ = stream.set_nodelay(true);
            open.push(Arc::downgrade(stream));
        }
    }

    /// Copies data until one end closes, and then closes all ends. Data read while `discards` is
    /// set is discarded.
    fn copy(&self, mut from: &TcpStream, to: &[Arc<TcpStream>], discards: &AtomicBool) {
        let mut buffer = vec![0; BUFFER_BYTES];
        while let Ok(count @ 1..) = from.read(&mut buffer) {
            let delay = self.delay_ms.load(Ordering::Relaxed);
            if delay > 0 {
                thread::sleep(Duration::from_millis(delay));
            }
            if discards.load(Ordering::Relaxed) {
                continue;
            }
            let sent = |(place, stream): (usize, &Arc<TcpStream>)| {
                // The duplicate connection may close at any time.
                (&**stream).write_all(&buffer[..count]).is_ok() || place > 0
            };
            if !to.iter().enumerate().all(sent) {
                break;
            }
        }
        for stream in to {
            let _ = stream.shutdown(Shutdown::Both);
        }
        let _ = from.shutdown(Shutdown::Both);
    }
}
