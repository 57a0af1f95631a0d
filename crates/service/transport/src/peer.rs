//! The server that a client calls: its address and expected kind, and the diagnosis of failed
//! calls.

use std::error::Error;
use std::future::poll_fn;
use std::io;
use std::time::Duration;

use tonic::body::Body;
use tonic::codegen::Service;
use tonic::codegen::http::{Request, Uri, header};
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status};

use crate::client::Access;
use crate::found::{ConnectError, ProbeResult, ServerKind, Settings};
use crate::probe::{self, HttpVersion, ProbeTarget};
use crate::users::Untrusted;

/// Start of tonic's message for an answer that is not from a gRPC server.
const NO_GRPC_STATUS: &str = "grpc-status header missing";
/// Timeout of the probing connection, and of its answer.
const PROBE_TIMEOUT: Duration = Duration::from_secs(3);
/// An empty gRPC message: uncompressed, length 0.
const EMPTY_MESSAGE: &str = "\0\0\0\0\0";

/// A server that a client calls.
#[derive(Clone, Debug)]
pub struct Peer {
    endpoint: Endpoint,
    access: Access,
    kind: ServerKind,
    settings: Settings,
}

impl Peer {
    /// Creates the peer at an endpoint, where a server of `kind` is expected. `settings` are
    /// the client's options that remedies name.
    pub fn new(endpoint: Endpoint, access: &Access, kind: ServerKind, settings: Settings) -> Peer {
        Peer { endpoint, access: access.clone(), kind, settings }
    }

    /// Diagnoses a failed call; `None` if the server itself answered with the failure. May probe
    /// the address, which takes a few seconds at most.
    pub async fn diagnose(&self, status: &Status) -> Option<ConnectError> {
        let found = match status.source() {
            Some(_) => match connection_finding(status) {
                Some(found) => found,
                None => self.probe_address().await,
            },
            None if status.code() == Code::Unimplemented => self.probe_address().await,
            None if status.message().starts_with(NO_GRPC_STATUS) => self.probe_address().await,
            None => return None,
        };
        // The probe found the right server, which lacks only the requested call.
        let found = match found {
            ProbeResult::Broken if status.code() == Code::Unimplemented => ProbeResult::LacksCall,
            found => found,
        };
        Some(self.error(found))
    }

    /// Diagnoses a failed connection by probing the server's address, for clients that do not use
    /// gRPC.
    pub async fn probe(&self) -> ConnectError {
        self.error(self.probe_address().await)
    }

    /// Returns the error for a finding at this server's address.
    pub fn error(&self, found: ProbeResult) -> ConnectError {
        ConnectError {
            expected: self.kind,
            host: host(self.endpoint.uri()).to_owned(),
            found,
            has_authority: self.access.has_authority(),
            settings: self.settings,
        }
    }

    async fn probe_address(&self) -> ProbeResult {
        let uri = self.endpoint.uri();
        let is_encrypted = Access::is_encrypted(uri);
        let target = ProbeTarget {
            host: host(uri),
            port: uri.port_u16().unwrap_or(if is_encrypted { 443 } else { 80 }),
            is_encrypted,
        };
        let protocols: &[&[u8]] = match self.kind {
            ServerKind::Openpi | ServerKind::VlaEval => &[],
            ServerKind::Coordinator | ServerKind::Policy => &[probe::HTTP2],
        };
        let tls = match self.access.tls(protocols) {
            Ok(tls) => tls,
            Err(error) => return ProbeResult::OtherTls(error.to_string()),
        };
        match (probe::identify(target, &tls).await, self.kind) {
            (Err(found), _) => found,
            (Ok(HttpVersion::Http1(_)), ServerKind::Openpi | ServerKind::VlaEval) => {
                ProbeResult::Broken
            }
            (Ok(HttpVersion::Http1(line)), _) => ProbeResult::web_line(line),
            (Ok(HttpVersion::Http2), _) => self.kind_at_address().await,
        }
    }

    /// Determines the kind of this project's server at the address.
    async fn kind_at_address(&self) -> ProbeResult {
        let Some(channel) = self.access.channel(self.http_endpoint()).await else {
            return ProbeResult::Broken;
        };
        let others = ServerKind::OF_GRPC.into_iter().filter(|kind| *kind != self.kind);
        let mut finding = ProbeResult::OtherGrpc;
        for kind in [self.kind].into_iter().chain(others) {
            let Some(path) = kind.call() else { continue };
            match self.has_call(channel.clone(), path).await {
                Ok(true) if kind == self.kind => return ProbeResult::Broken,
                Ok(true) => return ProbeResult::OtherKind(kind),
                Ok(false) => {}
                // A coordinator answers unknown paths with a page.
                Err(found) => finding = found,
            }
        }
        finding
    }

    /// Returns true if a gRPC server has the call of a path.
    async fn has_call(&self, mut channel: Channel, path: &str) -> Result<bool, ProbeResult> {
        let mut request = Request::post(path)
            .body(Body::new(EMPTY_MESSAGE.to_owned()))
            .map_err(|_| ProbeResult::Broken)?;
        let headers = request.headers_mut();
        for (name, value) in [(header::CONTENT_TYPE, "application/grpc"), (header::TE, "trailers")]
        {
            headers.insert(name, header::HeaderValue::from_static(value));
        }
        // Without a token, a protected server refuses every path alike.
        if let Some(token) = self.access.authorization(self.endpoint.uri(), "Bearer") {
            headers.insert(header::AUTHORIZATION, token);
        }
        let is_ready = poll_fn(|context| channel.poll_ready(context)).await;
        is_ready.map_err(|_| ProbeResult::Broken)?;
        let answer = channel.call(request).await.map_err(|_| ProbeResult::Broken)?;
        let content = answer.headers().get(header::CONTENT_TYPE);
        if !content.is_some_and(|header| header.as_bytes().starts_with(b"application/grpc")) {
            return Err(ProbeResult::web(answer.status().as_u16()));
        }
        let status = Status::from_header_map(answer.headers());
        Ok(status.is_none_or(|status| status.code() != Code::Unimplemented))
    }

    /// Returns the endpoint of the server for gRPC calls of the probe, with its timeouts.
    fn http_endpoint(&self) -> Endpoint {
        let uri = self.endpoint.uri();
        let scheme = if Access::is_encrypted(uri) { "https" } else { "http" };
        let authority = uri.authority().map_or("", |authority| authority.as_str());
        Endpoint::from_shared(format!("{scheme}://{authority}"))
            .unwrap_or_else(|_| self.endpoint.clone())
            .connect_timeout(PROBE_TIMEOUT)
            .timeout(PROBE_TIMEOUT)
    }
}

/// Returns the finding for a connection error among a status's causes, so that no probe is needed;
/// `None` if there is no such error.
fn connection_finding(status: &Status) -> Option<ProbeResult> {
    let mut cause = status.source();
    while let Some(error) = cause {
        if let Some(untrusted) = error.downcast_ref::<Untrusted>() {
            return Some(ProbeResult::from(*untrusted));
        }
        if let Some(found) = error.downcast_ref::<io::Error>().and_then(probe::connect_finding) {
            return Some(found);
        }
        cause = error.source();
    }
    None
}

fn host(uri: &Uri) -> &str {
    let host = uri.host().unwrap_or_default();
    host.trim_start_matches('[').trim_end_matches(']')
}
