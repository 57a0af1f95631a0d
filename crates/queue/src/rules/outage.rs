//! Outages and protocol violations of a policy: when its jobs are paused, and how they resume
//! automatically. A policy is one name at one endpoint; other policies are not affected.
//!
//! After an outage, or several invalid answers in a row, the policy's jobs wait for a back-off.
//! Then one job, the probe, is leased. Its first answered query resumes the other jobs; if it fails
//! because of the policy, the next back-off is twice as long, up to a limit.

use benchmark::attempt::{AttemptId, Waits};
use rand_chacha::rand_core::Rng;
use serde::Deserialize;

use crate::clock::UnixMillis;

/// Attempts in a row with invalid answers after which a policy is paused.
pub const MAX_MISBEHAVED_IN_A_ROW: u32 = 5;

#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct PolicyHealth {
    /// Pauses since a rollout was last committed while the policy was available; at least 1 while a
    /// job of the policy is leased alone.
    pub outages: u32,
    /// Attempts with invalid answers since a rollout was last committed while the policy was
    /// available.
    pub misbehaved: u32,
    /// Instant since which the policy is considered available; failures of leases granted earlier
    /// are not evidence of a new outage.
    pub available_since: UnixMillis,
    pub state: PolicyState,
}

/// State of a policy. Must match the store's CHECK constraints.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
pub enum PolicyState {
    Available,
    Paused {
        /// Earliest instant of a probe.
        resume: UnixMillis,
        /// Error because of which the policy was paused.
        reason: String,
    },
    /// One job, the probe, is leased; the others wait.
    Probing {
        attempt: AttemptId,
        reason: String,
    },
}

/// Evidence about a policy that an attempt could not reach.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contact {
    /// Number of queries that the policy had answered when a later call of this attempt failed;
    /// `None` if the policy had not described itself to this attempt, is overloaded, or the worker
    /// does not report the number.
    pub answered: Option<u32>,
    /// True if the policy has answered another attempt since this job last failed to reach it.
    pub is_back: bool,
    /// True if all other waiting jobs of the policy have repeatedly lost it.
    pub is_last: bool,
}

impl Contact {
    /// Returns true if the attempt had reached its policy and lost it, so that the rollout may have
    /// crashed the policy. The loss is then counted against the job.
    ///
    /// A policy that answered no query of the attempt may have been down before the attempt, since
    /// some servers describe themselves and accept an episode while they answer no query. It counts as lost only if it
    /// answered another attempt since this job last failed to reach it, or if all other waiting
    /// jobs have repeatedly lost it.
    pub fn was_lost(self) -> bool {
        match self.answered {
            None => false,
            Some(0) => self.is_back || self.is_last,
            Some(_) => true,
        }
    }
}

/// Number of a policy's jobs that may be leased now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Allowance {
    Unlimited,
    /// One job, which becomes the probe.
    Probe,
    /// No job.
    Nothing,
}

impl PolicyHealth {
    pub fn new(now: UnixMillis) -> PolicyHealth {
        PolicyHealth {
            outages: 0,
            misbehaved: 0,
            available_since: now,
            state: PolicyState::Available,
        }
    }

    pub fn allowance(&self, now: UnixMillis) -> Allowance {
        match &self.state {
            PolicyState::Available => Allowance::Unlimited,
            PolicyState::Paused { resume, .. } if *resume <= now => Allowance::Probe,
            PolicyState::Paused { .. } | PolicyState::Probing { .. } => Allowance::Nothing,
        }
    }

    #[must_use]
    pub fn with_probe(&self, attempt: AttemptId) -> PolicyHealth {
        match &self.state {
            PolicyState::Paused { reason, .. } => PolicyHealth {
                state: PolicyState::Probing { attempt, reason: reason.clone() },
                ..self.clone()
            },
            PolicyState::Available | PolicyState::Probing { .. } => self.clone(),
        }
    }

    /// Returns the health after a job that repeatedly lost this policy was leased alone: no other
    /// job of the policy is leased until its attempt ends.
    #[must_use]
    pub fn with_lone_probe(&self, attempt: AttemptId, reason: String) -> PolicyHealth {
        PolicyHealth {
            // The store's CHECK constraints require `outages` > 0 unless the policy is available.
            outages: self.outages.max(1),
            state: PolicyState::Probing { attempt, reason },
            ..*self
        }
    }

    /// Returns the health after a job leased at `granted` could not reach the policy.
    ///
    /// When a policy goes down, the rollouts in progress fail one after the other: only the first
    /// failure is counted as an outage. Failures of leases granted before the policy last came back
    /// are ignored.
    #[must_use]
    pub fn after_outage(
        &self,
        attempt: AttemptId,
        granted: UnixMillis,
        error: &str,
        now: UnixMillis,
        rng: &mut impl Rng,
    ) -> PolicyHealth {
        let is_new_outage = match &self.state {
            PolicyState::Available => granted >= self.available_since,
            PolicyState::Paused { .. } => false,
            PolicyState::Probing { .. } => self.is_probe(attempt),
        };
        if is_new_outage { self.paused(error, now, rng) } else { self.clone() }
    }

    /// Returns the health after an attempt with invalid answers. The policy is paused after several
    /// such attempts in a row, and at once if the attempt was the probe, to protect the rollouts of
    /// other campaigns.
    #[must_use]
    pub fn after_misbehaviour(
        &self,
        attempt: AttemptId,
        error: &str,
        now: UnixMillis,
        rng: &mut impl Rng,
    ) -> PolicyHealth {
        let counted =
            PolicyHealth { misbehaved: self.misbehaved.saturating_add(1), ..self.clone() };
        let pauses = match &self.state {
            PolicyState::Available => counted.misbehaved >= MAX_MISBEHAVED_IN_A_ROW,
            PolicyState::Paused { .. } => false,
            PolicyState::Probing { .. } => self.is_probe(attempt),
        };
        if pauses { counted.paused(error, now, rng) } else { counted }
    }

    fn paused(&self, error: &str, now: UnixMillis, rng: &mut impl Rng) -> PolicyHealth {
        let outages = self.outages.saturating_add(1);
        let wait = Waits::USUAL.after(outages, rng.next_u32());
        PolicyHealth {
            outages,
            state: PolicyState::Paused {
                resume: now.plus(wait.max(Waits::USUAL.first)),
                reason: error.to_owned(),
            },
            ..*self
        }
    }

    /// Allows a probe now instead of at the end of the back-off, as requested by an operator.
    #[must_use]
    pub fn due_at_once(&self, now: UnixMillis) -> PolicyHealth {
        match &self.state {
            PolicyState::Paused { resume, reason } => PolicyHealth {
                state: PolicyState::Paused { resume: (*resume).min(now), reason: reason.clone() },
                ..self.clone()
            },
            PolicyState::Available | PolicyState::Probing { .. } => self.clone(),
        }
    }

    #[must_use]
    pub fn after_answer(&self, attempt: AttemptId, now: UnixMillis) -> PolicyHealth {
        if !self.is_probe(attempt) {
            return self.clone();
        }
        PolicyHealth { available_since: now, state: PolicyState::Available, ..*self }
    }

    /// Returns the health after a rollout of this policy was committed; the failure counts of an
    /// available policy are reset.
    #[must_use]
    pub fn after_commit(&self, attempt: AttemptId, now: UnixMillis) -> PolicyHealth {
        let mut health = self.after_answer(attempt, now);
        if health.state == PolicyState::Available {
            health.outages = 0;
            health.misbehaved = 0;
        }
        health
    }

    /// Returns the health after the attempt ended for a reason unrelated to the policy; if it was
    /// the probe, another probe may be leased at once.
    #[must_use]
    pub fn after_other_failure(&self, attempt: AttemptId, now: UnixMillis) -> PolicyHealth {
        match &self.state {
            PolicyState::Probing { reason, .. } if self.is_probe(attempt) => PolicyHealth {
                state: PolicyState::Paused { resume: now, reason: reason.clone() },
                ..self.clone()
            },
            _ => self.clone(),
        }
    }

    pub fn is_probe(&self, candidate: AttemptId) -> bool {
        matches!(&self.state, PolicyState::Probing { attempt, .. } if *attempt == candidate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_is_lost_only_by_an_attempt_that_had_reached_it() {
        let lost = |answered, is_back, is_last| {
            let contact = Contact { answered, is_back, is_last };
            contact.was_lost()
        };
        assert!(!lost(None, true, true), "the policy was never reached");
        assert!(lost(Some(1), false, false));
        assert!(!lost(Some(0), false, false), "the policy may be down");
        assert!(lost(Some(0), true, false), "the policy answers other attempts");
        assert!(lost(Some(0), false, true), "all other jobs have repeatedly lost the policy");
    }
}
