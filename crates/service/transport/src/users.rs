//! Identification of the local user at the other end of a connection, from the kernel's socket
//! tables, which callers cannot forge.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::geteuid;
use tonic::transport::server::TcpConnectInfo;

/// The kernel's socket tables for IPv4 and IPv6.
const TABLES: [&str; 2] = ["/proc/net/tcp", "/proc/net/tcp6"];
/// Value of a listening socket's state in these tables.
const LISTENS: &str = "0A";
const ROOT: u32 = 0;
/// Time for which a listener's check is cached.
const LISTENER_AGE: Duration = Duration::from_secs(1);

/// Local users that a server accepts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Users {
    /// The server's own user, and root.
    Own,
    /// Any user; tokens may restrict access further.
    Any,
}

/// The other end of a connection.
#[derive(Clone, Debug)]
pub struct Caller {
    connection: TcpConnectInfo,
    /// Looked up on first use; `None` if the kernel has no such socket.
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

/// A local server to which a token would be sent unencrypted.
#[derive(Clone, Debug)]
pub(crate) struct Listener {
    port: u16,
    /// Time of the last successful check.
    found: Arc<Mutex<Option<Instant>>>,
}

impl Listener {
    pub(crate) fn at(port: u16) -> Self {
        Self {
            port,
            found: Arc::default(),
        }
    }

    /// Returns false if another ordinary user of this machine listens at the port, who would
    /// receive the token. Services have users of their own and are trusted.
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

/// Returns true for root and for system users: ids below 1,000, and those of systemd's
/// `DynamicUser=`.
fn is_of_system(user: u32) -> bool {
    user < 1_000 || (61_184..=65_519).contains(&user)
}

/// Returns the owner of the local socket at `there` that is connected to `here`.
fn user_of(there: SocketAddr, here: SocketAddr) -> io::Result<Option<u32>> {
    let rows = rows()?;
    let is_it = |row: &&Row| is_written(&row.local, there) && is_written(&row.remote, here);
    Ok(rows.iter().find(is_it).map(|row| row.user))
}

/// Returns the owners of the sockets that listen at a local port.
fn listening_users(port: u16) -> io::Result<Vec<u32>> {
    let port = format!(":{port:04X}");
    let mut rows = rows()?;
    rows.retain(|row| row.state == LISTENS && row.local.ends_with(&port));
    Ok(rows.into_iter().map(|row| row.user).collect())
}

/// A socket of a process, as a row of the kernel's table.
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
            // Without IPv6 there is no second table.
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
    // A socket that its process has closed has inode 0 and is listed as root's.
    (fields.nth(1)? != "0").then_some(Row {
        local,
        remote,
        state,
        user,
    })
}

/// Returns true if a field of the table is this address. An IPv4 address may appear as an
/// IPv4-mapped IPv6 address.
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
            // The machine may have no IPv6.
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
