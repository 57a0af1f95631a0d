//! `doctor` names the look in which a server's answers are nearer to recorded actions.

use std::path::Path;

use benchmark::{Look, Suite};
use policy_backends::recording::{Pair, Writer};
use policy_gateway::doctor::looks::{RecordedLook, examine, sessions};
use policy_gateway::doctor::server::Server;
use policy_gateway::doctor::synthetic;
use policy_gateway::doctor::verdict::Verdict;
use proto::policy::{
    InferRequest, InferResponse, Observation, ResetRequest, policy_client::PolicyClient,
};
use tempfile::TempDir;
use tonic::transport::Channel;

use crate::planted::Planted;
use crate::scripted::serve;

/// Darkens a picture about as the newer look does.
fn darker(level: u8) -> u8 {
    (f64::from(level) * f64::from(level) / 255.0) as u8
}

/// Records one query in each of `count` sessions, in both looks, with the planted policy's answers
/// to the frames of the look `trained_on`.
async fn record(folders: [&Path; 2], count: usize, trained_on: usize) {
    let teacher = serve(Planted::sound()).await;
    let channel = Channel::from_shared(format!("http://{}", teacher.address)).expect("a URL");
    let mut teacher = PolicyClient::new(channel.connect().await.expect("a connection"));
    let described = Planted::sound().described;
    let situations = synthetic::situations(Suite::Goal, &synthetic::cameras(&[&described]));
    for number in 0..count {
        let reset = ResetRequest {
            session: format!("s{number}"),
            suite: "libero_goal".to_owned(),
            instruction: situations[0].instruction.clone(),
            seed: number as u64,
            ..ResetRequest::default()
        };
        teacher.reset(reset.clone()).await.expect("a session");
        let older = situations[number].observation(&described).expect("all inputs");
        let mut newer = older.clone();
        for image in &mut newer.images {
            image.rgb = image.rgb.iter().map(|level| darker(*level)).collect::<Vec<_>>().into();
        }
        let query = |observation: &Observation| InferRequest {
            session: reset.session.clone(),
            observation: Some(observation.clone()),
            ..InferRequest::default()
        };
        let looks = [older, newer];
        let answer = teacher.infer(query(&looks[trained_on])).await.expect("an answer");
        let answer: InferResponse = answer.into_inner();
        for (folder, observation) in folders.iter().zip(&looks) {
            let mut writer = Writer::begin(folder, &described, &reset).expect("written");
            let pair = Pair { query: query(observation), answer: answer.clone() };
            writer.add(&pair).expect("written");
            writer.finish().expect("finished");
        }
    }
}

async fn verdict_on(count: usize, trained_on: usize) -> Verdict {
    let folders = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
    record(folders.each_ref().map(TempDir::path), count, trained_on).await;
    let recorded = |look: usize| -> RecordedLook {
        let text = format!("{}={}", Look::ALL[look], folders[look].path().display());
        text.parse().expect("a look and a folder")
    };
    assert!(sessions(&[recorded(0)]).is_err());
    let sessions = sessions(&[recorded(1), recorded(0)]).expect("sessions");
    let student = serve(Planted::sound()).await;
    let spec = format!("grpc://{}", student.address).parse().expect("a back-end");
    let server = Server::connect(&spec, &transport::Access::none(), "libero_goal").await;
    examine(&server.expect("a description"), &sessions).await.expect("a verdict")
}

#[tokio::test]
async fn the_look_of_the_training_is_named_if_enough_sessions_agree() {
    for (trained_on, look) in Look::ALL.into_iter().enumerate() {
        let verdict = verdict_on(8, trained_on).await;
        let expected = format!("it was probably trained on {look}: in 8 of 8 sessions");
        assert!(
            matches!(&verdict, Verdict::Pass { note } if note.starts_with(&expected)),
            "{verdict:?}"
        );
    }
    let verdict = verdict_on(4, 0).await;
    assert!(
        matches!(&verdict, Verdict::Skip { reason } if reason.contains("at least 6 are needed")),
        "{verdict:?}"
    );
}
