//! Finds the local process that listens at an address, and reads its memory use from Linux's
//! /proc. Remote servers, other systems and other users' processes are not supported.

use std::{fmt, fs, path::Path};

/// Processes that share a listening socket.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Process {
    ids: Vec<u32>,
}

/// State of a socket that listens, in /proc/net/tcp.
const LISTENING: &str = "0A";
/// Page size of all supported machines, bytes.
const PAGE_BYTES: u64 = 4096;

impl Process {
    /// Finds the process that listens at a URL of this machine; `None` if the URL is another
    /// machine's, or no process except this one is found.
    pub(super) fn listening_at(url: &str) -> Option<Self> {
        let sockets = sockets(port_of_this_machine(url)?);
        let mut ids = vec![];
        for entry in fs::read_dir("/proc").ok()?.flatten() {
            let id = entry.file_name().to_str().and_then(|name| name.parse().ok());
            if let Some(id) = id
                && id != std::process::id()
                && holds_socket(&entry.path().join("fd"), &sockets)
            {
                ids.push(id);
            }
        }
        (!ids.is_empty()).then_some(Self { ids })
    }

    /// Returns the resident memory, bytes; `None` if the process has ended.
    pub(super) fn resident_bytes(&self) -> Option<u64> {
        let pages = |id: &u32| {
            let text = fs::read_to_string(format!("/proc/{id}/statm")).ok()?;
            text.split(' ').nth(1)?.parse::<u64>().ok()
        };
        let pages: Option<Vec<u64>> = self.ids.iter().map(pages).collect();
        Some(pages?.iter().sum::<u64>() * PAGE_BYTES)
    }
}

impl fmt::Display for Process {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ids: Vec<String> = self.ids.iter().map(u32::to_string).collect();
        let noun = if ids.len() == 1 { "process" } else { "processes" };
        write!(f, "{noun} {}", ids.join(", "))
    }
}

fn port_of_this_machine(url: &str) -> Option<u16> {
    let (_, rest) = url.split_once("://")?;
    let authority = rest.split(['/', '?']).next()?;
    let (host, port) = authority.rsplit_once(':')?;
    let is_local = host == "localhost" || host == "[::1]" || host.starts_with("127.");
    port.parse().ok().filter(|_| is_local)
}

/// Returns the sockets that listen at a port, in the form of the links in a process's fd folder.
fn sockets(port: u16) -> Vec<String> {
    let tables = ["/proc/net/tcp", "/proc/net/tcp6"].map(fs::read_to_string);
    let address_suffix = format!(":{port:04X}");
    let lines = tables.iter().flatten().flat_map(|table| table.lines());
    lines
        .filter_map(|line| {
            let fields: Vec<&str> = line.split_whitespace().collect();
            let is_listening =
                fields.get(1)?.ends_with(&address_suffix) && *fields.get(3)? == LISTENING;
            is_listening.then(|| fields.get(9).map(|inode| format!("socket:[{inode}]")))?
        })
        .collect()
}

fn holds_socket(folder: &Path, sockets: &[String]) -> bool {
    let Ok(entries) = fs::read_dir(folder) else {
        return false;
    };
    let mut links = entries.flatten().filter_map(|entry| fs::read_link(entry.path()).ok());
    links.any(|link| {
        link.to_str().is_some_and(|target| sockets.iter().any(|socket| socket == target))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn port_of_this_machine_is_none_for_other_machines() {
        assert_eq!(port_of_this_machine("grpc://127.0.0.1:5000/x"), Some(5000));
        assert_eq!(port_of_this_machine("ws://[::1]:8000?execute=5"), Some(8000));
        assert_eq!(port_of_this_machine("https://localhost:1"), Some(1));
        assert_eq!(port_of_this_machine("grpc://gpu1:5000"), None);
        assert_eq!(port_of_this_machine("builtin:noop"), None);
    }

    #[test]
    fn a_listening_socket_is_found_by_its_port() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
        let port = listener.local_addr().expect("bound").port();
        let sockets = sockets(port);
        assert_eq!(sockets.len(), 1);
        assert!(holds_socket(Path::new("/proc/self/fd"), &sockets));
        // This process must not be mistaken for the server.
        let url = format!("grpc://127.0.0.1:{port}");
        assert_eq!(Process::listening_at(&url), None);
    }
}
