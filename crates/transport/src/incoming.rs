//! Incoming connections of a server: a limit on their number, and timeouts for silent ones.
//!
//! Each connection costs a file descriptor and memory, and anyone who can reach the port can open
//! thousands. Two rules keep room for admitted callers. A connection is closed if the gate admits
//! none of its requests in time, or if nothing passes for minutes (live HTTP/2 connections carry
//! pings). Beyond a limit, the oldest connection without an admitted request is evicted for the
//! next one.

use std::collections::BTreeMap;
use std::future::Future;
use std::io;
use std::ops::DerefMut;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use rustix::process::{Resource, getrlimit, setrlimit};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Notify;
use tokio::sync::futures::OwnedNotified;
use tokio::time::{Instant, Sleep, sleep};
use tokio_stream::Stream;
use tonic::transport::server::Connected;

use crate::refusals::LOG_AGAIN_AFTER;
use crate::users::Caller;

/// Longest time of a connection without an admitted request. It includes the TLS handshake.
pub const ADMISSION_TIMEOUT: Duration = Duration::from_secs(10);
/// Number of connections without an admitted request, each of which costs some 20 KiB.
const MAX_UNADMITTED: usize = 1_024;
/// Longest time without traffic in either direction. HTTP/2 sends a ping every thirty seconds, and
/// event streams to pages send an event at least every five seconds.
pub const IDLE_TIMEOUT: Duration = Duration::from_secs(180);
/// File descriptors reserved for databases, videos and backends.
const RESERVED_DESCRIPTORS: u64 = 96;
/// Number of connections that are allowed however low the descriptor limit is.
const MIN_CONNECTIONS: usize = 8;
/// Highest descriptor limit that is requested.
const WANTED_DESCRIPTORS: u64 = 65_536;
/// Pause after a failed accept. Descriptors or memory become available when others release them, so
/// retrying at once does not help.
const PAUSE: Duration = Duration::from_millis(100);

/// Raises the limit of open files to what the system allows, at most 65,536, and returns the limit.
/// Each connection needs a file, and a large campaign has more workers and slots than the default
/// of 1,024.
pub fn raise_file_limit() -> u64 {
    let mut limit = getrlimit(Resource::Nofile);
    let most = limit.maximum.unwrap_or(u64::MAX);
    let now = limit.current.unwrap_or(u64::MAX);
    if now < WANTED_DESCRIPTORS.min(most) {
        limit.current = Some(WANTED_DESCRIPTORS.min(most));
        if setrlimit(Resource::Nofile, limit).is_err() {
            return now;
        }
    }
    getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX)
}

fn limit_of(descriptors: u64) -> usize {
    let limit = descriptors.saturating_sub(RESERVED_DESCRIPTORS);
    usize::try_from(limit).unwrap_or(usize::MAX).max(MIN_CONNECTIONS)
}

#[derive(Debug)]
struct OpenConnections {
    limit: usize,
    /// Numbers follow the order of arrival.
    connections: Mutex<BTreeMap<u64, Entry>>,
}

#[derive(Debug)]
struct Entry {
    /// True once the gate has admitted a request of the connection.
    admitted: Arc<AtomicBool>,
    evict: Arc<Notify>,
}

/// A slot among the open connections, released on drop.
#[derive(Debug)]
struct Slot {
    open: Arc<OpenConnections>,
    number: u64,
    admitted: Arc<AtomicBool>,
    /// Resolves when the connection is evicted.
    evicted: Pin<Box<OwnedNotified>>,
}

impl OpenConnections {
    fn lock(&self) -> impl DerefMut<Target = BTreeMap<u64, Entry>> {
        // No thread panics while it holds this lock.
        self.connections.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a slot for connection `number`. At the limit, the oldest connection without an
    /// admitted request is evicted; returns `None` if there is none.
    fn take_slot(self: &Arc<OpenConnections>, number: u64) -> Option<Slot> {
        let mut connections = self.lock();
        let is_waiting = |entry: &Entry| !entry.admitted.load(Ordering::Relaxed);
        let mut waiting = connections.iter().filter(|(_, entry)| is_waiting(entry));
        let oldest = waiting.next().map(|(number, _)| *number);
        if connections.len() >= self.limit || waiting.count() + 1 >= MAX_UNADMITTED {
            let entry = connections.remove(&oldest?);
            entry.inspect(|entry| entry.evict.notify_one());
        }
        let (admitted, evict) = (Arc::default(), Arc::<Notify>::default());
        let slot = Slot {
            open: self.clone(),
            number,
            admitted: Arc::clone(&admitted),
            evicted: Box::pin(Arc::clone(&evict).notified_owned()),
        };
        connections.insert(number, Entry { admitted, evict });
        Some(slot)
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.open.lock().remove(&self.number);
    }
}

/// An accepted connection that is closed after a silence.
#[derive(Debug)]
pub struct Watched {
    stream: TcpStream,
    slot: Slot,
    deadline: Pin<Box<Sleep>>,
    /// Time of the last traffic in either direction.
    last_traffic: Instant,
    /// Longest time without traffic.
    idle: Duration,
}

impl Watched {
    fn new(stream: TcpStream, slot: Slot, idle: Duration) -> Watched {
        Watched {
            stream,
            slot,
            deadline: Box::pin(sleep(ADMISSION_TIMEOUT)),
            last_traffic: Instant::now(),
            idle,
        }
    }

    /// Records a write. One that waits for the peer to read is bounded like a silence: nothing is
    /// read meanwhile.
    fn written(
        &mut self,
        written: Poll<io::Result<usize>>,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<usize>> {
        match written {
            Poll::Ready(written) => {
                self.last_traffic = Instant::now();
                Poll::Ready(written)
            }
            Poll::Pending => self.poll_closed(context).map(Err),
        }
    }

    /// Returns the error once the connection must be closed.
    fn poll_closed(&mut self, context: &mut Context<'_>) -> Poll<io::Error> {
        let timed_out = || {
            let message = "the connection was silent, or not admitted, for too long";
            Poll::Ready(io::Error::new(io::ErrorKind::TimedOut, message))
        };
        let is_admitted = self.slot.admitted.load(Ordering::Relaxed);
        if !is_admitted && self.slot.evicted.as_mut().poll(context).is_ready() {
            return timed_out();
        }
        while self.deadline.as_mut().poll(context).is_ready() {
            let end = self.last_traffic + self.idle;
            if !is_admitted || end <= Instant::now() {
                return timed_out();
            }
            // The timer is reset when it fires, not with every byte.
            self.deadline.as_mut().reset(end);
        }
        Poll::Pending
    }
}

impl AsyncRead for Watched {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        match Pin::new(&mut self.stream).poll_read(context, buffer) {
            Poll::Ready(Ok(())) => {
                self.last_traffic = Instant::now();
                Poll::Ready(Ok(()))
            }
            Poll::Ready(Err(error)) => Poll::Ready(Err(error)),
            Poll::Pending => self.poll_closed(context).map(Err),
        }
    }
}

impl AsyncWrite for Watched {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.written(written, context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(context, bytes);
        self.written(written, context)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

impl Connected for Watched {
    type ConnectInfo = Caller;

    fn connect_info(&self) -> Caller {
        Caller::new(self.stream.connect_info(), Arc::clone(&self.slot.admitted))
    }
}

/// Stream of accepted connections for `serve_with_incoming`. It never fails: after an error of
/// accept it waits and retries.
#[derive(Debug)]
pub struct Incoming {
    listener: TcpListener,
    open: Arc<OpenConnections>,
    /// Longest time of a connection without traffic.
    idle: Duration,
    /// Number of connections accepted so far.
    accepted: u64,
    /// The pause in progress after a failed accept.
    waiting: Option<Pin<Box<Sleep>>>,
    /// Time of the last log entry about too many connections.
    logged: Option<Instant>,
}

impl Incoming {
    /// Derives the limit of connections from the number of files that this process may open.
    pub fn new(listener: TcpListener) -> Incoming {
        let descriptors = getrlimit(Resource::Nofile).current;
        let limit = limit_of(descriptors.unwrap_or(WANTED_DESCRIPTORS));
        Incoming {
            listener,
            open: Arc::new(OpenConnections { limit, connections: Mutex::default() }),
            idle: IDLE_TIMEOUT,
            accepted: 0,
            waiting: None,
            logged: None,
        }
    }

    /// Returns the next connection that gets a slot.
    pub fn poll_accept(&mut self, context: &mut Context<'_>) -> Poll<Watched> {
        loop {
            if let Some(waiting) = &mut self.waiting {
                ready!(waiting.as_mut().poll(context));
                self.waiting = None;
            }
            let (stream, _) = match ready!(self.listener.poll_accept(context)) {
                Ok(accepted) => accepted,
                // The peer has already disconnected.
                Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => continue,
                Err(error) => {
                    self.warn(&error.to_string());
                    self.waiting = Some(Box::pin(sleep(PAUSE)));
                    continue;
                }
            };
            self.accepted += 1;
            // Without TCP_NODELAY a small answer waits 40 ms for the peer's delayed
            // acknowledgement.
            if stream.set_nodelay(true).is_err() {
                continue;
            }
            match self.open.take_slot(self.accepted) {
                Some(slot) => return Poll::Ready(Watched::new(stream, slot, self.idle)),
                None => self.warn(&format!("all {} are in use", self.open.limit)),
            }
        }
    }

    /// Logs that a connection was not accepted, once per interval.
    fn warn(&mut self, problem: &str) {
        if self.logged.is_none_or(|at| at.elapsed() >= LOG_AGAIN_AFTER) {
            self.logged = Some(Instant::now());
            tracing::warn!(
                "no connection can be accepted at present: {problem}; if this continues, allow \
                 this process more open files (`ulimit -n`, LimitNOFILE=)"
            );
        }
    }
}

impl Stream for Incoming {
    type Item = io::Result<Watched>;

    fn poll_next(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<io::Result<Watched>>> {
        self.poll_accept(context).map(|stream| Some(Ok(stream)))
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::future::poll_fn;
    use std::io::{Read, Write};
    use std::process::Command;

    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::time::timeout;

    use super::*;

    #[test]
    fn the_oldest_connection_without_an_admitted_request_is_evicted() {
        let open = Arc::new(OpenConnections { limit: 3, connections: Mutex::default() });
        let mut slots: Vec<Slot> = (1..=3).filter_map(|number| open.take_slot(number)).collect();
        slots[1].admitted.store(true, Ordering::Relaxed);
        slots.extend(open.take_slot(4));
        let numbers: Vec<u64> = open.lock().keys().copied().collect();
        assert_eq!(numbers, [2, 3, 4]);
        slots.iter().for_each(|slot| slot.admitted.store(true, Ordering::Relaxed));
        assert!(open.take_slot(5).is_none(), "every connection is admitted");
        drop(slots);
        assert!(open.lock().is_empty());

        let open = Arc::new(OpenConnections { limit: usize::MAX, connections: Mutex::default() });
        let numbers = 0..=MAX_UNADMITTED as u64;
        let slots: Vec<Slot> = numbers.filter_map(|number| open.take_slot(number)).collect();
        assert_eq!((open.lock().len(), slots.len()), (MAX_UNADMITTED, MAX_UNADMITTED + 1));
        assert!(!open.lock().contains_key(&0));
    }

    /// Connects to `incoming`; returns both ends.
    async fn connected(incoming: &mut Incoming) -> (std::net::TcpStream, Watched) {
        let address = incoming.listener.local_addr().expect("an address");
        let caller = std::net::TcpStream::connect(address).expect("connects");
        (caller, accepted(incoming).await)
    }

    async fn accepted(incoming: &mut Incoming) -> Watched {
        poll_fn(|context| incoming.poll_accept(context)).await
    }

    async fn incoming() -> Incoming {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        Incoming::new(listener)
    }

    /// Returns the time until a read of a silent connection fails.
    async fn time_until_closed(connection: &mut Watched) -> Duration {
        let begun = Instant::now();
        let read = timeout(4 * ADMISSION_TIMEOUT, connection.read_u8()).await;
        let error = read.expect("the read ends").expect_err("the connection is closed");
        assert_eq!(error.kind(), io::ErrorKind::TimedOut, "{error}");
        begun.elapsed()
    }

    #[tokio::test]
    async fn a_connection_is_closed_some_time_after_its_last_traffic_in_either_direction() {
        let mut incoming = incoming().await;
        assert_eq!(incoming.idle, IDLE_TIMEOUT);
        // The first timer is `ADMISSION_TIMEOUT`; this test shortens the timers after it.
        let idle = Duration::from_secs(2);
        incoming.idle = idle;
        let (mut caller, mut connection) = connected(&mut incoming).await;
        connection.slot.admitted.store(true, Ordering::Relaxed);
        let mut bytes = [0; 1];
        let begun = Instant::now();
        // Traffic in one direction alone keeps the connection open, well beyond the first timer.
        while begun.elapsed() < ADMISSION_TIMEOUT + idle {
            let silence = timeout(idle / 2, connection.read_u8()).await;
            assert!(silence.is_err(), "{silence:?} after {:?}", begun.elapsed());
            connection.write_all(b"b").await.expect("open");
            caller.read_exact(&mut bytes[..1]).expect("received");
        }
        for _ in 0..4 {
            let silence = timeout(idle / 2, connection.read_u8()).await;
            assert!(silence.is_err(), "{silence:?} after {:?}", begun.elapsed());
            caller.write_all(b"a").expect("sent");
            assert_eq!(connection.read_u8().await.expect("open"), b'a');
        }
        let closed = time_until_closed(&mut connection).await;
        assert!(closed >= idle / 2 && closed < 2 * idle, "{closed:?}");
    }

    /// Neither bytes in either direction nor a write that the caller does not read prolong it.
    #[tokio::test]
    async fn a_connection_without_an_admitted_request_is_closed() {
        let mut incoming = incoming().await;
        for is_read in [true, false] {
            let (mut caller, mut connection) = connected(&mut incoming).await;
            caller.write_all(&[0; 64]).expect("sent");
            connection.read_exact(&mut [0; 64]).await.expect("received");
            let begun = Instant::now();
            let closed = async {
                match is_read {
                    true => drop(time_until_closed(&mut connection).await),
                    false => while connection.write_all(&[0; 1 << 20]).await.is_ok() {},
                }
            };
            timeout(2 * ADMISSION_TIMEOUT, closed).await.expect("it is closed");
            assert!(begun.elapsed() < ADMISSION_TIMEOUT + Duration::from_secs(5));
        }
    }

    /// Name of a test that lowers the limits of its process.
    const LIMITED_TEST: &str = "incoming::tests::accepting_pauses_without_free_descriptors";

    #[test]
    fn the_limit_of_files_is_raised_and_without_files_accepting_pauses() {
        let program = std::env::current_exe().expect("a program");
        let mut child = Command::new(program);
        child.args(["--ignored", "--exact", "--nocapture", LIMITED_TEST]);
        let output = child.output().expect("it runs");
        let output_text = [output.stdout, output.stderr].concat();
        let output_text = String::from_utf8_lossy(&output_text);
        assert!(output.status.success() && output_text.contains("1 passed"), "{output_text}");
    }

    #[tokio::test]
    #[ignore = "lowers its process's limits: `the_limit_of_files_is_raised_…` runs it alone"]
    async fn accepting_pauses_without_free_descriptors() {
        let lower = |descriptors| {
            let mut limit = getrlimit(Resource::Nofile);
            limit.current = Some(descriptors);
            setrlimit(Resource::Nofile, limit).expect("lowered");
        };
        let most = getrlimit(Resource::Nofile).maximum.unwrap_or(u64::MAX);
        lower(128);
        assert_eq!(raise_file_limit(), most.min(WANTED_DESCRIPTORS));
        let raised = getrlimit(Resource::Nofile).current;
        assert_eq!(raised, Some(most.min(WANTED_DESCRIPTORS)));

        lower(128);
        let mut incoming = incoming().await;
        let address = incoming.listener.local_addr().expect("an address");
        let _caller = std::net::TcpStream::connect(address).expect("connects");
        let files: Vec<File> = std::iter::from_fn(|| File::open("/dev/null").ok()).collect();
        assert!(files.len() < 128, "the limit is not in force");
        let early = timeout(4 * PAUSE, accepted(&mut incoming)).await;
        assert!(early.is_err(), "accepted a connection without a free descriptor");
        assert!(incoming.waiting.is_some(), "accepting is retried at once");
        drop(files);
        let late = timeout(8 * PAUSE, accepted(&mut incoming)).await;
        late.expect("a descriptor is free again");
    }

    #[test]
    fn limits_reserve_descriptors_for_other_files() {
        assert_eq!([1, 1_024].map(limit_of), [8, 928]);
    }
}
