use prost::Message;
use proto::coordinator as wire;
use tonic::codegen::Bytes;

use super::messages::{
    EncodedCall, METHODS, SPEC, attempt, claim, commit, create, digest, get_campaign, heartbeat,
    job, release,
};
use super::service::run_valid;
use crate::untrusted_input::script;

const VIDEO: &str = "video.mp4";

/// Returns seed inputs: single calls; the calls of a leased rollout from its heartbeat to its
/// export; and those of a released rollout whose campaign is cancelled, deleted and created anew.
pub(crate) fn seeds() -> Vec<Vec<u8>> {
    let campaign = get_campaign().encode_to_vec();
    let job = wire::GetJobRequest { campaign: "c".into(), job: Some(job()) };
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
        rollouts: vec![wire::SuiteRollouts { suite: "libero_object".into(), rollouts: 9 }],
    };
    let sign_off = wire::SignOffRequest { worker_id: "w".into() };
    let retry = wire::RetryJobsRequest { campaign: "c".into(), jobs: vec![], all: true };
    let skip =
        wire::SkipJobsRequest { campaign: "c".into(), jobs: job.job.iter().cloned().collect() };
    let pause = wire::ChangeCampaignRequest {
        campaign: "c".into(),
        change: wire::change_campaign_request::Change::Pause.into(),
    };
    let cancel = wire::ChangeCampaignRequest {
        change: wire::change_campaign_request::Change::Cancel.into(),
        ..pause.clone()
    };
    let append = wire::AppendRowsRequest { campaign: "c".into(), rows: vec![], spec: SPEC.into() };
    let delete = wire::DeleteCampaignRequest { campaign: "c".into(), confirm: "c".into() };
    let import =
        wire::ImportChunk { name: "d".into(), archive: "c.tar.gz".into(), data: archive() };
    let film = wire::NextFilmRequest {
        asset_pack_digest: digest(),
        mujoco_version: "3.3.7".into(),
        look: "mujoco-3.3.2".into(),
        campaign: "c".into(),
    };
    let single_calls = [
        ("WorkerService/NextFilm", film.encode_to_vec()),
        ("OperatorService/AppendRows", append.encode_to_vec()),
        ("OperatorService/ListCampaigns", vec![]),
        ("OperatorService/GetCampaign", campaign.clone()),
        ("OperatorService/ChangeCampaign", pause.encode_to_vec()),
        ("OperatorService/ListJobs", jobs.encode_to_vec()),
        ("OperatorService/GetJob", job.encode_to_vec()),
        ("OperatorService/RetryJobs", retry.encode_to_vec()),
        ("OperatorService/SkipJobs", skip.encode_to_vec()),
        ("OperatorService/ListWorkers", vec![]),
        ("OperatorService/Backup", vec![]),
        ("OperatorService/Report", campaign.clone()),
        ("OperatorService/Export", campaign.clone()),
        ("OperatorService/AlterCampaign", alter.encode_to_vec()),
        ("OperatorService/Forecast", forecast.encode_to_vec()),
        ("WorkerService/SignOff", sign_off.encode_to_vec()),
        ("OperatorService/ArchiveCampaign", campaign.clone()),
        ("OperatorService/ImportCampaign", import.encode_to_vec()),
    ];
    let mut seeds: Vec<Vec<u8>> = single_calls.iter().map(|call| calls(&[call])).collect();
    // A video is accepted only after its rollout's outcome.
    let committed = [
        calls(&[&heartbeat(), &commit()]),
        upload().concat(),
        calls(&[&commit(), &claim(), &("OperatorService/Export", campaign)]),
    ];
    seeds.push(committed.concat());
    let cancelled = ("OperatorService/ChangeCampaign", cancel.encode_to_vec());
    let deleted = ("OperatorService/DeleteCampaign", delete.encode_to_vec());
    seeds.push(calls(&[&release(), &claim(), &cancelled, &commit(), &deleted, &create()]));
    seeds
}

fn archive() -> Vec<u8> {
    let request = get_campaign().encode_to_vec();
    let (_, chunks) = run_valid(&[create(), ("OperatorService/ArchiveCampaign", request)]);
    let data = |chunk: Bytes| wire::ArchiveChunk::decode(chunk).expect("a chunk").data;
    chunks.into_iter().flat_map(data).collect()
}

fn calls(calls: &[&EncodedCall]) -> Vec<u8> {
    let write = |call: &&EncodedCall| script::write(method_number(call.0), &call.1);
    calls.iter().flat_map(write).collect()
}

fn method_number(method: &str) -> u8 {
    let index = METHODS.iter().position(|name| *name == method);
    u8::try_from(index.expect("a method")).expect("fewer than 256 methods")
}

fn upload() -> [Vec<u8>; 2] {
    let first =
        wire::ArtifactChunk { attempt_id: attempt(), name: VIDEO.into(), data: vec![1, 2, 3] };
    let second = wire::ArtifactChunk { data: vec![4, 5], ..wire::ArtifactChunk::default() };
    let number = method_number("WorkerService/PutArtifact");
    [
        script::write(number, &first.encode_to_vec()),
        script::write(number | script::MORE, &second.encode_to_vec()),
    ]
}
