//! Reports the end of a rollout to the coordinator: its result with the provenance, or the reason
//! why it has no result. Builds the messages, and logs the coordinator's answers.

use libero_ctrl::Realisation;
use proto::coordinator::commit_response::Verdict as CommitVerdict;
use proto::coordinator::release_response::Verdict as ReleaseVerdict;
use proto::coordinator::{
    self as wire, CommitRequest, CommitResponse, Motion, Provenance, ReleaseRequest,
    ReleaseResponse,
};
use rollout_types::{AttemptId, RealisedAxis, RolloutResult};
use tonic::Status;
use transport::chain;

use super::config::Identity;
use super::link::Link;
use crate::message::{Evidence, Failure, Finished};

/// Outcome of a rollout.
#[derive(Debug)]
pub(crate) enum Ending {
    /// The rollout has a result.
    Finished(Box<Finished>),
    /// The rollout has no result.
    Failed(Failure),
}

/// End of a rollout that is to be reported to the coordinator.
#[derive(Debug)]
pub(crate) struct Delivery {
    pub(crate) attempt: AttemptId,
    /// Name of the rollout in messages.
    pub(crate) label: String,
    pub(crate) realisation: Realisation,
    pub(crate) identity: Identity,
    pub(crate) ending: Ending,
}

/// The coordinator's answer to the report of a rollout's end.
#[derive(Debug)]
pub(crate) enum Answer {
    Committed(CommitResponse),
    Released(ReleaseResponse),
    /// The coordinator refused the report; a retry cannot help.
    Refused(Status),
}

impl Delivery {
    /// Logs how the rollout ended.
    pub(crate) fn log(&self) {
        let label = &self.label;
        match &self.ending {
            Ending::Finished(finished) => {
                let result = &finished.result;
                let word = if result.success { "success" } else { "failure" };
                let (steps, secs) = (result.steps, result.wall_secs);
                tracing::info!("{label}: {word} after {steps} steps in {secs:.1} s");
            }
            Ending::Failed(failure) => {
                tracing::warn!("{label} has no result: {}", failure.error);
            }
        }
    }
}

impl Answer {
    /// Logs a late or refused report, a quarantine, and the delay before a rollout is tried again.
    pub(crate) fn log(&self, label: &str) {
        match self {
            Self::Committed(answer) => {
                let detail = &answer.detail;
                match answer.verdict() {
                    CommitVerdict::Accepted | CommitVerdict::Duplicate => {}
                    CommitVerdict::Stale => {
                        tracing::warn!("{label}: a result came too late: {detail}");
                    }
                    CommitVerdict::Divergent => {
                        tracing::error!("{label}: a result differs from the stored one: {detail}");
                    }
                    CommitVerdict::Unpaired => {
                        tracing::error!("{label}: a result was refused: {detail}");
                    }
                    CommitVerdict::Unspecified => {
                        tracing::error!(
                            "{label}: a result got a verdict that this worker does not know: \
                             {detail}"
                        );
                    }
                }
            }
            Self::Released(answer) => match answer.verdict() {
                ReleaseVerdict::Quarantined => {
                    tracing::error!(
                        "{label}: the rollout was quarantined: it has failed too often"
                    );
                }
                _ if answer.backoff_secs > 0.0 => {
                    let secs = answer.backoff_secs;
                    tracing::info!("{label}: the rollout is tried again after {secs:.0} s");
                }
                _ => {}
            },
            Self::Refused(status) => {
                tracing::error!(
                    "{label}: the coordinator refuses the report of the rollout: {}",
                    chain(status)
                );
            }
        }
    }

    /// Returns true if the coordinator has the result now.
    pub(crate) fn is_committed(&self) -> bool {
        use CommitVerdict::{Accepted, Duplicate};
        matches!(self, Self::Committed(answer) if matches!(answer.verdict(), Accepted | Duplicate))
    }

    /// Returns the coordinator's reason why the worker must stop leasing; `None` if it may go on.
    pub(crate) fn stop_leasing(self) -> Option<String> {
        match self {
            Self::Released(answer) => Some(answer.stop_leasing).filter(|text| !text.is_empty()),
            Self::Committed(_) | Self::Refused(_) => None,
        }
    }
}

/// Reports the end of a rollout, and retries until the coordinator answers.
pub(crate) async fn deliver(link: &Link, delivery: Delivery) -> Answer {
    let attempt_id = delivery.attempt.to_string();
    match delivery.ending {
        Ending::Failed(failure) => {
            let request = ReleaseRequest {
                attempt_id,
                reason: failure.kind.reason() as i32,
                error: failure.error,
                answered_queries: failure.kind.answered_queries(),
            };
            let answer = link.release(request).await;
            answer.map_or_else(Answer::Refused, Answer::Released)
        }
        Ending::Finished(finished) => {
            let request = CommitRequest {
                attempt_id,
                result: Some(result(&finished.result)),
                provenance: Some(provenance(
                    finished.evidence,
                    delivery.identity,
                    delivery.realisation,
                )),
                motion: Some(Motion {
                    path: finished.motion.path,
                    actions: finished.motion.actions,
                }),
            };
            let answer = link.commit(request).await;
            answer.map_or_else(Answer::Refused, Answer::Committed)
        }
    }
}

fn result(result: &RolloutResult) -> wire::RolloutResult {
    let ik = result.ik;
    wire::RolloutResult {
        success: result.success,
        steps: result.steps,
        wall_secs: result.wall_secs,
        ik_residual_mm: ik.map(|ik| ik.residual_mm),
        ik_residual_deg: ik.map(|ik| ik.residual_deg),
        ik_clamped_joints: ik.map(|ik| ik.clamped_joints),
        clipped_actions: result.clipped_actions,
        policy_queries: result.policy_queries,
        parts: Some(wire::Parts {
            physics_secs: result.parts.physics_secs,
            drawing_secs: result.parts.drawing_secs,
            policy_secs: result.parts.policy_secs,
        }),
        prompt: result.prompt.clone().unwrap_or_default(),
        goal: Some(wire::GoalProgress {
            predicates: result.goal.predicates,
            at_end: result.goal.at_end,
            at_most: result.goal.at_most,
        }),
    }
}

fn provenance(evidence: Evidence, identity: Identity, realisation: Realisation) -> Provenance {
    let realised = evidence.realised.axes().map(|(axis, realised)| {
        let RealisedAxis { parameters, elements } = realised.clone();
        wire::RealisedAxis { axis: axis.to_string(), parameters, elements }
    });
    Provenance {
        realised: realised.collect(),
        host: identity.host,
        renderer: evidence.renderer,
        fingerprint: evidence.fingerprint,
        mujoco_version: identity.mujoco_version,
        asset_pack: identity.asset_pack,
        asset_pack_digest: identity.asset_pack_digest,
        scene_digest: evidence.scene_digest,
        init_state_digest: evidence.init_state_digest,
        first_frame_digest: evidence.first_frame_digest,
        realisation: realisation.to_string(),
        policy_name: evidence.policy_name,
        policy_checkpoint: evidence.policy_checkpoint,
        policy_checkpoint_digest: evidence.policy_checkpoint_digest,
        policy_privileged: evidence.policy_privileged,
        policy_canonical_only: evidence.policy_canonical_only,
        policy_settings: evidence.policy_settings,
        batch_mode: evidence.batch_mode,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        look: evidence.look.to_string(),
    }
}
