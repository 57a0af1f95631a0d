use std::sync::LazyLock;

use benchmark::attempt::{
    AttemptId, Digests, GoalProgress, Measurement, Parts, Pin, Provenance, RolloutResult,
};
use prost::Message;
use proto::coordinator as wire;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::untrusted_input::call::methods;

/// All methods; an input selects one by its index.
pub(super) static METHODS: LazyLock<Vec<String>> = LazyLock::new(|| {
    methods(include_str!("../../../../proto/rollout/coordinator/v1/coordinator.proto"))
});

/// The only method that may wait before it answers, namely for a job.
pub(super) const CLAIM: &str = "WorkerService/Claim";

/// A method's name and the encoded message of a call.
pub(super) type EncodedCall = (&'static str, Vec<u8>);

/// Specification with two rollouts: one perturbed, one nominal.
pub(super) const SPEC: &str = r#"{"name":"c","policy":{"name":"p","endpoint":"http://127.0.0.1:1"},
    "tasks":["libero_object/0"],"axes":["camera"],"levels":["L1"],"configs":[0],
    "nominal":"eval"}"#;
/// Seed of the coordinator's attempt ids.
pub(super) const SEED: u64 = 1;
const STEPS: u32 = 100;

/// Calls made before an input, after which worker `w` holds a lease.
pub(super) fn lease_calls() -> [EncodedCall; 3] {
    [create(), registration("w"), claim()]
}

pub(super) fn registration(worker_id: &str) -> EncodedCall {
    let request = wire::RegisterRequest {
        protocol_version: proto::COORDINATOR_PROTOCOL_VERSION,
        worker_id: worker_id.into(),
        host: "h".into(),
        slots: 1,
        asset_pack: "primitives".into(),
        asset_pack_digest: digest(),
        mujoco_version: "3.3.7".into(),
        renderer: "r".into(),
        look: "mujoco-3.3.2".into(),
        cores: 2,
        ..wire::RegisterRequest::default()
    };
    ("WorkerService/Register", request.encode_to_vec())
}

pub(super) fn create() -> EncodedCall {
    let request = wire::CreateCampaignRequest { spec: SPEC.into(), priority: 3 };
    ("OperatorService/CreateCampaign", request.encode_to_vec())
}

pub(super) fn claim() -> EncodedCall {
    let request = wire::ClaimRequest {
        worker_id: "w".into(),
        claim_id: "0".repeat(32),
        ..wire::ClaimRequest::default()
    };
    (CLAIM, request.encode_to_vec())
}

pub(super) fn heartbeat() -> EncodedCall {
    let request = wire::HeartbeatRequest {
        worker_id: "w".into(),
        progress: vec![wire::Progress { attempt_id: attempt(), control_steps: 9 }],
        filming: 1,
    };
    ("WorkerService/Heartbeat", request.encode_to_vec())
}

pub(super) fn commit() -> EncodedCall {
    let measurement = Measurement {
        result: RolloutResult {
            success: true,
            steps: STEPS,
            wall_secs: 1.5,
            parts: Parts { physics_secs: 0.5, drawing_secs: 0.25, policy_secs: 0.5 },
            goal: GoalProgress { predicates: 2, at_end: 2, at_most: 2 },
            digests: Digests { scene: digest(), init_state: digest(), ..Digests::default() },
            ..RolloutResult::default()
        },
        provenance: Provenance {
            pin: Pin {
                asset_pack: "primitives".into(),
                asset_pack_digest: digest(),
                mujoco_version: "3.3.7".into(),
                renderer: "r".into(),
                ..Pin::default()
            },
            fingerprint: digest(),
            realisation: "matched".into(),
            policy_name: "p".into(),
            ..Provenance::default()
        },
    };
    let request = wire::CommitRequest {
        attempt_id: attempt(),
        measurement: serde_json::to_string(&measurement).expect("numbers and text are JSON"),
        motion: Some(wire::Motion { path: vec![0; (STEPS as usize + 1) * 6], actions: vec![] }),
    };
    ("WorkerService/Commit", request.encode_to_vec())
}

pub(super) fn release() -> EncodedCall {
    release_of(attempt())
}

pub(super) fn release_of(attempt_id: String) -> EncodedCall {
    let request = wire::ReleaseRequest {
        attempt_id,
        reason: wire::release_request::Reason::SlotCrashed.into(),
        error: "e".into(),
        answered_queries: Some(1),
    };
    ("WorkerService/Release", request.encode_to_vec())
}

pub(super) fn get_campaign() -> wire::GetCampaignRequest {
    wire::GetCampaignRequest { campaign: "c".into() }
}

pub(super) fn job() -> wire::JobName {
    wire::JobName { rollout_id: "object/t0/camera/L1/c00".into(), replicate: 0 }
}

/// Returns the id of the first attempt that a coordinator with this seed grants.
pub(super) fn attempt() -> String {
    let mut bits = [0; 16];
    ChaCha8Rng::seed_from_u64(SEED).fill_bytes(&mut bits);
    AttemptId::from_random(bits).to_string()
}

pub(super) fn digest() -> String {
    "0".repeat(64)
}
