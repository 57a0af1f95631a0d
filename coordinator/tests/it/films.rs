//! Choice of the rollouts that are filmed, in a campaign that records transitions.

use proto::coordinator as wire;
use serde_json::json;
use tonic::Code;

use crate::assertions::assert_refused;
use crate::harness::{Bench, Worker, sha, small_spec, with};

/// Longer than the 15 minutes after which an assigned film counts as lost, seconds.
const LONG_SECS: u64 = 16 * 60;

/// Creates a campaign of one configuration that stores actions, with outcomes for the nominal
/// rollout and both single axes. Returns the simultaneous rollout's lease.
async fn commit_all_but_simultaneous(outcome: bool) -> (Bench, Worker, wire::Lease) {
    let spec = with(small_spec("filmed"), json!({"record": "transitions"}));
    let bench = Bench::with(&spec).await;
    let mut worker = bench.worker("a").await;
    let mut leases = worker.claim(4).await;
    let simultaneous = leases
        .iter()
        .position(|lease| lease.manifest_row.contains("simultaneous"))
        .expect("a simultaneous rollout");
    let simultaneous = leases.remove(simultaneous);
    for lease in &leases {
        assert!(lease.keep_actions && !lease.record_video);
        worker.commit(lease, outcome).await;
    }
    (bench, worker, simultaneous)
}

/// Regression: such a campaign was created, and no rollout of it was ever filmed.
#[tokio::test]
async fn a_campaign_without_simultaneous_rollouts_records_no_transitions() {
    let none = json!({"record": "transitions", "axes": ["camera"]});
    let bench = Bench::with(&small_spec("other")).await;
    let created = bench.create(&with(small_spec("filmed"), none)).await;
    assert_refused(created, Code::InvalidArgument, &["no simultaneous rollout", "or all"]);
}

async fn next_film(worker: &mut Worker, pack: &str) -> wire::NextFilmResponse {
    film_of(worker, pack, "").await.expect("an answer")
}

async fn film_of(
    worker: &mut Worker,
    pack: &str,
    campaign: &str,
) -> Result<wire::NextFilmResponse, tonic::Status> {
    let request = wire::NextFilmRequest {
        asset_pack_digest: sha(pack),
        mujoco_version: "3.3.7".to_owned(),
        look: worker.look.clone(),
        campaign: campaign.to_owned(),
    };
    Ok(worker.service.next_film(request).await?.into_inner())
}

/// Requests films to make until there are none; returns them.
pub(crate) async fn take_films(worker: &mut Worker) -> Vec<wire::Film> {
    let mut films = Vec::new();
    while let Some(film) = next_film(worker, "primitives").await.film {
        films.push(film);
    }
    films
}

pub(crate) async fn upload(worker: &mut Worker, attempt_id: &str) {
    let chunk = wire::ArtifactChunk {
        attempt_id: attempt_id.to_owned(),
        name: "video.mp4".to_owned(),
        data: b"a film".to_vec(),
    };
    let stored = worker.service.put_artifact(tokio_stream::iter([chunk]));
    stored.await.expect("stored");
}

#[tokio::test]
async fn all_rollouts_of_a_configuration_with_a_transition_are_filmed() {
    for outcome in [true, false] {
        let (bench, mut worker, simultaneous) = commit_all_but_simultaneous(outcome).await;
        assert!(
            take_films(&mut worker).await.is_empty(),
            "the simultaneous rollout has no outcome"
        );
        worker.commit(&simultaneous, !outcome).await;
        assert!(next_film(&mut worker, "other").await.film.is_none());
        assert_refused(film_of(&mut worker, "primitives", "unknown").await, Code::NotFound, &[]);
        bench.create(&small_spec("another")).await.expect("created");
        let of_another = film_of(&mut worker, "primitives", "another").await.expect("an answer");
        assert_eq!((of_another.film, of_another.left), (None, 0));
        let all = take_films(&mut worker).await;
        let rows = all.iter().map(|film| film.manifest_row.as_str());
        let count = |name: &str| rows.clone().filter(|row| row.contains(name)).count();
        assert_eq!(all.len(), 4, "the nominal rollout, two axes, all at once");
        assert_eq!((count("/nominal/"), count("/simultaneous/")), (1, 1));
        assert!(all.iter().all(|film| film.actions == [2; 28]));
        // One film is stored; the others were never uploaded.
        upload(&mut worker, &all[1].attempt_id).await;
        bench.advance(LONG_SECS).await;
        let answer = next_film(&mut worker, "primitives").await;
        assert_eq!(answer.left, 3);
        assert_eq!(1 + take_films(&mut worker).await.len(), 3);
        bench.stop().await;
    }
}

#[tokio::test]
async fn a_motion_with_invalid_length_is_refused_and_not_stored() {
    let (bench, mut worker, simultaneous) = commit_all_but_simultaneous(true).await;
    let steps = proto::MAX_MOTION_STEPS;
    for (path, actions) in [(7, 28), (6, 27), (6 * (steps + 2), 0), (6, 28 * (steps + 1))] {
        let mut report = worker.report(&simultaneous, false);
        let motion = report.motion.as_mut().expect("a motion");
        (motion.path, motion.actions) = (vec![0; path], vec![0; actions]);
        assert_refused(worker.service.commit(report).await, Code::InvalidArgument, &["`motion`"]);
    }
    assert_eq!(bench.status("filmed").await.rollouts.committed, 3);
    worker.commit(&simultaneous, false).await;
    assert_eq!(bench.status("filmed").await.rollouts.committed, 4);
}

#[tokio::test]
async fn a_configuration_without_a_transition_is_not_filmed() {
    for outcome in [true, false] {
        let (_bench, mut worker, simultaneous) = commit_all_but_simultaneous(outcome).await;
        worker.commit(&simultaneous, outcome).await;
        assert!(take_films(&mut worker).await.is_empty());
    }
}
