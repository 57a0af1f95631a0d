//! Identification of the local user at the other end of a connection, from the kernel's socket
//! tables, which callers cannot forge.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use rustix::process::geteuid;
use tokio::net::TcpStream;
use tonic::transport::server::TcpConnectInfo;

/// The kernel's socket tables for IPv4 and IPv6.
const TABLES: [&str; 2] = ["/proc/net/tcp", "/proc/net/tcp6"];
/// Value of a listening socket's state in these tables.
const LISTENS: &str = "0A";
const ROOT: u32 = 0;

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
    /// User id of the process at the other end, looked up on first use; `None` if the kernel lists
    /// no socket for it.
    user: Arc<OnceLock<Option<u32>>>,
    /// True once the gate has admitted a request of the connection.
    admitted: Arc<AtomicBool>,
}

impl Caller {
    pub(crate) fn new(connection: TcpConnectInfo, admitted: Arc<AtomicBool>) -> Self {
        Self { connection, user: Arc::default(), admitted }
    }

    /// Records that the gate has admitted a request of the connection, which is kept from then on.
    pub(crate) fn admit(&self) {
        self.admitted.store(true, Ordering::Relaxed);
    }

    pub(crate) fn address(&self) -> Option<SocketAddr> {
        self.connection.remote_addr()
    }

    /// Returns true if the caller is a process of this server's user, or of root.
    pub(crate) fn is_own(&self) -> bool {
        let user = self.user.get_or_init(|| {
            let (peer, local) = (self.address()?, self.connection.local_addr()?);
            user_of(peer, local).ok()?
        });
        user.is_some_and(|user| user == ROOT || user == geteuid().as_raw())
    }
}

/// Reason why a token is not sent to a server on this machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Untrusted {
    #[error("another user of this machine listens there and would receive the token")]
    AnotherUser,
    #[error(
        "the kernel does not report the user of the server there, which would receive the token"
    )]
    UnknownUser,
}

/// Checks that a token may be sent unencrypted over an open connection to a local server: the
/// server's user must be this program's own, root, or a system user.
pub(crate) async fn check_server(connection: &TcpStream) -> Result<(), Untrusted> {
    let ends = || Ok::<_, io::Error>((connection.peer_addr()?, connection.local_addr()?));
    let (peer, local) = ends().map_err(|_| Untrusted::UnknownUser)?;
    // The tables of a busy machine have thousands of rows.
    let rows = tokio::task::spawn_blocking(move || rows(peer, local)).await;
    let rows = rows.map_err(io::Error::other).flatten();
    let rows = rows.map_err(|_| Untrusted::UnknownUser)?;
    check_rows(&rows, peer, local, geteuid().as_raw())
}

/// Checks the server's user, as [`check_server`] describes, against the rows of the kernel's
/// tables.
///
/// An accepted connection belongs to the server's user. A connection that waits to be accepted has
/// no owner yet, and is attributed to all users that listen on the port. If no user listens, either
/// root has configured the kernel to forward the port (to a container, for example), or the
/// connection is about to break; in neither case can another user receive the token.
fn check_rows(
    rows: &[Row],
    peer: SocketAddr,
    local: SocketAddr,
    own_user: u32,
) -> Result<(), Untrusted> {
    let check = |user: u32| match user == own_user || is_system_user(user) {
        true => Ok(()),
        false => Err(Untrusted::AnotherUser),
    };
    if let Some(owner) = owner(rows, peer, local) {
        return check(owner);
    }
    let port = port_text(peer.port());
    let is_listener = |row: &&Row| row.state == LISTENS && row.local.ends_with(&port);
    let mut listeners = rows.iter().filter(is_listener).map(|row| row.user);
    listeners.try_for_each(check)
}

/// Returns true for root and for system users: ids below 1,000, and those of systemd's
/// `DynamicUser=`.
fn is_system_user(user: u32) -> bool {
    user < 1_000 || (61_184..=65_519).contains(&user)
}

/// Returns the owner of the socket at `peer` that is connected to `local`, on this machine.
fn user_of(peer: SocketAddr, local: SocketAddr) -> io::Result<Option<u32>> {
    Ok(owner(&rows(peer, local)?, peer, local))
}

fn owner(rows: &[Row], peer: SocketAddr, local: SocketAddr) -> Option<u32> {
    let is_connection = |row: &&Row| is_address(&row.local, peer) && is_address(&row.remote, local);
    rows.iter().find(is_connection).map(|row| row.user)
}

/// A socket of a process, as a row of the kernel's table.
struct Row {
    local: String,
    remote: String,
    state: String,
    user: u32,
}

/// Returns the sockets with the port of `peer` at either end; the other rows are not parsed. The
/// kernel visits all its sockets for each table, so the table of the other address family is read
/// only if the first does not list the socket at `peer`.
fn rows(peer: SocketAddr, local: SocketAddr) -> io::Result<Vec<Row>> {
    let mut tables = TABLES;
    if peer.ip().to_canonical().is_ipv6() {
        tables.reverse();
    }
    let port = port_text(peer.port());
    let mut all = Vec::new();
    for table in tables {
        match std::fs::read_to_string(table) {
            Ok(text) => {
                let lines = text.lines().filter(|line| line.contains(&port));
                all.extend(lines.filter_map(row));
            }
            // Without IPv6 there is no second table.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        if owner(&all, peer, local).is_some() {
            break;
        }
    }
    Ok(all)
}

/// Returns the end of an address with this port, as in the tables.
fn port_text(port: u16) -> String {
    format!(":{port:04X}")
}

/// Parses a line of a table. Its fields are: number, local address, remote address, state, queues,
/// timer, retransmissions, user, timeout, inode.
fn row(line: &str) -> Option<Row> {
    let mut fields = line.split_ascii_whitespace().skip(1);
    let mut text = || fields.next().map(str::to_owned);
    let (local, remote, state) = (text()?, text()?, text()?);
    let user = fields.nth(3)?.parse().ok()?;
    // A socket that its process has closed has inode 0 and is listed as root's.
    (fields.nth(1)? != "0").then_some(Row { local, remote, state, user })
}

/// Returns true if a field of the table is this address: words of four bytes in the machine's byte
/// order, a colon and the port, in hex. An IPv4 address may appear as an IPv4-mapped IPv6 address.
fn is_address(field: &str, address: SocketAddr) -> bool {
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
    use std::net::TcpListener;

    use super::*;

    #[test]
    fn the_kernel_reports_the_user_of_an_open_connection_and_none_once_it_is_closed() {
        for (listen, connect) in
            [("127.0.0.1:0", "127.0.0.1"), ("[::1]:0", "[::1]"), ("[::]:0", "127.0.0.1")]
        {
            // The machine may have no IPv6.
            let Ok(listener) = TcpListener::bind(listen) else {
                continue;
            };
            let port = listener.local_addr().expect("an address").port();
            let client =
                std::net::TcpStream::connect(format!("{connect}:{port}")).expect("connects");
            let (server, peer) = listener.accept().expect("a connection");
            let local = server.local_addr().expect("an address");
            let user = user_of(peer, local).expect("a table");
            assert_eq!(user, Some(geteuid().as_raw()), "{listen}");
            let unconnected = SocketAddr::new(peer.ip(), peer.port() ^ 1);
            assert_eq!(user_of(unconnected, local).expect("a table"), None);
            let trusted =
                check_rows(&rows(peer, local).expect("a table"), peer, local, geteuid().as_raw());
            assert_eq!(trusted, Ok(()), "{listen}");
            drop(client);
            assert_eq!(user_of(peer, local).expect("a table"), None, "{listen}");
        }
    }

    #[test]
    fn a_connection_belongs_to_its_acceptor_or_else_to_all_listeners() {
        const OWN: u32 = 1_000;
        const OTHER: u32 = 1_001;
        let (local, peer) = ("127.0.0.1:40000", "127.0.0.1:7411");
        let line = |local: &str, remote: &str, state: &str, user: u32, inode: u32| {
            let fields = format!("0: {local} {remote} {state} 0:0 00:0 0 {user} 0 {inode} 1");
            row(&fields)
        };
        let listens = |user| line("0100007F:1CF3", "00000000:0000", LISTENS, user, 7);
        let accepted = |user| line("0100007F:1CF3", "0100007F:9C40", "01", user, 8);
        let waits = line("0100007F:1CF3", "0100007F:9C40", "01", ROOT, 0);
        let check = |rows: [Option<Row>; 3]| {
            let rows: Vec<Row> = rows.into_iter().flatten().collect();
            let [peer, local] = [peer, local].map(|address| address.parse().expect("an address"));
            check_rows(&rows, peer, local, OWN)
        };
        assert_eq!(check([listens(OWN), accepted(OWN), None]), Ok(()));
        assert_eq!(check([listens(OWN), waits, None]), Ok(()));
        let another = Err(Untrusted::AnotherUser);
        assert_eq!(check([listens(OTHER), None, None]), another);
        // The server that accepted the connection may have been replaced since.
        assert_eq!(check([listens(OWN), accepted(OTHER), None]), another);
        assert_eq!(check([listens(OWN), listens(OTHER), None]), another);
        assert_eq!(check([None, accepted(OTHER), None]), another);
        // The table has no rows for a port that the kernel forwards into a container.
        assert_eq!(check([None, None, None]), Ok(()));
    }

    #[test]
    fn system_users_are_distinguished_from_people() {
        for (user, expected) in
            [(0, true), (999, true), (1_000, false), (61_184, true), (65_534, false)]
        {
            assert_eq!(is_system_user(user), expected, "{user}");
        }
    }
}
