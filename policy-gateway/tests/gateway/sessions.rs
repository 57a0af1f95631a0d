//! Workers of several campaigns behind one gateway.

use std::time::Duration;

use attempt::AttemptId;
use proto::policy::{DescribeResponse, Observation};
use protocol::RolloutId;
use transport::Access;
use worker::{
    actor::{Actor, PolicySession},
    message::Session,
    policy::{OF_ONE_ROLLOUT, PolicyClient},
};

use crate::{
    program::{address, program},
    support::{Scripted, chunk, description, serve},
};

/// A rollout as its worker plays it.
struct Episode {
    session: Session,
    seed: u64,
}

impl Episode {
    fn asked(&self) -> PolicySession<'_> {
        PolicySession {
            policy: "stateful",
            session: self.session.as_str(),
            suite: "libero_object",
            deadline: Duration::from_secs(10),
        }
    }
}

/// Defect: a session was named by rollout, replicate and attempt number, which
/// two campaigns and two coordinators count alike. The gateway answers a query
/// that is asked again from memory, so one rollout executed another's actions.
#[tokio::test(flavor = "multi_thread")]
async fn equal_rollouts_of_two_campaigns_get_their_own_answers() {
    let described = DescribeResponse {
        stateful: true,
        ..description("stateful", 1)
    };
    // Tells whose query it is and which: the seed is the episode's.
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

    let asked = tokio::task::spawn_blocking(move || {
        let rollout: RolloutId = "object/t0/clean/i03".parse().expect("an id");
        let episodes = [1_u8, 2].map(|campaign| Episode {
            session: Session::new(&rollout, 0, AttemptId::from_random([campaign; 16])),
            seed: campaign.into(),
        });
        let client =
            |_| PolicyClient::new(&endpoint, &Access::none(), OF_ONE_ROLLOUT).expect("an endpoint");
        let mut clients = [0, 1].map(client);
        for (client, episode) in clients.iter_mut().zip(&episodes) {
            let (asked, seed) = (episode.asked(), episode.seed);
            client.describe(asked).expect("a description");
            let reset = client.reset(asked, "libero_object", "stand still", seed);
            reset.expect("an episode");
        }
        for index in 0..4 {
            for (client, episode) in clients.iter_mut().zip(&episodes) {
                let answer = client.infer(episode.asked(), index, Observation::default(), 1);
                let action = answer.expect("an answer")[0];
                let expected = [episode.seed as f64, f64::from(index)];
                assert_eq!(action[..2], expected, "{}", episode.session);
            }
        }
    })
    .await;
    gateway.kill().expect("it runs");
    gateway.wait().expect("it ends");
    asked.expect("every rollout got its own answers");
}
