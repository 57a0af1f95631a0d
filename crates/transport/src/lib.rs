//! Access control and connections: listening addresses, TLS, roles and tokens of callers, rate
//! limits, client credentials, and the diagnosis of failed calls. All programs use this crate, so
//! that its rules hold everywhere. The role that each call requires is defined by the server's own
//! table.
//!
//! A server on a loopback address requires no token and accepts the user that started it, whom the
//! kernel distinguishes from other users; `--insecure-loopback` accepts all local users. On any
//! other address it must have a certificate and tokens, or the flag `--insecure`. Tokens come from
//! a file or the environment, never from an argument, which process lists show; they are compared
//! as digests, in constant time, and never logged. A browser stores a session id instead of a
//! token; the id gives access to pages for some hours, and to no call.

#![forbid(unsafe_code)]

mod browser;
mod browser_sessions;
mod client;
mod endpoint;
mod failure;
mod gate;
mod incoming;
mod peer;
mod private;
mod rate;
mod refusals;
mod repeat;
mod server;
mod token;
mod users;

pub use browser_sessions::{MAX_SESSIONS, SESSION_LIFETIME};
pub use client::{Access, AccessError, Bearer, ClientArguments, Connection};
pub use endpoint::{EndpointError, parse_endpoint};
pub use failure::{chain, innermost, is_outage, is_outage_code, may_succeed_later, status_text};
pub use gate::{Allowed, Gate, Gated, Resource};
pub use incoming::{ADMISSION_TIMEOUT, IDLE_TIMEOUT, Incoming, Watched, raise_file_limit};
pub use peer::{ConnectError, Fault, Peer, ServerKind, Settings};
pub use rate::{BURST_REQUESTS, MAX_REQUESTS_PER_SEC};
pub use refusals::{LOG_AGAIN_AFTER, MAX_REMEMBERED_REFUSALS};
pub use repeat::Repeating;
pub use server::{
    GatedServer, HANDSHAKE_TIMEOUT, MAX_HEADER_BYTES, MAX_STREAMS_PER_CONNECTION, Security,
    SecurityError, ServerArguments,
};
pub use token::{
    MAX_TOKEN_BYTES, MAX_TOKEN_FILE_BYTES, MAX_TOKENS, MIN_TOKEN_BYTES, Role, Token, TokenError,
    Tokens,
};
pub use users::Untrusted;
