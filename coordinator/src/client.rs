//! Client of the operator service: connects, retries while the coordinator is unreachable, and
//! distinguishes invalid requests from refused ones.

use std::time::Duration;

use benchmark::{CampaignSpec, JsonError};
use proto::coordinator as wire;
use proto::coordinator::operator_service_client::OperatorServiceClient;
use queue::clock::UnixMillis;
use queue::read::CampaignStatus;
use report::Subject;
use serde::de::DeserializeOwned;
use tokio::time::Instant;
use tonic::{Code, Response, Status, Streaming};
use transport::{
    Access, AccessError, ConnectError, Connection, EndpointError, Peer, ServerKind, Settings,
    parse_endpoint, status_text,
};

/// Default time for which a command retries an unreachable coordinator.
pub const RETRY_FOR: Duration = Duration::from_secs(30);
/// First and longest pause between retries; each pause is twice the previous one.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
const LONGEST_PAUSE: Duration = Duration::from_secs(4);
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Flags and URL prefixes that error messages name.
const SETTINGS: Settings =
    Settings { address: "--connect", authority: "--ca", clear: "http://", encrypted: "https://" };

/// Generated client of the operator service, whose methods [`Client::call`] takes.
pub type Service = OperatorServiceClient<Connection>;

/// Client of a coordinator, which connects lazily.
#[derive(Clone, Debug)]
pub struct Client {
    url: String,
    retry_for: Duration,
    service: Service,
    peer: Peer,
}

#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    #[error(transparent)]
    Url(#[from] EndpointError),
    /// TLS access cannot be set up, for example because the URL's host is no valid TLS name.
    #[error(transparent)]
    Access(#[from] AccessError),
    #[error("reach the coordinator at {url}: {trouble}")]
    Unreachable { url: String, trouble: Box<ConnectError> },
    #[error("{message}")]
    Invalid { message: String },
    #[error("{message}")]
    Refused { message: String },
}

impl Client {
    pub fn new(url: &str, access: &Access, retry_for: Duration) -> Result<Client, ClientError> {
        let endpoint = parse_endpoint(url)?;
        let endpoint = endpoint.connect_timeout(CONNECT_TIMEOUT).tcp_nodelay(true);
        let peer = Peer::new(&endpoint, ServerKind::Coordinator, SETTINGS);
        let connection = access.connect_lazy(endpoint)?;
        Ok(Client {
            url: url.to_owned(),
            retry_for,
            service: Service::new(connection)
                .max_decoding_message_size(proto::MAX_MESSAGE_BYTES)
                .max_encoding_message_size(proto::MAX_MESSAGE_BYTES),
            peer,
        })
    }

    /// Returns the status of all campaigns, oldest first.
    pub async fn list_campaigns(&self) -> Result<Vec<CampaignStatus>, ClientError> {
        self.ask(wire::ListCampaignsRequest {}, Service::list_campaigns).await
    }

    pub async fn campaign_status(&self, name: &str) -> Result<CampaignStatus, ClientError> {
        let request = wire::GetCampaignRequest { campaign: name.to_owned() };
        self.ask(request, Service::get_campaign).await
    }

    pub async fn specification(&self, name: &str) -> Result<CampaignSpec, ClientError> {
        let request = wire::GetCampaignRequest { campaign: name.to_owned() };
        self.collect(request, Service::get_specification).await
    }

    pub async fn report(&self, name: &str) -> Result<Subject, ClientError> {
        let request = wire::ReportRequest { campaign: name.to_owned() };
        self.collect(request, Service::report).await
    }

    /// Sends a request like [`Self::call`], and reads the value that the answer's parts form.
    async fn collect<Q: Clone, T: DeserializeOwned>(
        &self,
        request: Q,
        send: impl AsyncFn(&mut Service, Q) -> Result<Response<Streaming<wire::ReportPart>>, Status>,
    ) -> Result<T, ClientError> {
        let mut parts = self.call(request, send).await?;
        let mut json = Vec::new();
        while let Some(part) = self.next(&mut parts).await? {
            json.extend(part.json);
        }
        self.read(&json)
    }

    fn read<T: DeserializeOwned>(&self, json: &[u8]) -> Result<T, ClientError> {
        serde_json::from_slice(json).map_err(|error| ClientError::Refused {
            message: format!(
                "read the answer of the coordinator at {} ({}): use the same version of both \
                 programs",
                self.url,
                JsonError::from(error).problem()
            ),
        })
    }

    /// Sends a request like [`Self::call`], and reads the value in the answer.
    pub async fn ask<Q: Clone, T: DeserializeOwned>(
        &self,
        request: Q,
        send: impl AsyncFn(&mut Service, Q) -> Result<Response<wire::Answer>, Status>,
    ) -> Result<T, ClientError> {
        Ok(self.ask_at(request, send).await?.1)
    }

    /// Does what [`Self::ask`] does, and returns the time of the answer, too.
    pub async fn ask_at<Q: Clone, T: DeserializeOwned>(
        &self,
        request: Q,
        send: impl AsyncFn(&mut Service, Q) -> Result<Response<wire::Answer>, Status>,
    ) -> Result<(UnixMillis, T), ClientError> {
        let answer = self.call(request, send).await?;
        Ok((UnixMillis(answer.now_unix_ms), self.read(answer.json.as_bytes())?))
    }

    /// Returns the next message of a streamed response; `None` after the last.
    pub async fn next<T>(&self, answer: &mut Streaming<T>) -> Result<Option<T>, ClientError> {
        match answer.message().await {
            Ok(next) => Ok(next),
            Err(status) => Err(self.call_error(&status, self.peer.diagnose(&status))),
        }
    }

    /// Sends a request, and retries it until the coordinator responds or the retry time is over.
    /// All operator calls are safe to repeat.
    pub async fn call<Q: Clone, T>(
        &self,
        request: Q,
        send: impl AsyncFn(&mut Service, Q) -> Result<Response<T>, Status>,
    ) -> Result<T, ClientError> {
        let deadline = Instant::now() + self.retry_for;
        let mut pause = FIRST_PAUSE;
        let mut is_reported = false;
        loop {
            let status = match send(&mut self.service.clone(), request.clone()).await {
                Ok(response) => return Ok(response.into_inner()),
                Err(status) => status,
            };
            let trouble = self.peer.diagnose(&status);
            let is_transient = match &trouble {
                Some(trouble) => !trouble.fault.is_final(),
                None => status.code() == Code::Unavailable,
            };
            if !is_transient || Instant::now() + pause > deadline {
                return Err(self.call_error(&status, trouble));
            }
            if !is_reported {
                is_reported = true;
                let reason = match &trouble {
                    Some(trouble) => trouble.finding.clone(),
                    None => status_text(&status),
                };
                terminal::complain(&format!(
                    "no answer from the coordinator at {}: {reason}; trying again for {} s",
                    self.url,
                    self.retry_for.as_secs()
                ));
            }
            tokio::time::sleep(pause).await;
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }

    /// Converts the status of a failed call to an error; `trouble` describes why the coordinator
    /// could not be reached.
    fn call_error(&self, status: &Status, trouble: Option<ConnectError>) -> ClientError {
        if let Some(trouble) = trouble {
            return ClientError::Unreachable { url: self.url.clone(), trouble: trouble.into() };
        }
        let message = status_text(status);
        match status.code() {
            Code::InvalidArgument => ClientError::Invalid { message },
            _ => ClientError::Refused { message },
        }
    }
}
