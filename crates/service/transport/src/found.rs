//! Diagnosis of a failed call, with its remedy as text. Pure; `probe` does the network access.

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

/// Settings of a client's address and certificate authority: remedies name
/// these.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Setting of the address, such as `--connect`.
    pub address: &'static str,
    /// Setting of the certificate authority, such as `--ca`.
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

/// Result of probing an address at which a call failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Found {
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
    Clear,
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
        said: String,
        /// True if it is a proxy whose backend is unavailable.
        is_proxy_waiting: bool,
    },
    /// An SSH server.
    Ssh,
    /// A server of an unknown protocol.
    Other { said: String },
    /// A server that accepts the connection, then sends nothing or closes the connection.
    Mute,
    /// A server of another kind of this project.
    OtherKind(ServerKind),
    /// A gRPC server of another project.
    OtherGrpc,
    /// The right kind of server, but a version without this call.
    Older,
    /// The right server, reachable now; the connection broke.
    Broken,
}

impl From<Untrusted> for Found {
    fn from(untrusted: Untrusted) -> Found {
        match untrusted {
            Untrusted::AnotherUser => Found::AnotherUser,
            Untrusted::UnknownUser => Found::UnknownUser,
        }
    }
}

/// HTTP statuses of a proxy whose backend is unavailable.
const PROXY_WAITING: [u16; 3] = [502, 503, 504];

impl Found {
    /// Classifies a web server that answered with this HTTP status.
    pub fn web(status: u16) -> Found {
        Found::Web {
            said: format!("HTTP status {status}"),
            is_proxy_waiting: PROXY_WAITING.contains(&status),
        }
    }

    /// Classifies a web server whose answer begins with this line.
    pub(crate) fn web_line(answer: String) -> Found {
        let status = answer
            .split_whitespace()
            .nth(1)
            .and_then(|word| word.parse().ok());
        Found::Web {
            is_proxy_waiting: status.is_some_and(|code| PROXY_WAITING.contains(&code)),
            said: answer,
        }
    }

    /// Returns true if the settings of client or server are wrong, so that retrying is useless.
    pub fn is_final(&self) -> bool {
        match self {
            Found::AnotherUser
            | Found::Encrypted
            | Found::Clear
            | Found::Certificate(_)
            | Found::OtherTls(_)
            | Found::Ssh
            | Found::Other { .. }
            | Found::OtherKind(_)
            | Found::OtherGrpc
            | Found::Older => true,
            Found::Web {
                is_proxy_waiting, ..
            } => !is_proxy_waiting,
            Found::UnknownHost
            | Found::Nothing
            | Found::NoAnswer
            | Found::System(_)
            | Found::UnknownUser
            | Found::Mute
            | Found::Broken => false,
        }
    }
}

/// Reason why a server could not be called, with its remedy. The message follows the server's
/// address and a colon.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}; {}", self.finding(), Remedy(self))]
pub struct Trouble {
    /// Kind of server that was expected.
    pub expected: ServerKind,
    /// Host name of the server.
    pub host: String,
    /// Finding at the address.
    pub found: Found,
    /// True if the client has a certificate authority.
    pub has_authority: bool,
    /// Names of the settings for the remedy.
    pub settings: Settings,
}

impl Trouble {
    /// Describes the finding, without the remedy.
    pub fn finding(&self) -> impl fmt::Display {
        Finding(self)
    }
}

struct Finding<'a>(&'a Trouble);

impl fmt::Display for Finding<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Trouble {
            expected,
            host,
            found,
            settings,
            has_authority,
        } = self.0;
        match found {
            Found::UnknownHost => write!(f, "no address is known for the name `{host}`"),
            Found::Nothing => f.write_str("nothing listens there"),
            Found::NoAnswer => f.write_str("the machine does not answer"),
            Found::System(message) => {
                write!(f, "the operating system cannot connect to it ({message})")
            }
            Found::AnotherUser => write!(f, "{}", Untrusted::AnotherUser),
            Found::UnknownUser => write!(f, "{}", Untrusted::UnknownUser),
            Found::Encrypted => f.write_str("the server there uses TLS"),
            Found::Clear => f.write_str("the server there does not use TLS"),
            Found::Certificate(CertificateFault::Untrusted) if *has_authority => write!(
                f,
                "its certificate was not signed by the authority that {} names",
                settings.authority
            ),
            Found::Certificate(CertificateFault::Untrusted) => {
                f.write_str("its certificate was signed by an authority that is not known here")
            }
            Found::Certificate(CertificateFault::Expired { days }) => match days {
                0 => f.write_str("its certificate expired today"),
                1 => f.write_str("its certificate expired a day ago"),
                days => write!(f, "its certificate expired {days} days ago"),
            },
            Found::Certificate(CertificateFault::NotYetValid) => {
                f.write_str("its certificate is not valid yet")
            }
            Found::Certificate(CertificateFault::OtherName { names }) => match names.is_empty() {
                true => write!(
                    f,
                    "its certificate names no host, so it is not valid for `{host}`"
                ),
                false => write!(
                    f,
                    "its certificate is for {}, not for `{host}`",
                    names.join(", ")
                ),
            },
            Found::Certificate(CertificateFault::Authority) => f.write_str(
                "its certificate is that of a certificate authority, which a server must not use",
            ),
            Found::Certificate(CertificateFault::Unusable(message)) => {
                write!(f, "its certificate cannot be used ({message})")
            }
            Found::OtherTls(message) => write!(f, "TLS with it fails ({message})"),
            Found::Web {
                said: answer,
                is_proxy_waiting: true,
            } => write!(
                f,
                "a proxy there cannot reach the server behind it ({answer})"
            ),
            Found::Web { said: answer, .. } => {
                write!(f, "a web server of another kind is there ({answer})")
            }
            Found::Ssh => f.write_str("an SSH server is there"),
            Found::Other { said: answer } => {
                write!(
                    f,
                    "a server of another kind is there, whose answer begins with {answer:?}"
                )
            }
            Found::Mute => f.write_str("the server there closes the connection or sends nothing"),
            Found::OtherKind(kind) => {
                write!(f, "{} is there, not {}", kind.article(), expected.article())
            }
            Found::OtherGrpc => write!(
                f,
                "a gRPC server is there, and it is not {}",
                expected.article()
            ),
            Found::Older => write!(f, "{} there does not have this call", expected.definite()),
            Found::Broken => f.write_str("the connection ended before the answer came"),
        }
    }
}

struct Remedy<'a>(&'a Trouble);

impl fmt::Display for Remedy<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let trouble = self.0;
        let expected = trouble.expected;
        let Settings {
            address,
            authority,
            clear,
            encrypted,
        } = trouble.settings;
        match &trouble.found {
            Found::UnknownHost => write!(f, "correct the host's name in {address}"),
            Found::Nothing => write!(
                f,
                "{}, or name another in {address}",
                expected.start_instruction()
            ),
            Found::NoAnswer => write!(
                f,
                "check that the machine is running and that no firewall blocks the connection, or \
                 name another in {address}"
            ),
            Found::System(_) => write!(f, "correct {address}"),
            Found::AnotherUser => write!(
                f,
                "stop that program, or let {} use TLS and write {encrypted} in place of {clear} \
                 in {address}",
                expected.definite()
            ),
            Found::UnknownUser => write!(
                f,
                "try again, or let {} use TLS and write {encrypted} in place of {clear} in \
                 {address}",
                expected.definite()
            ),
            Found::Encrypted => {
                write!(f, "write {encrypted} in place of {clear} in {address}")?;
                match trouble.has_authority {
                    true => Ok(()),
                    false => write!(f, ", and name its certificate authority with {authority}"),
                }
            }
            Found::Clear => write!(
                f,
                "write {clear} in place of {encrypted} in {address}, or start the server with \
                 --tls-cert and --tls-key"
            ),
            Found::Certificate(CertificateFault::Untrusted) => write!(
                f,
                "name the certificate of the authority that signed it with {authority}"
            ),
            Found::Certificate(CertificateFault::Expired { .. }) => {
                f.write_str("start the server with a new one in --tls-cert")
            }
            Found::Certificate(CertificateFault::NotYetValid) => {
                f.write_str("correct the clocks of both machines")
            }
            Found::Certificate(CertificateFault::OtherName { .. }) => write!(
                f,
                "write a name in {address} that the certificate is for, or start the server with a \
                 certificate for `{}`",
                trouble.host
            ),
            Found::Certificate(_) => f.write_str(
                "start the server with its own certificate, signed by the authority: see \
                 docs/OPERATING.md",
            ),
            Found::OtherTls(_) => f.write_str("let the server use TLS 1.2 or 1.3, and HTTP/2"),
            Found::Web {
                is_proxy_waiting: true,
                ..
            } => f.write_str(expected.start_instruction()),
            Found::Web { .. }
            | Found::Ssh
            | Found::Other { .. }
            | Found::OtherKind(_)
            | Found::OtherGrpc => write!(
                f,
                "name the address of {} in {address}",
                expected.definite()
            ),
            Found::Mute => write!(
                f,
                "check that {address} names the port of {}",
                expected.definite()
            ),
            Found::Older => f.write_str(match expected {
                ServerKind::Coordinator => "use the same version of both programs",
                ServerKind::Policy | ServerKind::Openpi | ServerKind::VlaEval => {
                    "implement every call of rollout.policy.v1, which policy.proto describes"
                }
            }),
            Found::Broken => f.write_str("try again; the server's log says why, if it failed"),
        }
    }
}
