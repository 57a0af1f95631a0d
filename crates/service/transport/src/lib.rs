//! Access: where the programs' servers listen, over what, which callers get in
//! with which role, how often one caller may call, clients' credentials, and
//! of a failed call, whose fault it is and what is there in the server's place.
//! One crate for all programs, so that a rule holds everywhere. Not responsible
//! for what is called: which call requires which role is each server's table.
//!
//! A server on a loopback address asks for nothing and lets in the user that started it, whom the
//! kernel tells from the machine's other users; `--insecure-loopback` lets all of them in. On any
//! other address it must have a certificate and tokens, or the flag `--insecure`. Tokens come from a file or
//! the environment, never from an argument, which every process list shows; they
//! are kept as digests, compared in constant time, and never logged. A browser keeps no token but
//! the name of a session, which opens pages for some hours and no call.

#![forbid(unsafe_code)]

mod browser;
mod client;
mod endpoint;
mod failure;
mod found;
mod gate;
mod incoming;
mod peer;
mod private;
mod probe;
mod rate;
mod readers;
mod refusals;
mod server;
mod token;
mod users;

pub use client::{Access, AccessError, Bearer, ClientArguments, Connection};
pub use endpoint::{EndpointError, parse_endpoint};
pub use failure::{answer, chain, innermost, is_outage, is_outage_code, may_succeed_later};
pub use found::{CertificateFault, Found, ServerKind, Settings, Trouble};
pub use gate::{Allowed, Gate, Gated, Resource};
pub use incoming::{GREETING_TIMEOUT, IDLE_TIMEOUT, Incoming, Watched, raise_file_limit};
pub use peer::Peer;
pub use rate::{BURST_REQUESTS, MAX_REQUESTS_PER_SEC};
pub use readers::{MAX_SESSIONS, SESSION_LIFETIME};
pub use refusals::{LOG_AGAIN_AFTER, MAX_REMEMBERED_REFUSALS};
pub use server::{
    GatedServer, HANDSHAKE_TIMEOUT, MAX_HEADER_BYTES, MAX_STREAMS_PER_CONNECTION, Security,
    SecurityError, ServerArguments,
};
pub use token::{
    MAX_TOKEN_BYTES, MAX_TOKEN_FILE_BYTES, MAX_TOKENS, MIN_TOKEN_BYTES, Role, Token, TokenError,
    Tokens,
};
