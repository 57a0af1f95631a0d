//! Simulated slots: each has a connection of its own, like a worker, and one session that sends the
//! same synthetic observation repeatedly.

use std::time::Duration;

use anyhow::{Context, Result};
use policy_backends::http2::{CONNECTION_WINDOW_BYTES, STREAM_WINDOW_BYTES};
use policy_doctor::conformance::scene;
use proto::policy::{DescribeRequest, InferRequest, ResetRequest, policy_client::PolicyClient};
use serde_json::{Value, json};
use tonic::{
    Status,
    transport::{Channel, Endpoint},
};

/// The synthetic task's suite.
const SUITE: &str = "libero_object";

/// One slot, with its session open.
#[derive(Clone)]
pub(crate) struct Slot {
    client: PolicyClient<Channel>,
    query: InferRequest,
}

impl Slot {
    /// Connects to `host:port`, requests the policy's description and opens a session.
    pub(crate) async fn open(address: &str, policy: &str, number: u32) -> Result<Self> {
        let channel = Endpoint::from_shared(format!("http://{address}"))?
            .tcp_nodelay(true)
            .initial_stream_window_size(STREAM_WINDOW_BYTES)
            .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
            .connect()
            .await
            .with_context(|| format!("reach {address}"))?;
        let mut client = PolicyClient::new(channel)
            .max_decoding_message_size(proto::MAX_MESSAGE_BYTES)
            .max_encoding_message_size(proto::MAX_MESSAGE_BYTES);
        let described = client
            .describe(DescribeRequest {
                protocol_version: proto::PROTOCOL_VERSION,
                policy: policy.to_owned(),
                suite: SUITE.to_owned(),
            })
            .await?
            .into_inner();
        let query = InferRequest {
            policy: policy.to_owned(),
            session: format!("slot {number} of {}", std::process::id()),
            query_index: 0,
            observation: Some(scene::observation(&described, number)),
            under_way: None,
        };
        let reset = ResetRequest {
            policy: policy.to_owned(),
            session: query.session.clone(),
            suite: SUITE.to_owned(),
            instruction: "pick up the butter and place it in the basket".to_owned(),
            seed: u64::from(number),
        };
        client.reset(reset).await?;
        Ok(Self { client, query })
    }

    /// Opens slots 0, 1, 2, ….
    pub(crate) async fn open_all(address: &str, policy: &str, slots: u32) -> Result<Vec<Self>> {
        let mut open = Vec::new();
        for number in 0..slots {
            open.push(Self::open(address, policy, number).await?);
        }
        Ok(open)
    }

    /// Opens another session on the same connection.
    pub(crate) async fn open_another(&self, number: u32) -> Result<Self> {
        let mut other = self.clone();
        other.query.session = format!("sibling {number} of {}", std::process::id());
        let reset = ResetRequest {
            policy: other.query.policy.clone(),
            session: other.query.session.clone(),
            suite: SUITE.to_owned(),
            ..ResetRequest::default()
        };
        other.client.reset(reset).await?;
        Ok(other)
    }

    /// Sends one query.
    pub(crate) async fn query(&self, query_index: u32) -> Result<(), Status> {
        let query = InferRequest { query_index, ..self.query.clone() };
        self.client.clone().infer(query).await.map(drop)
    }
}

/// Percentiles of latencies, ms.
pub(crate) fn percentiles(latencies: &[Duration]) -> Value {
    json!({
        "p50": percentile_millis(latencies, 0.5),
        "p99": percentile_millis(latencies, 0.99),
        "most": percentile_millis(latencies, 1.0),
    })
}

/// Returns the latency that a share of the queries does not exceed, ms.
pub(crate) fn percentile_millis(latencies: &[Duration], share: f64) -> f64 {
    let mut sorted = latencies.to_vec();
    sorted.sort_unstable();
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.max(1) - 1).map_or(f64::NAN, |latency| latency.as_secs_f64() * 1e3)
}

/// Returns minimum, median and maximum of several measurements.
pub(crate) fn spread(values: &[f64]) -> Value {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    json!({
        "least": sorted.first(),
        "median": sorted.get(sorted.len() / 2),
        "most": sorted.last(),
    })
}
