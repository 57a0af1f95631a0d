//! Sessions of workers of several campaigns at one gateway.

use std::time::Duration;

use benchmark::RolloutId;
use benchmark::attempt::AttemptId;
use proto::policy::policy_server::Policy;
use proto::policy::{
    DescribeRequest, DescribeResponse, EndRequest, EndResponse, InferRequest, InferResponse,
    Observation, ResetRequest, ResetResponse,
};
use tokio::sync::mpsc;
use tonic::{Request, Response, Status};
use transport::Access;
use worker::actor::{Actor, PolicySession};
use worker::message::Session;
use worker::policy::{PolicyClient, ROLLOUT_SETTINGS};

use crate::program::{address, program};
use crate::support::{Scripted, chunk, description, infer, reloadable, reset, serve};

/// Session of a rollout, and the policy seed that its worker sends.
struct Episode {
    session: Session,
    seed: u64,
}

impl Episode {
    fn policy_session(&self) -> PolicySession<'_> {
        PolicySession {
            policy: "stateful",
            session: self.session.as_str(),
            suite: "libero_object",
            deadline: Duration::from_secs(10),
        }
    }
}

/// Regression: the name of a session was made of rollout, replicate and attempt number, which are
/// the same in two campaigns or coordinators. Since the gateway answers a repeated query from
/// memory, one rollout executed the actions of another rollout.
#[tokio::test(flavor = "multi_thread")]
async fn equal_rollouts_of_two_campaigns_get_their_own_answers() {
    let described = DescribeResponse { stateful: true, ..description("stateful", 1) };
    // Answers with the seed, which identifies the episode, and the index of the query.
    let policy = serve(Scripted::new(described, |query| {
        let seed = query.seed.unwrap_or(0) as f32;
        let index = query.query_index as f32;
        Ok(chunk(&[seed, index, 0.0, 0.0, 0.0, 0.0, 0.0], 7))
    }))
    .await;
    let route = format!("stateful=grpc://{}", policy.address);
    let mut gateway = program(&["--listen", "127.0.0.1:0", "--route", &route])
        .spawn()
        .expect("the program starts");
    let endpoint = format!("grpc://{}", address(&mut gateway));

    let rollouts = tokio::task::spawn_blocking(move || {
        let rollout: RolloutId = "object/t0/nominal/i03".parse().expect("an id");
        let episodes = [1_u8, 2].map(|campaign| Episode {
            session: Session::new(&rollout, 0, AttemptId::from_random([campaign; 16])),
            seed: campaign.into(),
        });
        let client = |_| {
            PolicyClient::new(&endpoint, &Access::none(), ROLLOUT_SETTINGS).expect("an endpoint")
        };
        let mut clients = [0, 1].map(client);
        for (client, episode) in clients.iter_mut().zip(&episodes) {
            let (session, seed) = (episode.policy_session(), episode.seed);
            client.describe(session).expect("a description");
            let reset = client.reset(session, "stand still", seed);
            reset.expect("an episode");
        }
        for index in 0..4 {
            for (client, episode) in clients.iter_mut().zip(&episodes) {
                let session = episode.policy_session();
                let answer = client.infer(session, index, Observation::default(), 1, None);
                let action = answer.expect("an answer")[0];
                let expected = [episode.seed as f64, f64::from(index)];
                assert_eq!(action[..2], expected, "{}", episode.session);
            }
        }
    })
    .await;
    gateway.kill().expect("the program runs");
    gateway.wait().expect("the program ends");
    rollouts.expect("every rollout got its own answers");
}

/// A server that records the starts and ends of sessions. Unless `implements_end` is set, it
/// answers End with UNIMPLEMENTED.
struct RecordingPolicy {
    events: mpsc::UnboundedSender<String>,
    implements_end: bool,
}

#[tonic::async_trait]
impl Policy for RecordingPolicy {
    async fn describe(
        &self,
        _: Request<DescribeRequest>,
    ) -> Result<Response<DescribeResponse>, Status> {
        Ok(Response::new(description("noting", 1)))
    }

    async fn reset(
        &self,
        request: Request<ResetRequest>,
    ) -> Result<Response<ResetResponse>, Status> {
        let session = request.into_inner().session;
        let event = format!("begin {session}");
        self.events.send(event).expect("the test receives events");
        Ok(Response::new(ResetResponse {}))
    }

    async fn end(&self, request: Request<EndRequest>) -> Result<Response<EndResponse>, Status> {
        let session = request.into_inner().session;
        let event = format!("end {session}");
        self.events.send(event).expect("the test receives events");
        match self.implements_end {
            true => Ok(Response::new(EndResponse {})),
            false => Err(Status::unimplemented("optional")),
        }
    }

    async fn infer(&self, _: Request<InferRequest>) -> Result<Response<InferResponse>, Status> {
        Ok(Response::new(chunk(&[0.0; 7], 7)))
    }
}

#[tokio::test]
async fn the_end_of_an_episode_reaches_its_server_and_closes_its_session() {
    for implements_end in [true, false] {
        let (events, mut receiver) = mpsc::unbounded_channel();
        let server = serve(RecordingPolicy { events, implements_end }).await;
        let route = format!("x=grpc://{}", server.address);
        let (gateway, _handle) = reloadable(vec![route.parse().expect("a route")]).await;
        let mut client = gateway.client().await;
        for session in ["one", "two"] {
            client.reset(reset("x", session)).await.expect("an episode");
        }
        client.infer(infer("x", "one", 0)).await.expect("an answer");
        let end =
            |session: &str| EndRequest { policy: "x".to_owned(), session: session.to_owned() };
        client.end(end("one")).await.expect("an end");
        client.end(end("one")).await.expect("a repeated end is accepted");
        client.end(end("never opened")).await.expect("no error");
        client.end(end("two")).await.expect("an end");
        let mut received = vec![];
        while !received.contains(&"end two".to_owned()) || !received.contains(&"end one".to_owned())
        {
            received.push(receiver.recv().await.expect("the server runs"));
        }
        received.sort();
        assert_eq!(received, ["begin one", "begin two", "end one", "end two"]);
        // A server that does not implement the call stays healthy.
        client.reset(reset("x", "one")).await.expect("an episode");
        client.infer(infer("x", "one", 0)).await.expect("an answer");
        drop(client);
        gateway.stop().await;
        server.stop().await;
    }
}
