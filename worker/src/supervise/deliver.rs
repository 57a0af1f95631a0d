//! Reports the end of a rollout to the coordinator: its result with the provenance, or the reason
//! why it has no result. Builds the messages, and logs the coordinator's answers.

use benchmark::attempt::{AttemptId, Measurement, Pin, Provenance};
use proto::coordinator::commit_response::Verdict as CommitVerdict;
use proto::coordinator::release_response::Verdict as ReleaseVerdict;
use proto::coordinator::{CommitRequest, CommitResponse, Motion, ReleaseRequest, ReleaseResponse};
use tonic::Status;
use transport::chain;

use super::config::Identity;
use super::link::Link;
use crate::message::{Failure, Finished};

#[derive(Debug)]
pub(crate) enum Ending {
    /// The rollout has a result.
    Finished(Box<Finished>),
    /// The rollout has no result.
    Failed(Failure),
}

#[derive(Debug)]
pub(crate) struct Delivery {
    pub(crate) attempt: AttemptId,
    /// Name of the rollout in messages.
    pub(crate) label: String,
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
            let Finished { result, provenance, motion, .. } = *finished;
            let Identity { host, asset_pack, asset_pack_digest, mujoco_version, .. } =
                delivery.identity;
            let pin = Pin { asset_pack, asset_pack_digest, mujoco_version, ..provenance.pin };
            let program_version = env!("CARGO_PKG_VERSION").to_owned();
            let provenance = Provenance { host, pin, program_version, ..provenance };
            let measurement = Measurement { result, provenance };
            let request = CommitRequest {
                attempt_id,
                measurement: serde_json::to_string(&measurement)
                    .expect("numbers and text are JSON"),
                motion: Some(Motion { path: motion.path, actions: motion.actions }),
            };
            let answer = link.commit(request).await;
            answer.map_or_else(Answer::Refused, Answer::Committed)
        }
    }
}
