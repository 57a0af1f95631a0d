//! Identifies the user of this machine at the other end of a connection. The source is the
//! kernel's table of sockets: nobody can claim to be another.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::geteuid;
use tonic::transport::server::TcpConnectInfo;

/// The kernel's tables of sockets, for both versions of IP.
const TABLES: [&str; 2] = ["/proc/net/tcp", "/proc/net/tcp6"];
/// State of a socket that listens, in these tables.
const LISTENS: &str = "0A";
const ROOT: u32 = 0;
/// A server is looked at again after so long.
const LISTENER_AGE: Duration = Duration::from_secs(1);

/// Users of this machine that a server lets in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Users {
    /// The server's own, and root, which may do anything in any case.
    Own,
    /// Anybody who reaches it; a token may say who that is.
    Any,
}

/// The other end of a connection.
#[derive(Clone, Debug)]
pub struct Caller {
    connection: TcpConnectInfo,
    /// Found when it is first asked for; none if the kernel knows no such socket.
    user: Arc<OnceLock<Option<u32>>>,
}

impl Caller {
    pub(crate) fn new(connection: TcpConnectInfo) -> Self {
        Self {
            connection,
            user: Arc::default(),
        }
    }

    pub(crate) fn address(&self) -> Option<SocketAddr> {
        self.connection.remote_addr()
    }

    /// Returns true if the caller is a process of this server's user, or of root.
    pub(crate) fn is_own(&self) -> bool {
        let user = self.user.get_or_init(|| {
            let (there, here) = (self.address()?, self.connection.local_addr()?);
            user_of(there, here).ok()?
        });
        user.is_some_and(|user| user == ROOT || user == geteuid().as_raw())
    }
}

/// A server of this machine, to which a token is to be shown in the clear.
#[derive(Clone, Debug)]
pub(crate) struct Listener {
    port: u16,
    /// Time at which it was last found to be trusted.
    found: Arc<Mutex<Option<Instant>>>,
}

impl Listener {
    pub(crate) fn at(port: u16) -> Self {
        Self {
            port,
            found: Arc::default(),
        }
    }

    /// Returns false if an ordinary user of this machine listens at the port who is not this
    /// one: a token that is sent there is that user's. Services have users of their own.
    pub(crate) fn is_trusted(&self) -> bool {
        let mut found = self.found.lock().unwrap_or_else(PoisonError::into_inner);
        if found.is_some_and(|at| at.elapsed() < LISTENER_AGE) {
            return true;
        }
        let is_trusted = listening_users(self.port).is_ok_and(|users| {
            let mut users = users.into_iter();
            users.all(|user| user == geteuid().as_raw() || is_of_system(user))
        });
        *found = is_trusted.then(Instant::now);
        is_trusted
    }
}

/// Returns true for root, and for users that the system gives to services: those below 1,000, and
/// those of systemd's `DynamicUser=`.
fn is_of_system(user: u32) -> bool {
    user < 1_000 || (61_184..=65_519).contains(&user)
}

/// The user whose socket is at `there` and connected with `here`, both on this machine.
fn user_of(there: SocketAddr, here: SocketAddr) -> io::Result<Option<u32>> {
    let rows = rows()?;
    let is_it = |row: &&Row| is_written(&row.local, there) && is_written(&row.remote, here);
    Ok(rows.iter().find(is_it).map(|row| row.user))
}

/// The users whose processes listen at a port of this machine.
fn listening_users(port: u16) -> io::Result<Vec<u32>> {
    let port = format!(":{port:04X}");
    let mut rows = rows()?;
    rows.retain(|row| row.state == LISTENS && row.local.ends_with(&port));
    Ok(rows.into_iter().map(|row| row.user).collect())
}

/// A socket that a process holds, as the kernel writes it.
struct Row {
    local: String,
    remote: String,
    state: String,
    user: u32,
}

fn rows() -> io::Result<Vec<Row>> {
    let mut all = Vec::new();
    for table in TABLES {
        match std::fs::read_to_string(table) {
            Ok(text) => all.extend(text.lines().filter_map(row)),
            // A machine without IPv6 has no second table.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
    }
    Ok(all)
}

fn row(line: &str) -> Option<Row> {
    let mut fields = line.split_ascii_whitespace().skip(1);
    let mut text = || fields.next().map(str::to_owned);
    let (local, remote, state) = (text()?, text()?, text()?);
    let user = fields.nth(3)?.parse().ok()?;
    // A socket that its process has closed belongs to nobody, and is listed as root's.
    (fields.nth(1)? != "0").then_some(Row {
        local,
        remote,
        state,
        user,
    })
}

/// Returns true if a field of the table is this address. An IPv4 address may be written as the
/// IPv6 address that stands for it.
fn is_written(field: &str, address: SocketAddr) -> bool {
    let words = |bytes: &[u8]| -> String {
        let (words, _) = bytes.as_chunks::<4>();
        let words = words.iter().map(|word| u32::from_ne_bytes(*word));
        words.map(|word| format!("{word:08X}")).collect()
    };
    let Some((written, port)) = field.split_once(':') else {
        return false;
    };
    let is_host = match address.ip().to_canonical() {
        IpAddr::V4(ip) => {
            let mapped = ip.to_ipv6_mapped().octets();
            written == words(&ip.octets()) || written == words(&mapped)
        }
        IpAddr::V6(ip) => written == words(&ip.octets()),
    };
    is_host && port == format!("{:04X}", address.port())
}

#[cfg(test)]
mod tests {
    use std::net::{TcpListener, TcpStream};

    use super::*;

    #[test]
    fn the_kernel_names_the_user_of_either_end_and_nobody_once_it_is_closed() {
        for (listen, connect) in [
            ("127.0.0.1:0", "127.0.0.1"),
            ("[::1]:0", "[::1]"),
            ("[::]:0", "127.0.0.1"),
        ] {
            // A machine may have no IPv6.
            let Ok(listener) = TcpListener::bind(listen) else {
                continue;
            };
            let port = listener.local_addr().expect("an address").port();
            let client = TcpStream::connect(format!("{connect}:{port}")).expect("connects");
            let (server, there) = listener.accept().expect("a connection");
            let here = server.local_addr().expect("an address");
            let user = user_of(there, here).expect("a table");
            assert_eq!(user, Some(geteuid().as_raw()), "{listen}");
            let other = SocketAddr::new(there.ip(), there.port() ^ 1);
            assert_eq!(user_of(other, here).expect("a table"), None);
            assert_eq!(
                listening_users(port).expect("a table"),
                [geteuid().as_raw()]
            );
            assert!(Listener::at(port).is_trusted());
            drop(client);
            assert_eq!(user_of(there, here).expect("a table"), None, "{listen}");
        }
    }

    #[test]
    fn services_are_told_from_people() {
        for (user, expected) in [
            (0, true),
            (999, true),
            (1_000, false),
            (61_184, true),
            (65_534, false),
        ] {
            assert_eq!(is_of_system(user), expected, "{user}");
        }
    }
}
