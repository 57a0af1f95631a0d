//! More sessions than a server can answer at once. The server is simulated and slow: it computes
//! one query after the other, each in a fixed time.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use policy_gateway::config::RouteSpec;
use proto::policy::policy_client::PolicyClient;
use proto::policy::policy_server::{Policy, PolicyServer};
use proto::policy::{
    DescribeRequest, DescribeResponse, EndRequest, InferBatchRequest, InferBatchResponse,
    InferRequest, InferResponse, InferResult, ResetRequest, ResetResponse, infer_result,
};
use tokio::sync::{Mutex, Semaphore};
use tokio::task::JoinSet;
use tonic::transport::server::TcpIncoming;
use tonic::transport::{Channel, Server};
use tonic::{Code, Request, Response, Status};

use crate::support::{
    Running, chunk, client, description, gateway, infer, reloadable, reset, serve,
};

/// A simulated server that computes one query after the other, while the gate is open.
struct SlowServer {
    per_query: Duration,
    max_batch: u32,
    computing: Arc<Mutex<()>>,
    gate: Arc<Semaphore>,
    /// Queries whose computation has begun.
    begun: Arc<AtomicUsize>,
    /// Calls that have arrived and whose callers still wait.
    awaited: Arc<AtomicUsize>,
}

/// Counts a call while its caller waits.
struct Awaited(Arc<AtomicUsize>);

impl Drop for Awaited {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

impl SlowServer {
    fn new(per_query: Duration) -> Self {
        Self {
            per_query,
            max_batch: 1,
            computing: Arc::default(),
            gate: Arc::new(Semaphore::new(1)),
            begun: Arc::default(),
            awaited: Arc::default(),
        }
    }

    /// Computes the queries of one call, together in the time `per_query`, after those of earlier
    /// calls, unless the caller has disconnected by then. A computation that has begun runs to its
    /// end.
    async fn compute(&self, queries: usize) {
        self.awaited.fetch_add(1, Ordering::SeqCst);
        let _awaited = Awaited(Arc::clone(&self.awaited));
        let turn = Arc::clone(&self.computing).lock_owned().await;
        self.begun.fetch_add(queries, Ordering::SeqCst);
        let (gate, per_query) = (Arc::clone(&self.gate), self.per_query);
        #[expect(
            clippy::disallowed_methods,
            reason = "a computation continues after its caller has disconnected"
        )]
        let computed = tokio::spawn(async move {
            let _open = gate.acquire().await;
            tokio::time::sleep(per_query).await;
            drop(turn);
        });
        computed.await.expect("no panic");
    }
}

#[tonic::async_trait]
impl Policy for SlowServer {
    async fn describe(
        &self,
        _: Request<DescribeRequest>,
    ) -> Result<Response<DescribeResponse>, Status> {
        Ok(Response::new(DescribeResponse {
            max_batch: self.max_batch,
            execute: 8,
            ..description("slow", 8)
        }))
    }

    async fn reset(&self, _: Request<ResetRequest>) -> Result<Response<ResetResponse>, Status> {
        Ok(Response::new(ResetResponse {}))
    }

    async fn infer(&self, _: Request<InferRequest>) -> Result<Response<InferResponse>, Status> {
        self.compute(1).await;
        Ok(Response::new(chunk(&[0.0; 7], 7)))
    }

    async fn infer_batch(
        &self,
        request: Request<InferBatchRequest>,
    ) -> Result<Response<InferBatchResponse>, Status> {
        let queries = request.into_inner().queries.len();
        self.compute(queries).await;
        let result =
            InferResult { result: Some(infer_result::Result::Response(chunk(&[0.0; 7], 7))) };
        let results = vec![result; queries];
        Ok(Response::new(InferBatchResponse { results }))
    }
}

/// Starts a gateway in front of a server, with this time limit for an answer.
async fn gateway_for(server: &Running, answer_within: Duration) -> Running {
    let route = format!("slow=grpc://{}", server.address);
    let spec = RouteSpec { answer_within, ..route.parse().expect("a route") };
    reloadable(vec![spec]).await.0
}

async fn send_queries(
    client: &mut PolicyClient<Channel>,
    session: &str,
    queries: u32,
) -> Result<(), Status> {
    for query in 0..queries {
        client.infer(infer("slow", session, query)).await?;
    }
    Ok(())
}

fn end(session: &str) -> EndRequest {
    EndRequest { policy: "slow".to_owned(), session: session.to_owned() }
}

/// Regression: the time that a query waited for its turn counted toward the time limit of its
/// answer, a single time-out was taken for an outage of the server, and all sessions were given up.
/// The times are a 25th of those of 128 slots with 0.4 s per query.
#[tokio::test(flavor = "multi_thread")]
async fn many_slots_at_a_slow_server_finish_their_episodes() {
    let server = serve(SlowServer::new(Duration::from_millis(16))).await;
    let gateway = gateway_for(&server, Duration::from_secs(2)).await;
    let mut slots = vec![];
    for slot in 0..128 {
        let (mut client, session) = (client(gateway.address).await, format!("slot {slot}"));
        client.reset(reset("slow", &session)).await.expect("an episode");
        slots.push((client, session));
    }
    let mut playing = JoinSet::new();
    for (mut client, session) in slots {
        playing.spawn(async move { send_queries(&mut client, &session, 3).await });
    }
    while let Some(played) = playing.join_next().await {
        let played = played.expect("no slot panicked");
        played.expect("every query is answered");
    }
}

/// Waits until a count has the expected value.
async fn wait_for_count(count: &AtomicUsize, expected: usize) {
    while count.load(Ordering::SeqCst) != expected {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_query_whose_caller_has_disconnected_is_never_computed() {
    // Of eight queries, the gateway sends all at once to a server without batches. To a server with
    // batches, it sends two batches; the remaining queries wait in the gateway.
    for (max_batch, calls) in [(1, 8), (2, 2)] {
        let policy = SlowServer {
            max_batch,
            gate: Arc::new(Semaphore::new(0)),
            ..SlowServer::new(Duration::ZERO)
        };
        let (gate, begun) = (Arc::clone(&policy.gate), Arc::clone(&policy.begun));
        let awaited = Arc::clone(&policy.awaited);
        let server = serve(policy).await;
        let gateway = gateway_for(&server, Duration::from_secs(60)).await;
        let mut client = gateway.client().await;
        let mut callers = JoinSet::new();
        for slot in 0..8 {
            let session = format!("slot {slot}");
            client.reset(reset("slow", &session)).await.expect("an episode");
            let mut client = client.clone();
            callers.spawn(async move { client.infer(infer("slow", &session, 0)).await });
        }
        wait_for_count(&awaited, calls).await;
        callers.shutdown().await;
        // Arrives after the ends of the other calls, on the same connection.
        client.reset(reset("slow", "last")).await.expect("an episode");
        // The gateway ends the streams of a connection in separate tasks, so that a caller that
        // gave up may still be in the server's queue for a moment after the Reset.
        let mut quiet_checks = 0;
        while quiet_checks < 50 {
            wait_for_count(&awaited, 0).await;
            tokio::time::sleep(Duration::from_millis(2)).await;
            quiet_checks = if awaited.load(Ordering::SeqCst) == 0 { quiet_checks + 1 } else { 0 };
        }
        let before = begun.load(Ordering::SeqCst);
        assert!((1..=max_batch as usize).contains(&before), "{before}");
        gate.add_permits(1);
        let answer = client.infer(infer("slow", "last", 0)).await;
        answer.expect("an answer");
        assert_eq!(begun.load(Ordering::SeqCst), before + 1);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_beyond_the_capacity_wait_for_another_to_end() {
    // At this speed, four sessions get their answers in time.
    let server = serve(SlowServer::new(Duration::from_millis(250))).await;
    let gateway = gateway_for(&server, Duration::from_secs(1)).await;
    let mut client = gateway.client().await;
    // From these answers, the gateway learns the server's speed.
    client.reset(reset("slow", "first")).await.expect("an episode");
    send_queries(&mut client, "first", 8).await.expect("answers");
    client.end(end("first")).await.expect("an end");
    for slot in 0..4 {
        let session = format!("slot {slot}");
        client.reset(reset("slow", &session)).await.expect("capacity");
    }
    // An open session keeps its place.
    client.reset(reset("slow", "slot 0")).await.expect("an open session");
    let refused = client.reset(reset("slow", "fifth")).await;
    let refused = refused.expect_err("no capacity");
    assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");
    for part in ["route slow has 4 rollouts under way", "run fewer slots"] {
        assert!(refused.message().contains(part), "{part} in {refused}");
    }
    let mut fifth = client.clone();
    let mut waiting = tokio::task::JoinSet::new();
    waiting.spawn(async move {
        while let Err(refused) = fifth.reset(reset("slow", "fifth")).await {
            assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");
        }
    });
    client.end(end("slot 1")).await.expect("an end");
    let waited = waiting.join_next().await.expect("a task");
    waited.expect("the waiting session is opened");
}

/// A server, or a proxy before it, retires its connections and ends the calls that are still in
/// progress after the grace.
#[tokio::test(flavor = "multi_thread")]
async fn connections_that_a_server_retires_cost_no_query() {
    for grace in [Duration::from_secs(5), Duration::from_millis(10)] {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("a bound address");
        let retiring = Server::builder()
            .max_connection_age(Duration::from_millis(150))
            .max_connection_age_grace(grace)
            .add_service(PolicyServer::new(SlowServer::new(Duration::from_millis(20))))
            .serve_with_incoming(TcpIncoming::from(listener));
        let mut tasks = JoinSet::new();
        tasks.spawn(async { retiring.await.expect("serves") });
        let gateway = gateway(&[&format!("slow=grpc://{address}")]).await;
        // The connection of slots, and that of the gateway.
        for address in [address, gateway.address] {
            let endpoint = transport::parse_endpoint(&format!("http://{address}"));
            let connection = transport::Access::none().connect_lazy(endpoint.expect("a URL"));
            let client = PolicyClient::new(connection.expect("a connection"));
            let sessions = (0..4).map(async |session: u32| {
                let (mut client, session) = (client.clone(), session.to_string());
                client.reset(reset("", &session)).await.expect("an episode");
                for query in 0..10 {
                    client.infer(infer("", &session, query)).await.expect("an answer");
                }
            });
            futures_util::future::join_all(sessions).await;
        }
    }
}
