//! Address of an openpi server, as written in a route.

use std::{fmt, str::FromStr};

use thiserror::Error;
use tonic::codegen::http::Uri;

use crate::websocket::{HostPort, Schemes};

const SCHEMES: Schemes = Schemes { clear: "ws", encrypted: "wss" };

/// Actions executed per chunk by default, as in openpi's LIBERO evaluation (`replan_steps`).
pub const DEFAULT_EXECUTE: u32 = 5;
/// Largest `execute` of an address.
pub const MAX_EXECUTE: u32 = 100;

/// Address of an openpi server: `ws://HOST:PORT` or `wss://HOST:PORT`, with `?execute=N` to
/// execute another number of actions per query than openpi's client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OpenpiAddress {
    /// Host, port and encryption.
    pub host_port: HostPort,
    /// Actions executed per chunk.
    pub execute: u32,
}

impl FromStr for OpenpiAddress {
    type Err = OpenpiAddressError;

    fn from_str(text: &str) -> Result<Self, OpenpiAddressError> {
        let parse = || {
            let uri: Uri = text.parse().ok()?;
            let host_port = HostPort::read(&uri, SCHEMES)?;
            let execute = match uri.query() {
                None => DEFAULT_EXECUTE,
                Some(query) => query.strip_prefix("execute=")?.parse().ok()?,
            };
            (1..=MAX_EXECUTE).contains(&execute).then_some(Self { host_port, execute })
        };
        parse().ok_or_else(|| OpenpiAddressError { text: text.to_owned() })
    }
}

impl fmt::Display for OpenpiAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.host_port.text(SCHEMES))?;
        match self.execute {
            DEFAULT_EXECUTE => Ok(()),
            execute => write!(f, "?execute={execute}"),
        }
    }
}

/// The text is not a valid openpi address.
#[derive(Debug, Error)]
#[error(
    "read {text:?} as an openpi server's address: write ws://HOST:PORT, or \
     ws://HOST:PORT?execute=N with N from 1 to {MAX_EXECUTE}"
)]
pub struct OpenpiAddressError {
    /// Address as written.
    pub text: String,
}
