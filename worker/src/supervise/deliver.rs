//! Telling the coordinator how a rollout ended: an outcome with everything that
//! it came out of, after its video, or why there is none. Responsible for the
//! messages and for what is said about the answers in the log.

use std::path::PathBuf;

use proto::coordinator::commit_response::Verdict as CommitVerdict;
use proto::coordinator::release_response::Verdict as ReleaseVerdict;
use proto::coordinator::{
    CommitRequest, CommitResponse, LeaseRef, Motion, Outcome, Provenance, ReleaseRequest,
    ReleaseResponse,
};
use protocol::Realisation;
use tonic::Status;

use super::Identity;
use super::link::Link;
use crate::grpc::in_words;
use crate::message::{Evidence, Failure, Finished, Motion as SlotMotion, Outcome as SlotOutcome};

/// How a rollout ended.
#[derive(Debug)]
pub(crate) enum Ending {
    /// With an outcome.
    Finished(Box<Finished>),
    /// Without one.
    Failed(Failure),
}

/// An ending on its way to the coordinator.
#[derive(Debug)]
pub(crate) struct Delivery {
    pub(crate) lease: LeaseRef,
    /// What ended, for people.
    pub(crate) label: String,
    pub(crate) realisation: Realisation,
    pub(crate) identity: Identity,
    pub(crate) ending: Ending,
}

/// The coordinator's answer.
#[derive(Debug)]
pub(crate) enum Answer {
    Committed(CommitResponse),
    Released(ReleaseResponse),
    /// It will not have it, and will not change its mind.
    Refused(Status),
}

impl Delivery {
    /// Says in the log how the rollout ended.
    pub(crate) fn tell(&self) {
        let label = &self.label;
        match &self.ending {
            Ending::Finished(finished) => {
                let outcome = &finished.outcome;
                let word = if outcome.success {
                    "success"
                } else {
                    "failure"
                };
                let (steps, secs) = (outcome.steps, outcome.wall_secs);
                tracing::info!("{label}: {word} after {steps} steps in {secs:.1} s");
            }
            Ending::Failed(failure) => {
                tracing::warn!("{label} has no outcome: failed to {}", failure.error);
            }
        }
    }
}

impl Answer {
    /// Says in the log what became of the ending, where somebody should know.
    pub(crate) fn tell(&self) {
        match self {
            Self::Committed(answer) => match answer.verdict() {
                CommitVerdict::Accepted | CommitVerdict::Duplicate => {}
                CommitVerdict::Stale => {
                    tracing::warn!("an outcome came too late: {}", answer.detail);
                }
                verdict => {
                    tracing::error!("an outcome was refused, {verdict:?}: {}", answer.detail)
                }
            },
            Self::Released(answer) => match answer.verdict() {
                ReleaseVerdict::Quarantined => {
                    tracing::error!("the job was set aside: it has failed too often");
                }
                _ if answer.backoff_secs > 0.0 => {
                    tracing::info!("the job waits {:.0} s", answer.backoff_secs);
                }
                _ => {}
            },
            Self::Refused(status) => {
                tracing::error!(
                    "the coordinator takes no ending of a job: {}",
                    in_words(status)
                );
            }
        }
    }

    /// Why the worker must stop, if it must.
    pub(crate) fn stop_leasing(self) -> Option<String> {
        match self {
            Self::Released(answer) => Some(answer.stop_leasing).filter(|text| !text.is_empty()),
            Self::Committed(_) | Self::Refused(_) => None,
        }
    }
}

/// Delivers an ending; until it is answered.
pub(crate) async fn deliver(link: &Link, delivery: Delivery) -> Answer {
    let lease = delivery.lease;
    match delivery.ending {
        Ending::Failed(failure) => {
            let request = ReleaseRequest {
                lease: Some(lease),
                reason: failure.kind.reason() as i32,
                error: failure.error,
            };
            let answer = link.release(request).await;
            answer.map_or_else(Answer::Refused, Answer::Released)
        }
        Ending::Finished(finished) => {
            if let Some(video) = finished.video {
                deliver_video(link, lease.clone(), video).await;
            }
            let request = CommitRequest {
                lease: Some(lease),
                outcome: Some(outcome(&finished.outcome)),
                provenance: Some(provenance(
                    finished.evidence,
                    delivery.identity,
                    delivery.realisation,
                )),
                motion: Some(motion(&finished.motion)),
            };
            let answer = link.commit(request).await;
            answer.map_or_else(Answer::Refused, Answer::Committed)
        }
    }
}

/// A video is worth less than its outcome: without one, the outcome goes alone.
async fn deliver_video(link: &Link, lease: LeaseRef, video: PathBuf) {
    if let Err(status) = link.put_video(lease, &video).await {
        tracing::warn!("a video was not stored: {}", in_words(&status));
    }
    if let Err(error) = tokio::fs::remove_file(&video).await {
        tracing::warn!("{} stays behind: {error}", video.display());
    }
}

fn outcome(outcome: &SlotOutcome) -> Outcome {
    let ik = outcome.ik;
    Outcome {
        success: outcome.success,
        steps: outcome.steps,
        wall_secs: outcome.wall_secs,
        ik_residual_mm: ik.map(|ik| ik.residual_mm),
        ik_residual_deg: ik.map(|ik| ik.residual_deg),
        ik_clamped_joints: ik.map(|ik| ik.clamped_joints),
        clipped_actions: outcome.clipped_actions,
        policy_queries: outcome.policy_queries,
    }
}

fn motion(motion: &SlotMotion) -> Motion {
    let path = motion.path.iter().flatten();
    // Policies answer 32-bit numbers: nothing is lost.
    let actions = motion.actions.iter().flatten();
    Motion {
        path: path.flat_map(|tenths| tenths.to_le_bytes()).collect(),
        actions: actions
            .flat_map(|number| (*number as f32).to_le_bytes())
            .collect(),
    }
}

fn provenance(evidence: Evidence, identity: Identity, realisation: Realisation) -> Provenance {
    Provenance {
        host: identity.host,
        renderer: evidence.renderer,
        fingerprint: evidence.fingerprint,
        mujoco_version: identity.mujoco_version,
        asset_pack: identity.asset_pack,
        asset_pack_digest: identity.asset_pack_digest,
        scene_digest: evidence.scene_digest,
        init_state_digest: evidence.init_state_digest,
        perturbation_digest: evidence.perturbation_digest,
        first_frame_digest: evidence.first_frame_digest,
        realisation: realisation.to_string(),
        policy_name: evidence.policy_name,
        policy_checkpoint: evidence.policy_checkpoint,
        policy_checkpoint_digest: evidence.policy_checkpoint_digest,
        policy_privileged: evidence.policy_privileged,
        policy_canonical_only: evidence.policy_canonical_only,
        batch_mode: evidence.batch_mode,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
    }
}
