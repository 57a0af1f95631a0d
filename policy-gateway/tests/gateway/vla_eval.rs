//! Scripted vla-eval model servers, with faults that real servers cannot be made to produce.
//! `policies/tests/test_vla_eval.py` tests the gateway with real model servers.

use std::sync::Arc;
use std::time::Duration;

use benchmark::Suite;
use futures_util::{SinkExt, StreamExt};
use policy_gateway::config::{self, RouteSpec};
use policy_gateway::doctor::synthetic;
use proto::policy::InferRequest;
use proto::policy::policy_client::PolicyClient;
use rmpv::Value;
use tokio::net::TcpListener;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::JoinSet;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::handshake::server::{Request, Response};
use tokio_tungstenite::{WebSocketStream, accept_hdr_async};
use tonic::transport::Channel;
use tonic::{Code, Status};

use crate::assertions::assert_refused;
use crate::support::{Running, describe, gateway, infer, reloadable, reset};

/// Reaction of a server to a message.
#[derive(Clone)]
enum Answer {
    Message(Vec<u8>),
    Text(&'static str),
    Close,
    Nothing,
}

#[derive(Debug, PartialEq)]
enum ServerEvent {
    /// A connection, with the value of its `Authorization` header.
    Connected(Option<String>),
    Received(String),
    Disconnected,
}

/// A server whose answers a function computes from a message's type and number.
struct Server {
    port: u16,
    events: UnboundedReceiver<ServerEvent>,
    _task: JoinSet<()>,
}

impl Server {
    async fn start(answer: impl Fn(&str, u64) -> Answer + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let port = listener.local_addr().expect("a bound address").port();
        let answer = Arc::new(answer);
        let (event_sender, events) = unbounded_channel();
        let mut task = JoinSet::new();
        task.spawn(async move {
            let mut connections = JoinSet::new();
            while let Ok((stream, _)) = listener.accept().await {
                let (answer, event_sender) = (Arc::clone(&answer), event_sender.clone());
                connections.spawn(async move {
                    let header_sender = event_sender.clone();
                    // The library fixes the closure's error type, which is large.
                    #[allow(clippy::result_large_err)]
                    let record_header = |request: &Request, response: Response| {
                        let header = request.headers().get("authorization");
                        let header =
                            header.map(|header| header.to_str().expect("ASCII").to_owned());
                        drop(header_sender.send(ServerEvent::Connected(header)));
                        Ok(response)
                    };
                    // The probe after a failure is no WebSocket handshake.
                    if let Ok(socket) = accept_hdr_async(stream, record_header).await {
                        serve(socket, &*answer, &event_sender).await;
                        drop(event_sender.send(ServerEvent::Disconnected));
                    }
                });
            }
        });
        Self { port, events, _task: task }
    }

    fn route(&self) -> String {
        format!("x=vla-eval://127.0.0.1:{}", self.port)
    }

    async fn behind_a_gateway(&self) -> (Running, PolicyClient<Channel>) {
        let gateway = gateway(&[&self.route()]).await;
        let client = gateway.client().await;
        (gateway, client)
    }
}

async fn serve(
    mut socket: WebSocketStream<tokio::net::TcpStream>,
    answer: &(impl Fn(&str, u64) -> Answer + Sync),
    event_sender: &UnboundedSender<ServerEvent>,
) {
    while let Some(Ok(message)) = socket.next().await {
        let Message::Binary(bytes) = message else {
            continue;
        };
        let received = rmpv::decode::read_value(&mut &*bytes).expect("msgpack");
        let kind = received["type"].as_str().expect("text").to_owned();
        let number = received["seq"].as_u64().expect("a number");
        drop(event_sender.send(ServerEvent::Received(kind.clone())));
        let sent = match answer(&kind, number) {
            Answer::Message(bytes) => socket.send(Message::binary(bytes)).await,
            Answer::Text(text) => socket.send(Message::text(text)).await,
            Answer::Close => return,
            Answer::Nothing => Ok(()),
        };
        if sent.is_err() {
            return;
        }
    }
}

fn map(entries: Vec<(&str, Value)>) -> Value {
    let entries = entries.into_iter();
    Value::Map(entries.map(|(key, value)| (key.into(), value)).collect())
}

fn message(kind: &str, payload: Value, number: u64) -> Answer {
    let message = map(vec![
        ("type", kind.into()),
        ("payload", payload),
        ("seq", number.into()),
        ("timestamp", 0.0.into()),
    ]);
    let mut bytes = vec![];
    rmpv::encode::write_value(&mut bytes, &message).expect("a vector");
    Answer::Message(bytes)
}

fn greeting(number: u64) -> Answer {
    let payload = vec![
        ("harness_version", "0.8.0".into()),
        ("protocol_version", 1.into()),
        ("model_server", "Scripted".into()),
    ];
    message("hello", map(payload), number)
}

fn action(numbers: Vec<Value>, number: u64) -> Answer {
    let payload = map(vec![("actions", Value::Array(numbers))]);
    message("action", payload, number)
}

/// Returns the reactions of a server that greets, and answers observations with the given function.
fn answering(
    answer_observation: impl Fn(u64) -> Answer + Send + Sync + 'static,
) -> impl Fn(&str, u64) -> Answer + Send + Sync + 'static {
    move |kind, number| match kind {
        "hello" => greeting(number),
        "observation" => answer_observation(number),
        _ => Answer::Nothing,
    }
}

async fn query(
    client: &mut PolicyClient<Channel>,
    session: &str,
    query_index: u32,
) -> Result<Vec<f32>, Status> {
    let described = client.describe(describe("x")).await?.into_inner();
    let request = InferRequest {
        observation: Some(
            synthetic::situations(Suite::Object)[query_index as usize].observation(&described),
        ),
        ..infer("x", session, query_index)
    };
    Ok(client.infer(request).await?.into_inner().actions)
}

#[tokio::test]
async fn an_invalid_answer_is_named_and_ends_the_episode_if_necessary() {
    let short_of_numbers = |number| {
        let array = map(vec![
            ("__ndarray__", true.into()),
            ("data", Value::Binary(vec![0; 27])),
            ("dtype", "<f4".into()),
            ("shape", Value::Array(vec![7.into()])),
        ]);
        message("action", map(vec![("actions", array)]), number)
    };
    type AnswerFunction = fn(u64) -> Answer;
    let cases: [(AnswerFunction, &str, Code); 8] = [
        (
            |_| Answer::Message(vec![0xdf, 1, 2]),
            "not a message of vla-eval's protocol",
            Code::Unavailable,
        ),
        (|_| Answer::Text("Traceback"), "not a message of vla-eval's protocol", Code::Unavailable),
        (greeting, "of type \"hello\"", Code::Unavailable),
        (
            |number| action(vec![0.0.into(); 7], number - 1),
            "without continuous_inference",
            Code::Unavailable,
        ),
        (
            |number| action(vec![0.into(); 2 << 20], number),
            "a message of more than 1 MiB",
            Code::Unavailable,
        ),
        // After these answers, the connection can be used for the next query.
        (short_of_numbers, "not an array of numbers", Code::Internal),
        (
            |number| action(vec!["left".into(); 7], number),
            "not an array of numbers",
            Code::Internal,
        ),
        (
            |number| message("error", map(vec![("error", "no".into())]), number),
            "no",
            Code::Internal,
        ),
    ];
    for (answer, words, second_code) in cases {
        let server = Server::start(answering(answer)).await;
        let (_gateway, mut client) = server.behind_a_gateway().await;
        client.reset(reset("x", "s")).await.expect("an episode");
        let first = query(&mut client, "s", 0).await.expect_err(words);
        assert_eq!(first.code(), Code::Internal, "{first}");
        assert!(first.message().contains(words), "{first}");
        let second = query(&mut client, "s", 0).await.expect_err(words);
        assert_eq!(second.code(), second_code, "{words}: {second}");
    }
}

#[tokio::test]
async fn a_connection_that_breaks_in_a_query_is_an_outage() {
    let server = Server::start(answering(|_| Answer::Close)).await;
    let (_gateway, mut client) = server.behind_a_gateway().await;
    client.reset(reset("x", "s")).await.expect("an episode");
    assert_refused(query(&mut client, "s", 0).await, Code::Unavailable, &["cannot reach"]);
}

#[tokio::test]
async fn other_servers_and_other_versions_are_recognised() {
    type Greeting = fn(&str, u64) -> Answer;
    let cases: [(Greeting, &str); 4] = [
        // Stands for the metadata that openpi's servers send first: it is no HELLO.
        (
            |_, _| {
                let Answer::Message(metadata) = message("none", map(vec![]), 0) else {
                    unreachable!("`message` returns a message");
                };
                Answer::Message(metadata)
            },
            "ws://HOST:PORT for an openpi server",
        ),
        (|_, _| Answer::Text("hello"), "vla-eval model server"),
        (
            |_, number| {
                let payload = map(vec![("protocol_version", 2.into())]);
                message("hello", payload, number)
            },
            "version 2 of vla-eval's protocol",
        ),
        (|_, number| message("hello", map(vec![]), number), "an unnamed version"),
    ];
    for (greeting, words) in cases {
        let server = Server::start(greeting).await;
        let (_gateway, mut client) = server.behind_a_gateway().await;
        let refused = client.reset(reset("x", "s")).await.expect_err(words);
        assert_eq!(refused.code(), Code::FailedPrecondition, "{refused}");
        assert!(refused.message().contains(words), "{words}: {refused}");
    }
}

#[tokio::test]
async fn a_late_answer_is_not_the_answer_to_another_query() {
    let mut server = Server::start(answering(|_| Answer::Nothing)).await;
    let spec = RouteSpec {
        answer_within: Duration::from_millis(300),
        ..server.route().parse().expect("a route")
    };
    let (gateway, _) = reloadable(vec![spec]).await;
    let mut client = gateway.client().await;
    client.reset(reset("x", "s")).await.expect("an episode");
    assert_refused(query(&mut client, "s", 0).await, Code::DeadlineExceeded, &[]);
    // The connection of the query is closed; that of the description stays open.
    let mut events = vec![];
    while events.last() != Some(&ServerEvent::Disconnected) {
        events.push(server.events.recv().await.expect("a server"));
    }
    let observation = ServerEvent::Received("observation".to_owned());
    assert!(events.contains(&observation), "{events:?}");
}

#[tokio::test]
async fn queries_of_an_episode_are_answered_in_order_only() {
    let server = Server::start(answering(|number| action(vec![0.5.into(); 7], number))).await;
    let (_gateway, mut client) = server.behind_a_gateway().await;
    client.reset(reset("x", "s")).await.expect("an episode");
    assert_refused(query(&mut client, "s", 1).await, Code::FailedPrecondition, &[]);
    for query_index in 0..3 {
        let actions = query(&mut client, "s", query_index).await.expect("actions");
        assert_eq!(actions, [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 1.0]);
    }
}

#[tokio::test]
async fn a_token_is_sent_to_a_proxy_in_front_of_the_server() {
    let mut server = Server::start(answering(|_| Answer::Nothing)).await;
    let folder = tempfile::tempdir().expect("a folder");
    let token = folder.path().join("token");
    std::fs::write(&token, "worker secret-of-the-proxy-0123\n").expect("written");
    let private = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    std::fs::set_permissions(&token, private).expect("set");
    let file = folder.path().join("gateway.toml");
    let text = format!(
        "[policy.x]\nreplicas = [\"vla-eval://127.0.0.1:{}\"]\ntoken_file = {token:?}\n",
        server.port
    );
    std::fs::write(&file, text).expect("written");
    let config = config::read(&file).expect("a configuration");
    let (gateway, _) = reloadable(config.routes().to_vec()).await;
    let mut client = gateway.client().await;
    client.describe(describe("x")).await.expect("a description");
    let header = Some("Bearer secret-of-the-proxy-0123".to_owned());
    assert_eq!(server.events.recv().await, Some(ServerEvent::Connected(header)));
}
