//! Messages that mean something, to begin with.

use attempt::AttemptId;
use prost::Message;
use proto::coordinator as wire;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use tonic::codegen::Bytes;

use super::after;
use super::methods::{CLAIM, METHODS};
use crate::script;

/// A method and a message of it.
pub(super) type Said = (&'static str, Vec<u8>);

/// Two rollouts: a perturbed one, and its nominal one.
const SPEC: &str = r#"{"name":"c","policy":{"name":"p","endpoint":"http://127.0.0.1:1"},
    "tasks":["libero_object/0"],"axes":["camera"],"levels":["L1"],"configs":[0],
    "nominal":"eval"}"#;
/// What the coordinator's attempts follow from.
pub(super) const SEED: u64 = 1;
/// Control steps of the rollout.
const STEPS: u32 = 100;
/// What a worker calls its video.
const VIDEO: &str = "video.mp4";

/// Inputs: every method by itself, and a rollout from its lease to its export.
pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let named = name().encode_to_vec();
    let job = wire::GetJobRequest {
        campaign: "c".into(),
        job: Some(job()),
    };
    let jobs = wire::ListJobsRequest {
        campaign: "c".into(),
        state: "leased".into(),
        after_job_id: 0,
        limit: 10,
        outcome: "success".into(),
        task: "libero_object".into(),
        condition: "camera".into(),
        level: "L1".into(),
    };
    let alter = wire::AlterCampaignRequest {
        campaign: "c".into(),
        priority: Some(-7),
        policy_endpoint: Some("http://127.0.0.1:2".into()),
        policy: Some("q".into()),
        name: Some("d".into()),
    };
    let forecast = wire::ForecastRequest {
        policy: "p".into(),
        rollouts: vec![wire::SuiteRollouts {
            suite: "libero_object".into(),
            rollouts: 9,
        }],
        policy_rate: Some(40.0),
    };
    let sign_off = wire::SignOffRequest {
        worker_id: "w".into(),
    };
    let retry = wire::RetryJobsRequest {
        campaign: "c".into(),
        jobs: vec![],
        all: true,
    };
    let pause = wire::ChangeCampaignRequest {
        campaign: "c".into(),
        change: wire::change_campaign_request::Change::Pause.into(),
    };
    let cancel = wire::ChangeCampaignRequest {
        change: wire::change_campaign_request::Change::Cancel.into(),
        ..pause.clone()
    };
    let delete = wire::DeleteCampaignRequest {
        campaign: "c".into(),
        confirm: "c".into(),
    };
    let import = wire::ImportChunk {
        name: "d".into(),
        archive: "c.tar.gz".into(),
        data: archive(),
    };
    let film = wire::NextFilmRequest {
        asset_pack_digest: digest(),
        mujoco_version: "3.3.7".into(),
    };
    let alone = [
        ("WorkerService/NextFilm", film.encode_to_vec()),
        ("OperatorService/ListCampaigns", vec![]),
        ("OperatorService/GetCampaign", named.clone()),
        ("OperatorService/ChangeCampaign", pause.encode_to_vec()),
        ("OperatorService/ListJobs", jobs.encode_to_vec()),
        ("OperatorService/GetJob", job.encode_to_vec()),
        ("OperatorService/RetryJobs", retry.encode_to_vec()),
        ("OperatorService/ListWorkers", vec![]),
        ("OperatorService/Backup", vec![]),
        ("OperatorService/Report", named.clone()),
        ("OperatorService/Export", named.clone()),
        ("OperatorService/AlterCampaign", alter.encode_to_vec()),
        ("OperatorService/Forecast", forecast.encode_to_vec()),
        ("WorkerService/SignOff", sign_off.encode_to_vec()),
        ("OperatorService/ArchiveCampaign", named.clone()),
        ("OperatorService/ImportCampaign", import.encode_to_vec()),
    ];
    let mut seeds: Vec<Vec<u8>> = alone.iter().map(|said| calls(&[said])).collect();
    // A video is taken once its outcome is there.
    let committed = [
        calls(&[&heartbeat(), &commit()]),
        upload().concat(),
        calls(&[&commit(), &claim(), &("OperatorService/Export", named)]),
    ];
    seeds.push(committed.concat());
    let cancelled = ("OperatorService/ChangeCampaign", cancel.encode_to_vec());
    let deleted = ("OperatorService/DeleteCampaign", delete.encode_to_vec());
    seeds.push(calls(&[
        &release(),
        &claim(),
        &cancelled,
        &commit(),
        &deleted,
        &create(),
    ]));
    seeds
}

/// What was said before an input begins.
pub(super) fn a_lease() -> [Said; 3] {
    [create(), registration("w"), claim()]
}

/// A worker makes itself known.
pub(super) fn registration(worker_id: &str) -> Said {
    let request = wire::RegisterRequest {
        protocol_version: proto::COORDINATOR_PROTOCOL_VERSION,
        worker_id: worker_id.into(),
        host: "h".into(),
        slots: 1,
        asset_pack: "primitives".into(),
        asset_pack_digest: digest(),
        mujoco_version: "3.3.7".into(),
        renderer: "r".into(),
        cores: 2,
        ..wire::RegisterRequest::default()
    };
    ("WorkerService/Register", request.encode_to_vec())
}

/// The campaign in one file.
fn archive() -> Vec<u8> {
    let archived = ("OperatorService/ArchiveCampaign", name().encode_to_vec());
    let (_, pieces) = after(&[create(), archived]);
    let piece = |piece: Bytes| wire::ArchiveChunk::decode(piece).expect("a piece").data;
    pieces.into_iter().flat_map(piece).collect()
}

/// Several calls as an input.
fn calls(said: &[&Said]) -> Vec<u8> {
    let write = |said: &&Said| script::write(number(said.0), &said.1);
    said.iter().flat_map(write).collect()
}

fn number(method: &str) -> u8 {
    let place = METHODS.iter().position(|it| *it == method);
    u8::try_from(place.expect("a method")).expect("few")
}

fn create() -> Said {
    let request = wire::CreateCampaignRequest {
        spec: SPEC.into(),
        priority: 3,
    };
    ("OperatorService/CreateCampaign", request.encode_to_vec())
}

fn claim() -> Said {
    let request = wire::ClaimRequest {
        worker_id: "w".into(),
        claim_id: "0".repeat(32),
        ..wire::ClaimRequest::default()
    };
    (CLAIM, request.encode_to_vec())
}

fn heartbeat() -> Said {
    let request = wire::HeartbeatRequest {
        worker_id: "w".into(),
        progress: vec![wire::Progress {
            attempt_id: attempt(),
            control_steps: 9,
        }],
        filming: 1,
    };
    ("WorkerService/Heartbeat", request.encode_to_vec())
}

fn commit() -> Said {
    let request = wire::CommitRequest {
        attempt_id: attempt(),
        result: Some(wire::RolloutResult {
            success: true,
            steps: STEPS,
            wall_secs: 1.5,
            parts: Some(wire::Parts {
                physics_secs: 0.5,
                drawing_secs: 0.25,
                policy_secs: 0.5,
            }),
            ..wire::RolloutResult::default()
        }),
        provenance: Some(wire::Provenance {
            asset_pack: "primitives".into(),
            asset_pack_digest: digest(),
            mujoco_version: "3.3.7".into(),
            renderer: "r".into(),
            fingerprint: digest(),
            scene_digest: digest(),
            init_state_digest: digest(),
            realisation: "matched".into(),
            policy_name: "p".into(),
            ..wire::Provenance::default()
        }),
        motion: Some(wire::Motion {
            path: vec![0; (STEPS as usize + 1) * 6],
            actions: vec![],
        }),
    };
    ("WorkerService/Commit", request.encode_to_vec())
}

fn release() -> Said {
    let request = wire::ReleaseRequest {
        attempt_id: attempt(),
        reason: wire::release_request::Reason::SlotCrashed.into(),
        error: "e".into(),
    };
    ("WorkerService/Release", request.encode_to_vec())
}

/// A video in two pieces.
fn upload() -> [Vec<u8>; 2] {
    let first = wire::ArtifactChunk {
        attempt_id: attempt(),
        name: VIDEO.into(),
        data: vec![1, 2, 3],
    };
    let second = wire::ArtifactChunk {
        data: vec![4, 5],
        ..wire::ArtifactChunk::default()
    };
    let number = number("WorkerService/PutArtifact");
    [
        script::write(number, &first.encode_to_vec()),
        script::write(number | script::MORE, &second.encode_to_vec()),
    ]
}

fn name() -> wire::GetCampaignRequest {
    wire::GetCampaignRequest {
        campaign: "c".into(),
    }
}

fn job() -> wire::JobName {
    wire::JobName {
        rollout_id: "object/t0/camera/L1/c00".into(),
        replicate: 0,
    }
}

/// The id of the first attempt that a coordinator of this seed grants.
fn attempt() -> String {
    let mut bits = [0; 16];
    ChaCha8Rng::seed_from_u64(SEED).fill_bytes(&mut bits);
    AttemptId::from_random(bits).to_string()
}

fn digest() -> String {
    "0".repeat(64)
}
