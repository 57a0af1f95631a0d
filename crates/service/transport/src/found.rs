//! Diagnosis of a failed call, with its remedy as text. This module does no network access; `probe`
//! does.

use std::fmt;

use crate::users::Untrusted;

/// Kind of server that a client expects at an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServerKind {
    Coordinator,
    /// A server of `rollout.policy.v1`: a policy, or a gateway in front of policies.
    Policy,
    /// An openpi server, which uses WebSocket.
    Openpi,
    /// A vla-eval model server, which uses WebSocket.
    VlaEval,
}

impl ServerKind {
    /// Kinds that a gRPC call can distinguish.
    pub(crate) const OF_GRPC: [ServerKind; 2] = [ServerKind::Coordinator, ServerKind::Policy];

    /// Name with the indefinite article.
    fn article(self) -> &'static str {
        match self {
            ServerKind::Coordinator => "a coordinator",
            ServerKind::Policy => "a policy server or policy-gateway",
            ServerKind::Openpi => "an openpi server",
            ServerKind::VlaEval => "a vla-eval model server",
        }
    }

    /// Name with the definite article.
    fn definite(self) -> &'static str {
        match self {
            ServerKind::Coordinator => "the coordinator",
            ServerKind::Policy => "the policy server",
            ServerKind::Openpi => "the openpi server",
            ServerKind::VlaEval => "the vla-eval model server",
        }
    }

    fn start_instruction(self) -> &'static str {
        match self {
            ServerKind::Coordinator => "start it with `coordinator serve`",
            ServerKind::Policy | ServerKind::Openpi | ServerKind::VlaEval => "start it",
        }
    }

    /// Path of a call that only this kind of server has and that has no side effects.
    pub(crate) fn call(self) -> Option<&'static str> {
        match self {
            ServerKind::Coordinator => {
                Some("/rollout.coordinator.v1.OperatorService/ListCampaigns")
            }
            ServerKind::Policy => Some("/rollout.policy.v1.Policy/Describe"),
            ServerKind::Openpi | ServerKind::VlaEval => None,
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

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CertificateFault {
    Untrusted,
    /// The certificate has expired.
    Expired {
        /// Days since it expired.
        days: u64,
    },
    NotYetValid,
    /// The certificate is valid for other host names.
    OtherName {
        names: Vec<String>,
    },
    /// The certificate is that of an authority, not of a server.
    Authority,
    /// Any other fault.
    Unusable(
        /// Message of the TLS library.
        String,
    ),
}

/// Finding at an address at which a call failed: the kind of server there, or the fault.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ProbeResult {
    /// The host name does not resolve.
    UnknownHost,
    /// The connection is refused.
    Nothing,
    /// The connection times out.
    NoAnswer,
    /// The operating system failed to connect.
    System(
        /// Message of the system.
        String,
    ),
    /// The server belongs to another user of this machine, so the token is not sent.
    AnotherUser,
    /// The kernel does not report the server's user, so the token is not sent.
    UnknownUser,
    /// The server uses TLS, and the client does not.
    Encrypted,
    /// The server does not use TLS, and the client does.
    Unencrypted,
    /// The certificate is not trusted.
    Certificate(CertificateFault),
    /// The TLS handshake failed for another reason.
    OtherTls(
        /// Message of the TLS library.
        String,
    ),
    /// A web server that does not implement the expected protocol.
    Web {
        /// First line of the answer, or its HTTP status.
        answer: String,
        /// True if the web server is a proxy whose backend is unavailable.
        is_backend_down: bool,
    },
    /// An SSH server.
    Ssh,
    /// A server of an unknown protocol, with the first line of its answer.
    Other { answer: String },
    /// A server that accepts the connection, then sends nothing or closes the connection.
    Mute,
    /// A server of this project, but of another kind.
    OtherKind(ServerKind),
    /// A gRPC server of another project.
    OtherGrpc,
    /// The expected kind of server, in a version without the requested call.
    LacksCall,
    /// The expected server, which is reachable now; the connection of the failed call broke.
    Broken,
}

impl From<Untrusted> for ProbeResult {
    fn from(untrusted: Untrusted) -> ProbeResult {
        match untrusted {
            Untrusted::AnotherUser => ProbeResult::AnotherUser,
            Untrusted::UnknownUser => ProbeResult::UnknownUser,
        }
    }
}

/// HTTP statuses of a proxy whose backend is unavailable.
const BACKEND_DOWN: [u16; 3] = [502, 503, 504];

impl ProbeResult {
    /// Classifies a web server that answered with this HTTP status.
    pub fn web(status: u16) -> ProbeResult {
        ProbeResult::Web {
            answer: format!("HTTP status {status}"),
            is_backend_down: BACKEND_DOWN.contains(&status),
        }
    }

    /// Classifies a web server whose answer begins with this line.
    pub(crate) fn web_line(answer: String) -> ProbeResult {
        let status = answer.split_whitespace().nth(1).and_then(|word| word.parse().ok());
        ProbeResult::Web {
            is_backend_down: status.is_some_and(|code| BACKEND_DOWN.contains(&code)),
            answer,
        }
    }

    /// Returns true if the settings of client or server are wrong, so that retrying is useless.
    pub fn is_final(&self) -> bool {
        match self {
            ProbeResult::AnotherUser
            | ProbeResult::Encrypted
            | ProbeResult::Unencrypted
            | ProbeResult::Certificate(_)
            | ProbeResult::OtherTls(_)
            | ProbeResult::Ssh
            | ProbeResult::Other { .. }
            | ProbeResult::OtherKind(_)
            | ProbeResult::OtherGrpc
            | ProbeResult::LacksCall => true,
            ProbeResult::Web { is_backend_down, .. } => !is_backend_down,
            ProbeResult::UnknownHost
            | ProbeResult::Nothing
            | ProbeResult::NoAnswer
            | ProbeResult::System(_)
            | ProbeResult::UnknownUser
            | ProbeResult::Mute
            | ProbeResult::Broken => false,
        }
    }
}

/// Reason why a call to a server failed, with the remedy. The message follows the server's address
/// and a colon.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}; {}", self.finding(), Remedy(self))]
pub struct ConnectError {
    pub expected: ServerKind,
    pub host: String,
    pub found: ProbeResult,
    /// True if the client has a certificate authority.
    pub has_authority: bool,
    pub settings: Settings,
}

impl ConnectError {
    /// Describes the finding, without the remedy.
    pub fn finding(&self) -> impl fmt::Display {
        Finding(self)
    }
}

struct Finding<'a>(&'a ConnectError);

impl fmt::Display for Finding<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ConnectError { expected, host, found, settings, has_authority } = self.0;
        match found {
            ProbeResult::UnknownHost => write!(f, "no address is known for the name `{host}`"),
            ProbeResult::Nothing => f.write_str("nothing listens there"),
            ProbeResult::NoAnswer => f.write_str("the machine does not answer"),
            ProbeResult::System(message) => {
                write!(f, "the operating system cannot connect to it ({message})")
            }
            ProbeResult::AnotherUser => write!(f, "{}", Untrusted::AnotherUser),
            ProbeResult::UnknownUser => write!(f, "{}", Untrusted::UnknownUser),
            ProbeResult::Encrypted => f.write_str("the server there uses TLS"),
            ProbeResult::Unencrypted => f.write_str("the server there does not use TLS"),
            ProbeResult::Certificate(CertificateFault::Untrusted) if *has_authority => write!(
                f,
                "its certificate was not signed by the authority that {} names",
                settings.authority
            ),
            ProbeResult::Certificate(CertificateFault::Untrusted) => {
                f.write_str("its certificate was signed by an authority that is not known here")
            }
            ProbeResult::Certificate(CertificateFault::Expired { days }) => match days {
                0 => f.write_str("its certificate expired today"),
                1 => f.write_str("its certificate expired a day ago"),
                days => write!(f, "its certificate expired {days} days ago"),
            },
            ProbeResult::Certificate(CertificateFault::NotYetValid) => {
                f.write_str("its certificate is not valid yet")
            }
            ProbeResult::Certificate(CertificateFault::OtherName { names }) => {
                match names.is_empty() {
                    true => {
                        write!(f, "its certificate names no host, so it is not valid for `{host}`")
                    }
                    false => {
                        write!(f, "its certificate is for {}, not for `{host}`", names.join(", "))
                    }
                }
            }
            ProbeResult::Certificate(CertificateFault::Authority) => f.write_str(
                "its certificate is that of a certificate authority, which a server must not use",
            ),
            ProbeResult::Certificate(CertificateFault::Unusable(message)) => {
                write!(f, "its certificate cannot be used ({message})")
            }
            ProbeResult::OtherTls(message) => write!(f, "TLS with it fails ({message})"),
            ProbeResult::Web { answer, is_backend_down: true } => {
                write!(f, "a proxy there cannot reach the server behind it ({answer})")
            }
            ProbeResult::Web { answer, .. } => {
                write!(f, "a web server of another kind is there ({answer})")
            }
            ProbeResult::Ssh => f.write_str("an SSH server is there"),
            ProbeResult::Other { answer } => {
                write!(f, "a server of another kind is there, whose answer begins with {answer:?}")
            }
            ProbeResult::Mute => {
                f.write_str("the server there closes the connection or sends nothing")
            }
            ProbeResult::OtherKind(kind) => {
                write!(f, "{} is there, not {}", kind.article(), expected.article())
            }
            ProbeResult::OtherGrpc => {
                write!(f, "a gRPC server is there, and it is not {}", expected.article())
            }
            ProbeResult::LacksCall => {
                write!(f, "{} there does not have this call", expected.definite())
            }
            ProbeResult::Broken => f.write_str("the connection ended before the answer came"),
        }
    }
}

struct Remedy<'a>(&'a ConnectError);

impl fmt::Display for Remedy<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let trouble = self.0;
        let expected = trouble.expected;
        let Settings { address, authority, clear, encrypted } = trouble.settings;
        match &trouble.found {
            ProbeResult::UnknownHost => write!(f, "correct the host's name in {address}"),
            ProbeResult::Nothing => {
                write!(f, "{}, or name another in {address}", expected.start_instruction())
            }
            ProbeResult::NoAnswer => write!(
                f,
                "check that the machine is running and that no firewall blocks the connection, or \
                 name another in {address}"
            ),
            ProbeResult::System(_) => write!(f, "correct {address}"),
            ProbeResult::AnotherUser => write!(
                f,
                "stop that program, or let {} use TLS and write {encrypted} in place of {clear} \
                 in {address}",
                expected.definite()
            ),
            ProbeResult::UnknownUser => write!(
                f,
                "try again, or let {} use TLS and write {encrypted} in place of {clear} in \
                 {address}",
                expected.definite()
            ),
            ProbeResult::Encrypted => {
                write!(f, "write {encrypted} in place of {clear} in {address}")?;
                match trouble.has_authority {
                    true => Ok(()),
                    false => write!(f, ", and name its certificate authority with {authority}"),
                }
            }
            ProbeResult::Unencrypted => write!(
                f,
                "write {clear} in place of {encrypted} in {address}, or start the server with \
                 --tls-cert and --tls-key"
            ),
            ProbeResult::Certificate(CertificateFault::Untrusted) => {
                write!(f, "set {authority} to the certificate of the authority that signed it")
            }
            ProbeResult::Certificate(CertificateFault::Expired { .. }) => {
                f.write_str("start the server with a new one in --tls-cert")
            }
            ProbeResult::Certificate(CertificateFault::NotYetValid) => {
                f.write_str("correct the clocks of both machines")
            }
            ProbeResult::Certificate(CertificateFault::OtherName { .. }) => write!(
                f,
                "write a name in {address} that the certificate is for, or start the server with a \
                 certificate for `{}`",
                trouble.host
            ),
            ProbeResult::Certificate(_) => f.write_str(
                "start the server with its own certificate, signed by the authority: see \
                 docs/OPERATING.md",
            ),
            ProbeResult::OtherTls(_) => {
                f.write_str("let the server use TLS 1.2 or 1.3, and HTTP/2")
            }
            ProbeResult::Web { is_backend_down: true, .. } => {
                f.write_str(expected.start_instruction())
            }
            ProbeResult::Web { .. }
            | ProbeResult::Ssh
            | ProbeResult::Other { .. }
            | ProbeResult::OtherKind(_)
            | ProbeResult::OtherGrpc => {
                write!(f, "name the address of {} in {address}", expected.definite())
            }
            ProbeResult::Mute => {
                write!(f, "check that {address} names the port of {}", expected.definite())
            }
            ProbeResult::LacksCall => f.write_str(match expected {
                ServerKind::Coordinator => "use the same version of both programs",
                ServerKind::Policy | ServerKind::Openpi | ServerKind::VlaEval => {
                    "implement every call of rollout.policy.v1, which policy.proto describes"
                }
            }),
            ProbeResult::Broken => f.write_str("try again; if the server failed, its log says why"),
        }
    }
}
