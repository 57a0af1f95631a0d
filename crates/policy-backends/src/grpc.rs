//! Back-end of remote policy servers that implement `rollout.policy.v1`, including other gateways.
//! Opens the connection at the first call and reopens a broken connection. The gateway's replicas
//! implement deadlines, back-off and checks of the answers.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use proto::policy::policy_client::PolicyClient;
use proto::policy::{
    DescribeRequest, DescribeResponse, EndRequest, InferBatchRequest, InferRequest, InferResponse,
    InferResult, ResetRequest, infer_result,
};
use thiserror::Error;
use tonic::codegen::http::Uri;
use tonic::transport::Endpoint;
use tonic::{Code, Response, Status};
use transport::{Access, AccessError, Connection, Fault, Peer, ServerKind};

use crate::backend::{Backend, BackendError, SETTINGS};
use crate::http2::{CONNECTION_WINDOW_BYTES, STREAM_WINDOW_BYTES};
use crate::spec::{Kind, OwnError, Specified};

pub(crate) const KIND: Kind =
    Kind::new::<GrpcAddress>(&["grpc", "https"], "grpc://HOST:PORT[/POLICY] (https:// over TLS)");

pub const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Idle time before the kernel probes a connection, which detects a host that vanished.
const TCP_KEEPALIVE: Duration = Duration::from_secs(15);

/// Address of a policy server and the name of one of its policies: `grpc://HOST:PORT`, or
/// `https://HOST:PORT` over TLS, with `/POLICY` appended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrpcAddress {
    pub authority: String,
    /// Name of the policy; empty selects the only policy of the server.
    pub policy: String,
    pub encrypted: bool,
}

impl GrpcAddress {
    pub fn endpoint(&self) -> Result<Endpoint, AddressError> {
        let scheme = if self.encrypted { "https" } else { "http" };
        let endpoint = Endpoint::from_shared(format!("{scheme}://{}", self.authority));
        let endpoint = endpoint.map_err(|_| AddressError { text: self.to_string() })?;
        Ok(endpoint
            .connect_timeout(CONNECT_TIMEOUT)
            .tcp_nodelay(true)
            .tcp_keepalive(Some(TCP_KEEPALIVE))
            .initial_stream_window_size(STREAM_WINDOW_BYTES)
            .initial_connection_window_size(CONNECTION_WINDOW_BYTES))
    }
}

impl FromStr for GrpcAddress {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        let invalid = || AddressError { text: text.to_owned() };
        let (scheme, rest) = text.split_once("://").ok_or_else(invalid)?;
        let encrypted = match scheme {
            "grpc" => false,
            "https" => true,
            _ => return Err(invalid()),
        };
        let (authority, policy) = rest.split_once('/').unwrap_or((rest, ""));
        let address =
            Self { authority: authority.to_owned(), policy: policy.to_owned(), encrypted };
        let uri = format!("http://{authority}").parse::<Uri>();
        let is_complete = uri.is_ok_and(|uri| {
            uri.host().is_some_and(|host| !host.is_empty()) && uri.port_u16().is_some()
        });
        if is_complete && address.endpoint().is_ok() { Ok(address) } else { Err(invalid()) }
    }
}

impl fmt::Display for GrpcAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let separator = if self.policy.is_empty() { "" } else { "/" };
        let scheme = if self.encrypted { "https" } else { "grpc" };
        write!(f, "{scheme}://{}{separator}{}", self.authority, self.policy)
    }
}

impl Specified for GrpcAddress {
    fn open(&self, access: &Access) -> Result<Arc<dyn Backend>, OwnError> {
        Ok(Arc::new(GrpcBackend::new(self.clone(), self.endpoint()?, access)?))
    }

    fn is_encrypted(&self) -> bool {
        self.encrypted
    }
}

#[derive(Debug, Error)]
#[error(
    "read {text:?} as a policy server's address: write grpc://HOST:PORT or \
     grpc://HOST:PORT/POLICY, with https:// in place of grpc:// over TLS"
)]
pub struct AddressError {
    pub text: String,
}

#[derive(Debug)]
pub struct GrpcBackend {
    address: GrpcAddress,
    client: PolicyClient<Connection>,
    peer: Peer,
}

impl GrpcBackend {
    /// Creates a back-end for an address's endpoint, without connecting.
    pub fn new(
        address: GrpcAddress,
        endpoint: Endpoint,
        access: &Access,
    ) -> Result<Self, AccessError> {
        let peer = Peer::new(&endpoint, ServerKind::Policy, SETTINGS);
        let client = PolicyClient::new(access.connect_lazy(endpoint)?)
            .max_decoding_message_size(proto::MAX_MESSAGE_BYTES)
            .max_encoding_message_size(proto::MAX_MESSAGE_BYTES);
        Ok(Self { address, client, peer })
    }

    /// Makes one call. Distinguishes an unreachable server from a server that returned an error.
    async fn call<T>(
        &self,
        call: impl Future<Output = Result<Response<T>, Status>>,
    ) -> Result<T, BackendError> {
        match call.await {
            Ok(response) => Ok(response.into_inner()),
            Err(status) => Err(self.error(status)),
        }
    }

    fn error(&self, status: Status) -> BackendError {
        let address = self.address.authority.clone();
        match self.peer.diagnose(&status) {
            // A server that lacks the call did answer, so the connection is not at fault.
            Some(trouble) if trouble.fault == Fault::LacksCall => BackendError::Refused {
                address,
                status: Box::new(Status::new(status.code(), trouble.to_string())),
            },
            Some(trouble) => BackendError::Unreachable { address, trouble: trouble.into() },
            None if matches!(status.code(), Code::Unauthenticated | Code::PermissionDenied) => {
                let reason = status.message().to_owned();
                BackendError::TokenRejected { address, reason }
            }
            None => BackendError::Refused { address, status: status.into() },
        }
    }
}

#[tonic::async_trait]
impl Backend for GrpcBackend {
    async fn describe(&self, suite: &str) -> Result<DescribeResponse, BackendError> {
        let request = DescribeRequest {
            protocol_version: proto::PROTOCOL_VERSION,
            policy: self.address.policy.clone(),
            suite: suite.to_owned(),
        };
        self.call(self.client.clone().describe(request)).await
    }

    async fn reset(&self, mut request: ResetRequest) -> Result<(), BackendError> {
        request.policy.clone_from(&self.address.policy);
        self.call(self.client.clone().reset(request)).await.map(drop)
    }

    async fn end(&self, session: &str) {
        let request =
            EndRequest { policy: self.address.policy.clone(), session: session.to_owned() };
        // A server need not implement `End`.
        if let Err(status) = self.client.clone().end(request).await {
            tracing::debug!(backend = %self, "end of session {session:?}: {status}");
        }
    }

    async fn infer(&self, mut request: InferRequest) -> Result<InferResponse, BackendError> {
        request.policy.clone_from(&self.address.policy);
        self.call(self.client.clone().infer(request)).await
    }

    async fn infer_batch(
        &self,
        mut requests: Vec<InferRequest>,
    ) -> Result<Vec<Result<InferResponse, BackendError>>, BackendError> {
        for request in &mut requests {
            request.policy.clone_from(&self.address.policy);
        }
        let asked = requests.len();
        let request = InferBatchRequest { queries: requests };
        let batch = self.call(self.client.clone().infer_batch(request)).await?;
        let answered = batch.results.len();
        if answered != asked {
            return Err(BackendError::BatchSize { asked, answered });
        }
        let answer = |result: InferResult| match result.result {
            Some(infer_result::Result::Response(response)) => Ok(response),
            Some(infer_result::Result::Error(message)) => Err(BackendError::Policy { message }),
            None => Ok(InferResponse::default()),
        };
        Ok(batch.results.into_iter().map(answer).collect())
    }
}

impl fmt::Display for GrpcBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.address.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_may_name_one_of_several_policies() {
        let address: GrpcAddress = "grpc://gpu7:5000/pi05".parse().expect("an address");
        assert_eq!(
            address,
            GrpcAddress { authority: "gpu7:5000".into(), policy: "pi05".into(), encrypted: false }
        );
        for text in ["grpc://gpu7:5000/pi05", "grpc://[::1]:5000", "https://gpu7:5000"] {
            let address: GrpcAddress = text.parse().expect(text);
            assert_eq!(address.to_string(), text);
        }
    }

    #[test]
    fn an_address_without_host_or_port_is_refused_with_the_form_to_write() {
        for text in ["", "gpu7", ":5000", "gpu7:", "gpu7:99999", "gpu 7:5000"] {
            let text = format!("grpc://{text}");
            let error = text.parse::<GrpcAddress>().expect_err(&text);
            assert!(error.to_string().contains("HOST:PORT"), "{error}");
        }
    }
}
