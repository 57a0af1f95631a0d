//! The server that a client calls: its expected kind and, for failed calls, what the libraries say
//! about it with a remedy.

use std::error::Error;
use std::io;

use tokio_rustls::rustls;
use tonic::transport::Endpoint;
use tonic::{Code, Status};

use crate::client::Access;
use crate::failure::innermost;
use crate::users::Untrusted;

/// Start of tonic's message for an answer that is not from a gRPC server.
const NO_GRPC_STATUS: &str = "grpc-status header missing, mapped from HTTP status code ";
/// HTTP statuses of a proxy whose backend is unavailable.
const BACKEND_DOWN: [u16; 3] = [502, 503, 504];

/// Kind of server that a client expects at an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServerKind {
    Coordinator,
    /// A server of `rollout.policy.v1`: a policy, or a gateway in front of policies.
    Policy,
    /// A server of another protocol, by its name with an article.
    Other(&'static str),
}

impl ServerKind {
    fn name(self) -> &'static str {
        match self {
            ServerKind::Coordinator => "the coordinator",
            ServerKind::Policy => "the policy server",
            ServerKind::Other(name) => name,
        }
    }
}

/// Options of a client that set the server's address and certificate authority, as remedies name
/// them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Option for the address, such as `--connect`.
    pub address: &'static str,
    /// Option for the certificate authority, such as `--ca`.
    pub authority: &'static str,
    /// Prefix of addresses without TLS, such as `http://`.
    pub clear: &'static str,
    /// Prefix of addresses with TLS, such as `https://`.
    pub encrypted: &'static str,
}

/// Reason why a server did not answer a call. The texts are the libraries'.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The connection is refused.
    Refused,
    /// The token is not sent.
    Untrusted(Untrusted),
    /// The TLS handshake failed.
    Tls(String),
    /// A web server answered.
    OtherProtocol(String),
    LacksCall,
    /// No answer came: there is no connection, or it ended.
    NoAnswer(String),
}

impl Fault {
    fn of(error: &(dyn Error + 'static)) -> Fault {
        let mut cause = Some(error);
        while let Some(error) = cause {
            if let Some(untrusted) = error.downcast_ref::<Untrusted>() {
                return Fault::Untrusted(*untrusted);
            }
            if let Some(error) = error.downcast_ref::<io::Error>() {
                // An error of TLS is inside, and not among the causes.
                if let Some(inner) = error.get_ref().filter(|inner| inner.is::<rustls::Error>()) {
                    return Fault::Tls(inner.to_string());
                }
                if error.kind() == io::ErrorKind::ConnectionRefused {
                    return Fault::Refused;
                }
            }
            cause = error.source();
        }
        Fault::NoAnswer(innermost(error))
    }

    /// Returns the fault of a web server that answered with this HTTP status.
    pub fn http(status: u16) -> Fault {
        let text = format!("HTTP status {status}");
        match BACKEND_DOWN.contains(&status) {
            true => Fault::NoAnswer(text),
            false => Fault::OtherProtocol(text),
        }
    }

    /// Returns true if the settings of client or server are wrong, so that retrying is useless.
    pub fn is_final(&self) -> bool {
        match self {
            Fault::Untrusted(untrusted) => *untrusted == Untrusted::AnotherUser,
            Fault::Tls(_) | Fault::OtherProtocol(_) | Fault::LacksCall => true,
            Fault::Refused | Fault::NoAnswer(_) => false,
        }
    }
}

/// Reason why a call to a server failed, with the remedy. The message follows the server's address
/// and a colon.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{finding}; {remedy}")]
pub struct ConnectError {
    pub fault: Fault,
    pub finding: String,
    remedy: String,
}

/// A server that a client calls.
#[derive(Clone, Debug)]
pub struct Peer {
    is_encrypted: bool,
    kind: ServerKind,
    settings: Settings,
}

impl Peer {
    /// Creates the peer at an endpoint, where a server of `kind` is expected. `settings` are
    /// the client's options that remedies name.
    pub fn new(endpoint: &Endpoint, kind: ServerKind, settings: Settings) -> Peer {
        Peer { is_encrypted: Access::is_encrypted(endpoint.uri()), kind, settings }
    }

    /// Diagnoses a failed call; `None` if the server itself answered with the failure.
    pub fn diagnose(&self, status: &Status) -> Option<ConnectError> {
        let http = status.message().strip_prefix(NO_GRPC_STATUS).and_then(|code| code.parse().ok());
        Some(self.error(match (status.source(), http) {
            (Some(error), _) => Fault::of(error),
            (None, Some(code)) => Fault::http(code),
            (None, None) if status.code() == Code::Unimplemented => Fault::LacksCall,
            (None, None) => return None,
        }))
    }

    /// Diagnoses a failure of a connection of another protocol than gRPC.
    pub fn explain(&self, error: &(dyn Error + 'static)) -> ConnectError {
        self.error(Fault::of(error))
    }

    pub fn error(&self, fault: Fault) -> ConnectError {
        let Settings { address, authority, clear, encrypted } = self.settings;
        let name = self.kind.name();
        let finding = match &fault {
            Fault::Refused => "nothing listens there".to_owned(),
            Fault::Untrusted(untrusted) => untrusted.to_string(),
            Fault::Tls(text) => format!("TLS with the server there fails ({text})"),
            Fault::OtherProtocol(text) => format!("a server of another kind is there ({text})"),
            Fault::LacksCall => "the server there does not have this call".to_owned(),
            Fault::NoAnswer(text) => format!("no answer came from it ({text})"),
        };
        let remedy = match (&fault, self.kind) {
            (Fault::Refused, ServerKind::Coordinator) => {
                format!("start it with `coordinator serve`, or name another in {address}")
            }
            (Fault::Refused, _) => format!("start it, or name another in {address}"),
            (Fault::Untrusted(_), _) => format!(
                "stop that program, or let {name} use TLS and write {encrypted} in place of \
                 {clear} in {address}"
            ),
            (Fault::Tls(_), _) => format!(
                "its --tls-cert must be valid now and for the host in {address}, and signed by \
                 the authority in {authority}; if it does not use TLS, write {clear} in place of \
                 {encrypted}"
            ),
            (Fault::OtherProtocol(_), _) => format!("name the address of {name} in {address}"),
            (Fault::LacksCall, ServerKind::Coordinator) => format!(
                "name the address of {name} in {address}, and use the same version of both programs"
            ),
            (Fault::LacksCall, _) => format!(
                "name the address of {name} in {address}; it must implement every call of \
                 rollout.policy.v1, which policy.proto describes"
            ),
            (Fault::NoAnswer(_), _) if self.is_encrypted => {
                format!("check that {name} runs, and that {address} names it")
            }
            (Fault::NoAnswer(_), _) => format!(
                "check that {name} runs, and that {address} names it, with {encrypted} in place \
                 of {clear} if it uses TLS"
            ),
        };
        ConnectError { fault, finding, remedy }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_is_not_repeated_if_only_other_settings_can_help() {
        let no_tls = io::Error::other(rustls::Error::HandshakeNotComplete);
        let errors: [(Box<dyn Error>, bool); 5] = [
            (no_tls.into(), true),
            (Untrusted::AnotherUser.into(), true),
            (Untrusted::UnknownUser.into(), false),
            (io::Error::from(io::ErrorKind::ConnectionRefused).into(), false),
            (io::Error::from(io::ErrorKind::ConnectionReset).into(), false),
        ];
        for (error, is_final) in errors {
            assert_eq!(Fault::of(&*error).is_final(), is_final, "{error}");
        }
        assert!(!Fault::http(503).is_final() && Fault::http(404).is_final());
    }
}
