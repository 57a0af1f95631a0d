//! A policy's outages and misbehaviour: when its jobs pause, and how they resume
//! by themselves. One policy is one name at one endpoint; others are not touched.
//!
//! After an outage, or a run of nonsense, the policy's jobs wait for a back-off;
//! then one job, the probe, is let through. Its first answered query resumes the
//! rest; another failure doubles the back-off.

use rand_chacha::rand_core::Rng;
use rollout_types::{AttemptId, Waits};
use serde::Deserialize;

use crate::clock::UnixMillis;

/// Attempts in a row that a policy may answer nonsense in before it pauses.
pub const MAX_MISBEHAVED_IN_A_ROW: u32 = 5;

/// One policy at one endpoint, as far as its health goes.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct PolicyHealth {
    /// Pauses since the last committed rollout.
    pub outages: u32,
    /// Attempts that it answered nonsense in since the last committed rollout.
    pub misbehaved: u32,
    /// Since when it is taken to answer; leases granted earlier are no evidence
    /// of a new outage.
    pub available_since: UnixMillis,
    /// State of the policy.
    pub state: PolicyState,
}

/// State of a policy. The store's CHECK constraints say the same.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(tag = "is", rename_all = "snake_case")]
pub enum PolicyState {
    /// Its jobs are leased.
    Available,
    /// Its jobs wait.
    Paused {
        /// When a probe may go.
        resume: UnixMillis,
        /// The error that its last attempt reported.
        reason: String,
    },
    /// One job is out to try it; the others wait.
    Probing {
        /// The probe.
        attempt: AttemptId,
        /// The error of the last outage.
        reason: String,
    },
}

/// Evidence about a policy that an attempt could not reach.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contact {
    /// Queries that it had answered in this very attempt, if it was there when the attempt
    /// asked its first one.
    pub answered: Option<u32>,
    /// Whether it has answered another attempt since this job last could not reach it.
    pub is_back: bool,
    /// Whether no other job of it waits but those that lost it again and again.
    pub is_last: bool,
}

impl Contact {
    /// Whether the attempt had its policy and lost it, so that the rollout itself may have
    /// taken it down: then its job is counted as one that loses its policy.
    ///
    /// A policy that stands aside from the first query on may never have been able to
    /// answer any: only one that answers others in between, or would have no other
    /// rollout to answer, was lost.
    pub fn was_lost(self) -> bool {
        match self.answered {
            None => false,
            Some(0) => self.is_back || self.is_last,
            Some(_) => true,
        }
    }
}

/// How many of a policy's jobs may be leased now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Allowance {
    /// As many as are asked for.
    Unlimited,
    /// One, which becomes the probe.
    Probe,
    /// None.
    Nothing,
}

impl PolicyHealth {
    /// A policy of which nothing bad is known.
    pub fn new(now: UnixMillis) -> PolicyHealth {
        PolicyHealth {
            outages: 0,
            misbehaved: 0,
            available_since: now,
            state: PolicyState::Available,
        }
    }

    /// How many of its jobs may be leased.
    pub fn allowance(&self, now: UnixMillis) -> Allowance {
        match &self.state {
            PolicyState::Available => Allowance::Unlimited,
            PolicyState::Paused { resume, .. } if *resume <= now => Allowance::Probe,
            PolicyState::Paused { .. } | PolicyState::Probing { .. } => Allowance::Nothing,
        }
    }

    /// The probe was leased.
    #[must_use]
    pub fn with_probe(&self, attempt: AttemptId) -> PolicyHealth {
        match &self.state {
            PolicyState::Paused { reason, .. } => PolicyHealth {
                state: PolicyState::Probing {
                    attempt,
                    reason: reason.clone(),
                },
                ..self.clone()
            },
            PolicyState::Available | PolicyState::Probing { .. } => self.clone(),
        }
    }

    /// A job that has lost this policy again and again was leased, alone: nothing else of
    /// the policy is leased until it ends.
    #[must_use]
    pub fn with_lone_probe(&self, attempt: AttemptId, reason: String) -> PolicyHealth {
        PolicyHealth {
            outages: self.outages.max(1),
            state: PolicyState::Probing { attempt, reason },
            ..*self
        }
    }

    /// A job leased at `granted` could not reach the policy.
    ///
    /// Rollouts that were under way when it fell fail one after the other: only
    /// the first of them is an outage, and none is, that was leased before the
    /// policy last came back.
    #[must_use]
    pub fn after_outage(
        &self,
        attempt: AttemptId,
        granted: UnixMillis,
        error: &str,
        now: UnixMillis,
        rng: &mut impl Rng,
    ) -> PolicyHealth {
        let is_news = match &self.state {
            PolicyState::Available => granted >= self.available_since,
            PolicyState::Paused { .. } => false,
            PolicyState::Probing { .. } => self.is_probe(attempt),
        };
        match is_news {
            true => self.paused(error, now, rng),
            false => self.clone(),
        }
    }

    /// The policy answered nonsense in this attempt. It pauses after a run of
    /// them, and at once if this was the probe: other campaigns' rollouts are
    /// worth more than its own.
    #[must_use]
    pub fn after_misbehaviour(
        &self,
        attempt: AttemptId,
        error: &str,
        now: UnixMillis,
        rng: &mut impl Rng,
    ) -> PolicyHealth {
        let counted = PolicyHealth {
            misbehaved: self.misbehaved.saturating_add(1),
            ..self.clone()
        };
        let pauses = match &self.state {
            PolicyState::Available => counted.misbehaved >= MAX_MISBEHAVED_IN_A_ROW,
            PolicyState::Paused { .. } => false,
            PolicyState::Probing { .. } => self.is_probe(attempt),
        };
        match pauses {
            true => counted.paused(error, now, rng),
            false => counted,
        }
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

    /// An operator asks for a probe now instead of at the end of the back-off.
    #[must_use]
    pub fn due_at_once(&self, now: UnixMillis) -> PolicyHealth {
        match &self.state {
            PolicyState::Paused { resume, reason } => PolicyHealth {
                state: PolicyState::Paused {
                    resume: (*resume).min(now),
                    reason: reason.clone(),
                },
                ..self.clone()
            },
            PolicyState::Available | PolicyState::Probing { .. } => self.clone(),
        }
    }

    /// The policy answered a query of this attempt.
    #[must_use]
    pub fn after_answer(&self, attempt: AttemptId, now: UnixMillis) -> PolicyHealth {
        if !self.is_probe(attempt) {
            return self.clone();
        }
        PolicyHealth {
            available_since: now,
            state: PolicyState::Available,
            ..*self
        }
    }

    /// A rollout of this policy was committed: if it is available, its past is
    /// forgotten.
    #[must_use]
    pub fn after_commit(&self, attempt: AttemptId, now: UnixMillis) -> PolicyHealth {
        let mut health = self.after_answer(attempt, now);
        if health.state == PolicyState::Available {
            health.outages = 0;
            health.misbehaved = 0;
        }
        health
    }

    /// The attempt ended for a reason that says nothing about the policy: if it
    /// was the probe, another may go at once.
    #[must_use]
    pub fn after_other_failure(&self, attempt: AttemptId, now: UnixMillis) -> PolicyHealth {
        match &self.state {
            PolicyState::Probing { reason, .. } if self.is_probe(attempt) => PolicyHealth {
                state: PolicyState::Paused {
                    resume: now,
                    reason: reason.clone(),
                },
                ..self.clone()
            },
            _ => self.clone(),
        }
    }

    /// Whether this attempt is out to try the policy.
    pub fn is_probe(&self, of: AttemptId) -> bool {
        matches!(&self.state, PolicyState::Probing { attempt, .. } if *attempt == of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_is_lost_only_by_an_attempt_that_had_it() {
        let lost = |answered, is_back, is_last| {
            let contact = Contact {
                answered,
                is_back,
                is_last,
            };
            contact.was_lost()
        };
        assert!(!lost(None, true, true), "it was not there");
        assert!(lost(Some(1), false, false));
        assert!(!lost(Some(0), false, false), "it may be down");
        assert!(lost(Some(0), true, false), "it answers others");
        assert!(lost(Some(0), false, true), "there are no others");
    }
}
