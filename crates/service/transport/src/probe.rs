//! Probe of an address: connects and reads enough to identify the server. Used after a failed call,
//! whose error says only that the protocol did not match.

use std::io;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::ServerName;
use tokio_rustls::rustls::{CertificateError, Error as TlsError};

use crate::found::{CertificateFault, ProbeResult};

/// Timeout of each step of a probe: name resolution, connection, TLS handshake, answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(3);
/// First bytes of an HTTP/2 client: the preface and an empty SETTINGS frame.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
/// ALPN protocol name of HTTP/2.
pub(crate) const HTTP2: &[u8] = b"h2";
/// Length of an HTTP/2 frame header, and the offset of the frame type.
const FRAME_HEAD: usize = 9;
const FRAME_TYPE: usize = 3;
const SETTINGS_FRAME: u8 = 4;
/// Longest quotation from a server, characters.
const QUOTED_CHARS: usize = 60;

#[derive(Clone, Copy, Debug)]
pub(crate) struct ProbeTarget<'a> {
    /// Host name or address, without brackets.
    pub(crate) host: &'a str,
    pub(crate) port: u16,
    /// True if the client uses TLS.
    pub(crate) is_encrypted: bool,
}

/// HTTP version of a server that accepts connections like the client's, with or without TLS.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum HttpVersion {
    Http2,
    /// HTTP/1, with the first line of its answer.
    Http1(String),
}

/// Protocol that the first bytes of a server indicate.
#[derive(Debug, PartialEq, Eq)]
enum Reply {
    Http2,
    Http1(String),
    Tls,
    Ssh,
    Other(String),
    Silence,
}

/// Connects like the client and identifies the protocol.
pub(crate) async fn identify(
    target: ProbeTarget<'_>,
    tls: &TlsConnector,
) -> Result<HttpVersion, ProbeResult> {
    let stream = connect(target).await?;
    if !target.is_encrypted {
        return match send_preface(stream).await {
            Reply::Silence => match encrypt(connect(target).await?, target, tls).await {
                Err(Handshake::NotTls) => {
                    let web = request_http1(connect(target).await?).await?;
                    // A coordinator also serves pages over HTTP/1. The preface is sent once more,
                    // so that a coordinator whose first answer was lost is not mistaken for another
                    // kind of web server.
                    match send_preface(connect(target).await?).await {
                        Reply::Http2 => Ok(HttpVersion::Http2),
                        _ => Ok(web),
                    }
                }
                Ok(_) | Err(Handshake::Failed(_)) => Err(ProbeResult::Encrypted),
            },
            reply => http_version(reply),
        };
    }
    match encrypt(stream, target, tls).await {
        Ok((_, true)) => Ok(HttpVersion::Http2),
        Ok((stream, false)) => http_version(send_preface(stream).await),
        Err(Handshake::Failed(found)) => Err(found),
        Err(Handshake::NotTls) => match http_version(send_preface(connect(target).await?).await) {
            Ok(_) => Err(ProbeResult::Unencrypted),
            Err(ProbeResult::Encrypted) => Err(ProbeResult::Mute),
            Err(found) => Err(found),
        },
    }
}

async fn connect(target: ProbeTarget<'_>) -> Result<TcpStream, ProbeResult> {
    let resolving = tokio::net::lookup_host((target.host, target.port));
    let addresses = match timeout(ANSWER_TIMEOUT, resolving).await {
        Ok(Ok(addresses)) => addresses.collect::<Vec<_>>(),
        Ok(Err(_)) | Err(_) => return Err(ProbeResult::UnknownHost),
    };
    if addresses.is_empty() {
        return Err(ProbeResult::UnknownHost);
    }
    match timeout(ANSWER_TIMEOUT, TcpStream::connect(&*addresses)).await {
        Ok(Ok(stream)) => Ok(stream),
        Ok(Err(error)) => Err(connect_finding(&error).unwrap_or_else(|| system_finding(&error))),
        Err(_) => Err(ProbeResult::NoAnswer),
    }
}

/// Maps a connection error of the system to a finding, if the error is specific enough.
pub(crate) fn connect_finding(error: &io::Error) -> Option<ProbeResult> {
    match error.kind() {
        io::ErrorKind::ConnectionRefused => Some(ProbeResult::Nothing),
        io::ErrorKind::TimedOut
        | io::ErrorKind::HostUnreachable
        | io::ErrorKind::NetworkUnreachable => Some(ProbeResult::NoAnswer),
        _ => None,
    }
}

fn system_finding(error: &io::Error) -> ProbeResult {
    ProbeResult::System(error.to_string())
}

/// Failure of a TLS handshake.
enum Handshake {
    /// The server does not use TLS, or did not answer the handshake.
    NotTls,
    /// The server uses TLS and the handshake failed.
    Failed(ProbeResult),
}

trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}
impl<S: AsyncRead + AsyncWrite + Send + Unpin> Stream for S {}

/// Performs the TLS handshake. Returns the encrypted stream, and true if HTTP/2 was negotiated.
async fn encrypt(
    stream: TcpStream,
    target: ProbeTarget<'_>,
    tls: &TlsConnector,
) -> Result<(impl Stream, bool), Handshake> {
    let name = ServerName::try_from(target.host.to_owned());
    let name = name.map_err(|_| Handshake::Failed(ProbeResult::UnknownHost))?;
    match timeout(ANSWER_TIMEOUT, tls.connect(name, stream)).await {
        Ok(Ok(stream)) => {
            let is_http2 = stream.get_ref().1.alpn_protocol() == Some(HTTP2);
            Ok((stream, is_http2))
        }
        Ok(Err(error)) => Err(tls_finding(&error).map_or(Handshake::NotTls, Handshake::Failed)),
        Err(_) => Err(Handshake::NotTls),
    }
}

/// Maps a handshake error to a finding; `None` if it does not show that the server uses TLS.
fn tls_finding(error: &io::Error) -> Option<ProbeResult> {
    let inner = error.get_ref()?.downcast_ref::<TlsError>()?;
    match inner {
        TlsError::InvalidMessage(_) => None,
        TlsError::InvalidCertificate(fault) => Some(ProbeResult::Certificate(certificate(fault))),
        other => Some(ProbeResult::OtherTls(other.to_string())),
    }
}

fn certificate(fault: &CertificateError) -> CertificateFault {
    match fault {
        // A bad signature means an issuer with the name of a known authority but another key.
        CertificateError::UnknownIssuer | CertificateError::BadSignature => {
            CertificateFault::Untrusted
        }
        CertificateError::Expired => CertificateFault::Expired { days: 0 },
        CertificateError::ExpiredContext { time, not_after } => CertificateFault::Expired {
            days: time.as_secs().saturating_sub(not_after.as_secs()) / 86_400,
        },
        CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. } => {
            CertificateFault::NotYetValid
        }
        CertificateError::NotValidForName => CertificateFault::OtherName { names: vec![] },
        CertificateError::NotValidForNameContext { presented, .. } => CertificateFault::OtherName {
            names: presented.iter().map(|name| unwrapped_name(name)).collect(),
        },
        // The library has no variant for this error.
        other if other.to_string().contains("CaUsedAsEndEntity") => CertificateFault::Authority,
        other => CertificateFault::Unusable(other.to_string()),
    }
}

/// Extracts the name from the library's notation `DnsName("a.b")`.
fn unwrapped_name(name: &str) -> String {
    let inner = name.split_once('(').map_or(name, |(_, inner)| inner);
    inner.trim_end_matches(')').trim_matches('"').to_owned()
}

/// Sends the HTTP/2 preface and classifies the answer.
async fn send_preface(mut stream: impl Stream) -> Reply {
    let mut bytes = [0; 128];
    let mut count = 0;
    let reading = async {
        // Errors are ignored: a server may send first, and close because of the preface.
        let _ = stream.write_all(PREFACE).await;
        while count < FRAME_HEAD {
            match stream.read(&mut bytes[count..]).await {
                Ok(0) | Err(_) => break,
                Ok(more) => count += more,
            }
        }
    };
    let _ = timeout(ANSWER_TIMEOUT, reading).await;
    classify(&bytes[..count])
}

/// Sends an HTTP/1 request and classifies the answer.
async fn request_http1(mut stream: TcpStream) -> Result<HttpVersion, ProbeResult> {
    let mut bytes = [0; 128];
    let exchange = async {
        let request =
            stream.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
        request.await?;
        stream.read(&mut bytes).await
    };
    let count = match timeout(ANSWER_TIMEOUT, exchange).await {
        Ok(Ok(count)) => count,
        Ok(Err(_)) | Err(_) => 0,
    };
    http_version(classify(&bytes[..count]))
}

fn classify(bytes: &[u8]) -> Reply {
    match bytes {
        [] => Reply::Silence,
        // A TLS record of the type alert or handshake, and the major version of SSL 3.0 and TLS.
        [0x15 | 0x16, 0x03, ..] => Reply::Tls,
        [b'S', b'S', b'H', b'-', ..] => Reply::Ssh,
        [b'H', b'T', b'T', b'P', b'/', ..] | [b'<', ..] => Reply::Http1(first_line(bytes)),
        [0, ..] if bytes.get(FRAME_TYPE) == Some(&SETTINGS_FRAME) => Reply::Http2,
        _ => Reply::Other(first_line(bytes)),
    }
}

fn first_line(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    let line = text.lines().next().unwrap_or_default();
    line.chars().take(QUOTED_CHARS).filter(|c| !c.is_control()).collect()
}

fn http_version(reply: Reply) -> Result<HttpVersion, ProbeResult> {
    match reply {
        Reply::Http2 => Ok(HttpVersion::Http2),
        Reply::Http1(line) => Ok(HttpVersion::Http1(line)),
        Reply::Tls => Err(ProbeResult::Encrypted),
        Reply::Ssh => Err(ProbeResult::Ssh),
        Reply::Other(answer) => Err(ProbeResult::Other { answer }),
        Reply::Silence => Err(ProbeResult::Mute),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tokio::net::TcpListener;
    use tokio_rustls::rustls::{ClientConfig, RootCertStore};

    use super::*;

    /// Probes a server that sends the next of `answers` on each connection and closes the
    /// connection.
    async fn probe(answers: &'static [&'static [u8]]) -> Result<HttpVersion, ProbeResult> {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let server = async move {
            for answer in answers {
                let (mut stream, _) = listener.accept().await.unwrap();
                let _ = stream.read(&mut [0; 1024]).await;
                let _ = stream.write_all(answer).await;
            }
        };
        let ring = Arc::new(tokio_rustls::rustls::crypto::ring::default_provider());
        let tls = ClientConfig::builder_with_provider(ring)
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(RootCertStore::empty())
            .with_no_client_auth();
        let target = ProbeTarget { host: "127.0.0.1", port, is_encrypted: false };
        let tls = TlsConnector::from(Arc::new(tls));
        tokio::join!(identify(target, &tls), server).0
    }

    #[tokio::test]
    async fn a_coordinator_is_identified_even_if_its_first_answer_is_lost() {
        const PAGE: &[u8] = b"HTTP/1.1 200 OK\r\n\r\n";
        const SETTINGS: &[u8] = b"\0\0\0\x04\0\0\0\0\0";
        let found = probe(&[b"", PAGE, PAGE, SETTINGS]).await;
        assert_eq!(found, Ok(HttpVersion::Http2));
        let page = Ok(HttpVersion::Http1("HTTP/1.1 200 OK".to_owned()));
        assert_eq!(probe(&[b"", PAGE, PAGE, PAGE]).await, page);
    }

    #[test]
    fn servers_are_identified_by_their_first_bytes() {
        let check = |bytes: &[u8], expected| assert_eq!(classify(bytes), expected);
        check(b"", Reply::Silence);
        check(b"\0\0\x18\x04\0\0\0\0\0\0\x03", Reply::Http2);
        check(b"\x15\x03\x03\0\x02\x02\x32", Reply::Tls);
        check(b"SSH-2.0-OpenSSH_9.6\r\n", Reply::Ssh);
        let line = "HTTP/1.1 400 Bad Request";
        let answer = format!("{line}\r\nServer: x\r\n\r\n");
        check(answer.as_bytes(), Reply::Http1(line.to_owned()));
        check(b"220 mail ESMTP\r\n", Reply::Other("220 mail ESMTP".to_owned()));
    }

    #[test]
    fn a_proxy_with_an_unavailable_backend_is_worth_a_retry() {
        let is_retryable = |line: &str| !ProbeResult::web_line(line.to_owned()).is_final();
        assert!(is_retryable("HTTP/1.1 502 Bad Gateway"));
        assert!(!is_retryable("HTTP/1.1 400 Bad Request"));
        assert!(!is_retryable("<!DOCTYPE HTML>"));
        assert!(!ProbeResult::web(503).is_final());
    }
}
