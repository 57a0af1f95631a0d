//! A wire between two programs: forwards connections, and when asked to it cuts,
//! blocks, delays or duplicates them, or loses the answers. What listens behind it may end
//! and come back at another port; what dials it never notices but by the connection.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;
use std::{slice, thread};

/// Bytes that are forwarded at a time.
const PIECE_BYTES: usize = 16 << 10;

/// A wire; dropping it closes it.
pub struct Wire {
    address: SocketAddr,
    state: Arc<State>,
}

#[derive(Default)]
struct State {
    /// Address of the server; none: connections are closed at once.
    target: Mutex<Option<SocketAddr>>,
    /// Every connection that is open, both ends; those that ended go with the next.
    open: Mutex<Vec<Weak<TcpStream>>>,
    /// Delay before each piece that is forwarded, milliseconds.
    delay_ms: AtomicU64,
    /// True if the bytes of new connections are sent twice.
    duplicates: AtomicBool,
    /// True if the server's answers are lost.
    loses_answers: AtomicBool,
    /// True if no connection is let through.
    is_blocked: AtomicBool,
    is_closed: AtomicBool,
}

impl Wire {
    /// A wire that leads nowhere yet.
    ///
    /// # Panics
    /// If there is no free port.
    pub fn new() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let wire = Self {
            address: listener.local_addr().expect("an address"),
            state: Arc::default(),
        };
        let state = Arc::clone(&wire.state);
        thread::spawn(move || {
            for caller in listener.incoming().flatten() {
                if state.is_closed.load(Ordering::Relaxed) {
                    return;
                }
                let state = Arc::clone(&state);
                thread::spawn(move || state.forward(caller));
            }
        });
        wire
    }

    /// `http://…` of this end.
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Leads to another server from now on; to nobody, if there is none.
    pub fn lead_to(&self, url: Option<&str>) {
        let address = url.map(|url| {
            let bare = url.trim_start_matches("http://");
            bare.parse().expect("an address")
        });
        *self.state.target.lock().expect("no panic") = address;
    }

    /// Cuts every connection that is open.
    pub fn cut(&self) {
        let mut open = self.state.open.lock().expect("no panic");
        for stream in open.drain(..).filter_map(|stream| stream.upgrade()) {
            // The other end may have closed it already.
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    /// Cuts every connection that is open, and lets none through until it is unblocked.
    pub fn block(&self, is_blocked: bool) {
        self.state.is_blocked.store(is_blocked, Ordering::SeqCst);
        self.cut();
    }

    /// Holds every piece back for so long.
    pub fn delay(&self, by: Duration) {
        let millis = u64::try_from(by.as_millis()).expect("a short time");
        self.state.delay_ms.store(millis, Ordering::Relaxed);
    }

    /// Says everything twice: what a client sends goes to the server over a
    /// second connection too, whose answers nobody hears. Begins with new
    /// connections, so that the second one is a whole conversation.
    pub fn duplicate(&self, duplicates: bool) {
        self.state.duplicates.store(duplicates, Ordering::Relaxed);
        self.cut();
    }

    /// Loses everything that the server answers, while what the client sends
    /// still arrives. Connections that lost something are cut in the end.
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
        // The listener looks when somebody calls.
        let _ = TcpStream::connect(self.address);
    }
}

impl State {
    fn forward(&self, caller: TcpStream) {
        let target = *self.target.lock().expect("no panic");
        let connect = || target.and_then(|target| TcpStream::connect(target).ok());
        if self.is_blocked.load(Ordering::SeqCst) {
            return;
        }
        let Some(server) = connect() else { return };
        let second = self.duplicates.load(Ordering::Relaxed).then(connect);
        let mut servers = vec![Arc::new(server)];
        servers.extend(second.flatten().map(Arc::new));
        let caller = Arc::new(caller);
        self.keep([&caller].into_iter().chain(&servers));
        // It may have been blocked since, before there was anything to cut.
        if self.is_blocked.load(Ordering::SeqCst) {
            return;
        }
        thread::scope(|threads| {
            let lost = &self.loses_answers;
            for (place, server) in servers.iter().enumerate() {
                // Nobody hears the second one's answers.
                let hears = if place == 0 {
                    slice::from_ref(&caller)
                } else {
                    &[]
                };
                threads.spawn(move || self.copy(server, hears, lost));
            }
            self.copy(&caller, &servers, &AtomicBool::new(false));
        });
    }

    fn keep<'a>(&self, streams: impl Iterator<Item = &'a Arc<TcpStream>>) {
        let mut open = self.open.lock().expect("no panic");
        open.retain(|stream| stream.strong_count() > 0);
        for stream in streams {
            // A stream that cannot be set up is about to fail anyway.
            let _ = stream.set_nodelay(true);
            open.push(Arc::downgrade(stream));
        }
    }

    /// Until either end closes; then both are closed. What is read while it is
    /// `lost` goes nowhere.
    fn copy(&self, mut from: &TcpStream, to: &[Arc<TcpStream>], lost: &AtomicBool) {
        let mut piece = vec![0; PIECE_BYTES];
        while let Ok(count @ 1..) = from.read(&mut piece) {
            let delay = self.delay_ms.load(Ordering::Relaxed);
            if delay > 0 {
                thread::sleep(Duration::from_millis(delay));
            }
            if lost.load(Ordering::Relaxed) {
                continue;
            }
            let sent = |(place, stream): (usize, &Arc<TcpStream>)| {
                // The second conversation may end when it likes.
                (&**stream).write_all(&piece[..count]).is_ok() || place > 0
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
