//! HTTP requests: timeouts, certificates, credentials, and the distinction between transient and
//! permanent failures.

use std::io::{self, Read};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use percent_encoding::percent_decode_str;
use ureq::http::Response;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};
use ureq::{Agent, Body};
use url::Url;

use crate::assets::error::AssetsError;

/// Largest text answer, bytes; an index page has a few kB.
const MAX_TEXT_BYTES: u64 = 16 << 20;
pub(crate) const OTHER_INDEX: &str = "set ROLLOUT_INDEX_URL to another package index";
/// Bytes that have to arrive within each [`Deadlines::gain`].
pub(crate) const GAIN_BYTES: u64 = 1 << 20;
const CERTIFICATES: [&str; 3] = ["PIP_CERT", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE"];

#[derive(Debug)]
pub(crate) enum RequestError {
    Transient { url: String, problem: String },
    Permanent(AssetsError),
}

#[derive(Debug, Clone, Copy)]
pub struct Deadlines {
    pub connect: Duration,
    /// Timeout until the answer's headers arrive, and of each read of its body.
    pub read: Duration,
    pub page: Duration,
    /// Time within which the next mebibyte of a file has to arrive.
    pub gain: Duration,
}

impl Default for Deadlines {
    fn default() -> Self {
        Self {
            connect: Duration::from_secs(10),
            read: Duration::from_secs(30),
            page: Duration::from_secs(60),
            gain: Duration::from_secs(120),
        }
    }
}

#[derive(Clone)]
pub(crate) struct Address {
    url: Url,
    authorization: Option<String>,
}

impl Address {
    pub(crate) fn parse(text: &str) -> Result<Self, &'static str> {
        const REMEDY: &str = "write https://HOST/PATH, or http://HOST:PORT/PATH for a local mirror";
        let mut url = Url::parse(text.trim()).map_err(|_| REMEDY)?;
        if !matches!(url.scheme(), "http" | "https") || !url.has_host() {
            return Err(REMEDY);
        }
        let authorization = authorization(&url);
        // These calls cannot fail for a URL with a host.
        let _ = url.set_username("");
        let _ = url.set_password(None);
        Ok(Self { url, authorization })
    }

    /// Returns the URL without credentials.
    pub(crate) fn as_str(&self) -> &str {
        self.url.as_str()
    }

    pub(crate) fn below(&self, path: &str) -> Self {
        let mut url = self.url.clone();
        let base = url.path().trim_end_matches('/');
        url.set_path(&format!("{base}/{path}"));
        let authorization = self.authorization.clone();
        Self { url, authorization }
    }

    /// Keeps credentials only for the same scheme, host and port.
    pub(crate) fn resolve(&self, reference: &str) -> Option<Self> {
        let mut url = self.url.join(reference).ok()?;
        url.set_fragment(None);
        let mut resolved = Self::parse(url.as_str()).ok()?;
        if resolved.authorization.is_none() && resolved.url.origin() == self.url.origin() {
            resolved.authorization.clone_from(&self.authorization);
        }
        Some(resolved)
    }
}

fn authorization(url: &Url) -> Option<String> {
    if url.username().is_empty() && url.password().is_none() {
        return None;
    }
    let decoded = |text| percent_decode_str(text).collect::<Vec<u8>>();
    let mut credentials = decoded(url.username());
    credentials.push(b':');
    credentials.extend(decoded(url.password().unwrap_or_default()));
    Some(format!("Basic {}", BASE64_STANDARD.encode(credentials)))
}

/// Uses the proxies that are set in the environment variables.
#[derive(Debug)]
pub(crate) struct Client {
    agent: Agent,
    deadlines: Deadlines,
}

impl Client {
    pub(crate) fn new(deadlines: Deadlines) -> Result<Self, AssetsError> {
        let mut tls = TlsConfig::builder();
        if let Some(roots) = certificates()? {
            tls = tls.root_certs(roots);
        }
        let config = Agent::config_builder()
            .timeout_connect(Some(deadlines.connect))
            .timeout_recv_response(Some(deadlines.read))
            .timeout_per_read(Some(deadlines.read))
            .http_status_as_error(false)
            .tls_config(tls.build())
            .build();
        Ok(Self { agent: config.into(), deadlines })
    }

    /// Requests a byte range. The server may send the whole file instead; the status code tells.
    pub(crate) fn get_range(
        &self,
        address: &Address,
        range: std::ops::Range<u64>,
    ) -> Result<Response<Body>, RequestError> {
        self.get(address, "*/*", Some(range), None)
    }

    pub(crate) fn reader(&self, response: Response<Body>) -> impl Read + use<> {
        MinimumRateReader {
            reader: response.into_body().into_reader(),
            period: self.deadlines.gain,
            period_start: Instant::now(),
            gained: 0,
        }
    }

    /// Requests an address; `timeout` limits the time of the whole answer.
    fn get(
        &self,
        address: &Address,
        accept: &str,
        range: Option<std::ops::Range<u64>>,
        timeout: Option<Duration>,
    ) -> Result<Response<Body>, RequestError> {
        let request = self.agent.get(address.as_str());
        let request = request.config().timeout_global(timeout).build();
        let mut request = request.header("Accept", accept);
        if let Some(range) = range {
            let (first, last) = (range.start, range.end - 1);
            request = request.header("Range", format!("bytes={first}-{last}"));
        }
        if let Some(authorization) = &address.authorization {
            request = request.header("Authorization", authorization);
        }
        let url = || address.as_str().to_owned();
        let response = request
            .call()
            .map_err(|error| RequestError::Transient { url: url(), problem: describe(&error) })?;
        match response.status().as_u16() {
            200 | 206 | 416 => Ok(response),
            status @ (408 | 429 | 500..) => Err(RequestError::Transient {
                url: url(),
                problem: format!("the server answers {status}"),
            }),
            status => Err(RequestError::Permanent(AssetsError::Refused {
                url: url(),
                status,
                remedy: OTHER_INDEX,
            })),
        }
    }

    /// Returns a whole answer as text, and its content type.
    pub(crate) fn text(
        &self,
        address: &Address,
        accept: &str,
    ) -> Result<(String, String), RequestError> {
        let mut response = self.get(address, accept, None, Some(self.deadlines.page))?;
        let kind = response.headers().get("content-type");
        let kind = kind.and_then(|kind| kind.to_str().ok());
        let kind = kind.unwrap_or_default().to_ascii_lowercase();
        let body = response.body_mut().with_config().limit(MAX_TEXT_BYTES);
        let text = body.read_to_string().map_err(|error| RequestError::Transient {
            url: address.as_str().to_owned(),
            problem: describe(&error),
        })?;
        Ok((text, kind))
    }
}

/// A reader that fails unless [`GAIN_BYTES`] arrive within every period of a given length. With a
/// timeout per read only, a server could occupy the reader by sending single bytes.
struct MinimumRateReader<R> {
    reader: R,
    period: Duration,
    period_start: Instant,
    gained: u64,
}

impl<R: Read> Read for MinimumRateReader<R> {
    fn read(&mut self, block: &mut [u8]) -> io::Result<usize> {
        let read = self.reader.read(block)?;
        self.gained += read as u64;
        if self.gained >= GAIN_BYTES {
            (self.period_start, self.gained) = (Instant::now(), 0);
        } else if read > 0 && self.period_start.elapsed() > self.period {
            let (gained, secs) = (self.gained, self.period.as_secs_f64());
            return Err(io::Error::new(
                io::ErrorKind::TimedOut,
                format!("the server is too slow: it sent {gained} bytes in {secs} s"),
            ));
        }
        Ok(read)
    }
}

/// The first existing file that an environment variable names replaces the built-in certificates.
fn certificates() -> Result<Option<RootCerts>, AssetsError> {
    let named = CERTIFICATES.iter().filter_map(std::env::var_os);
    let Some(path) = named.map(PathBuf::from).find(|path| path.is_file()) else {
        return Ok(None);
    };
    let pem = std::fs::read(&path).map_err(|source| AssetsError::Read { path, source })?;
    let items = parse_pem(&pem).filter_map(Result::ok);
    let certificates: Vec<_> = items
        .filter_map(|item| match item {
            PemItem::Certificate(certificate) => Some(certificate),
            _ => None,
        })
        .collect();
    Ok((!certificates.is_empty()).then(|| RootCerts::from(certificates)))
}

fn describe(error: &ureq::Error) -> String {
    match error {
        ureq::Error::Io(error) => error.to_string(),
        ureq::Error::HostNotFound => "the host name cannot be resolved".to_owned(),
        ureq::Error::Timeout(_) => "the server does not answer in time".to_owned(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn credentials_are_sent_to_their_host_only_and_never_displayed() {
        let index = Address::parse("https://a:p%40ss@mirror.example/simple/").expect("a URL");
        assert_eq!(index.as_str(), "https://mirror.example/simple/");
        assert_eq!(index.authorization.as_deref(), Some("Basic YTpwQHNz"));
        let page = index.below("some-project/");
        assert_eq!(page.as_str(), "https://mirror.example/simple/some-project/");
        let same = page.resolve("../../files/a.whl#sha256=1").expect("a URL");
        assert_eq!(same.as_str(), "https://mirror.example/files/a.whl");
        assert!(same.authorization.is_some());
        let other = page.resolve("https://files.example/a.whl").expect("a URL");
        assert!(other.authorization.is_none());
    }

    #[test]
    fn only_http_urls_are_addresses() {
        for text in ["mirror:80", "ftp://h/x", "https://", "simple"] {
            assert!(Address::parse(text).is_err(), "{text}");
        }
    }
}
