//! Replicas of one checkpoint: assigns sessions and queries to them, and checks that their
//! descriptions agree.

use std::fmt;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use policy_backends::{BackendError, description};
use proto::policy::DescribeResponse;
use sha2::{Digest, Sha256};

use super::replica::Replica;
use crate::config::Batching;
use crate::health::Call;

/// Interchangeable replicas of a checkpoint.
pub struct Pool {
    /// Suite of the checkpoint; empty for all suites.
    suite: String,
    replicas: Vec<Arc<Replica>>,
    batching: Batching,
    /// Description by the first replica to answer; the other replicas must have the same
    /// description.
    agreed: Mutex<Option<Agreed>>,
    sessions_assigned: AtomicU64,
    /// Number of sessions whose Reset is in flight.
    opening: AtomicUsize,
}

/// Guard of a session whose Reset is in flight, counted against the pool's capacity until dropped.
pub struct Opening(Arc<Pool>);

impl Drop for Opening {
    fn drop(&mut self) {
        self.0.opening.fetch_sub(1, Ordering::Relaxed);
    }
}

struct Agreed {
    described: Arc<DescribeResponse>,
    /// Replica that gave the description.
    by: String,
}

impl Pool {
    /// Creates a pool of at least one replica, for one suite or, if `suite` is empty, for all.
    pub fn new(suite: &str, replicas: Vec<Arc<Replica>>, batching: Batching) -> Self {
        Self {
            suite: suite.to_owned(),
            replicas,
            batching,
            agreed: Mutex::default(),
            sessions_assigned: AtomicU64::new(0),
            opening: AtomicUsize::new(0),
        }
    }

    /// Reserves capacity for a session's Reset if the replicas can answer this session in time, in
    /// addition to the given number of open sessions. The caller must prevent concurrent calls.
    pub fn reserve_session(self: &Arc<Self>, open: usize) -> Option<Opening> {
        let sessions = open + self.opening.load(Ordering::Relaxed);
        if self.capacity().is_some_and(|capacity| sessions >= capacity) {
            return None;
        }
        self.opening.fetch_add(1, Ordering::Relaxed);
        Some(Opening(Arc::clone(self)))
    }

    /// Returns the number of sessions that the replicas can answer in time together; `None` if the
    /// pace of a replica that is up is unknown, or all replicas are out.
    pub fn capacity(&self) -> Option<usize> {
        let up = self.replicas.iter().filter(|replica| !replica.is_out());
        let capacities = up.map(|replica| replica.capacity());
        let capacity: Option<usize> = capacities.sum();
        capacity.filter(|&sessions| sessions > 0)
    }

    /// Returns the longest wait of a Reset for another session to end: 20 s if answers may take 50
    /// s, which leaves the Reset itself 40 s of a worker's time limit of 60 s.
    pub fn reset_timeout(&self) -> Duration {
        let longest = self.replicas.iter().map(|replica| replica.answer_within()).max();
        longest.unwrap_or_default() * 2 / 5
    }

    /// Returns the time per query of the slowest replica.
    pub fn per_query(&self) -> Option<Duration> {
        self.replicas.iter().filter_map(|replica| replica.per_query()).max()
    }

    /// Returns true if the sessions of both pools count towards the same capacity, as those of a
    /// suite's pools before and after a reload do.
    pub fn shares_with(&self, other: &Self) -> bool {
        self.suite == other.suite
    }

    /// Returns the replicas in the configured order.
    pub fn replicas(&self) -> &[Arc<Replica>] {
        &self.replicas
    }

    /// Returns true if a session must stay with its replica.
    pub fn pins(&self, described: &DescribeResponse) -> bool {
        described.stateful || self.batching == Batching::Deterministic
    }

    /// Chooses a replica outside `tried` for a new session with `seed`.
    pub fn for_session(
        &self,
        session: &str,
        seed: u64,
        tried: &[Arc<Replica>],
    ) -> Option<Arc<Replica>> {
        let chosen = match self.batching {
            Batching::Deterministic => {
                self.replica_of_seed(seed).filter(|replica| !contains(tried, replica))
            }
            Batching::Dynamic | Batching::Single => self.least_loaded(session, tried, &[]),
        };
        if let Some(replica) = chosen {
            replica.record_assignment(self.sessions_assigned.fetch_add(1, Ordering::Relaxed) + 1);
        }
        chosen.cloned()
    }

    /// Chooses a replica outside `tried` for a query of a session that may move and is already
    /// open at `open_on`.
    pub fn for_query(
        &self,
        session: &str,
        open_on: &[Arc<Replica>],
        tried: &[Arc<Replica>],
    ) -> Option<Arc<Replica>> {
        self.least_loaded(session, tried, open_on).cloned()
    }

    /// Returns the replica for all sessions of a seed, by rendezvous hashing: a replica that is
    /// added or removed only moves the seeds that it gains or loses.
    fn replica_of_seed(&self, seed: u64) -> Option<&Arc<Replica>> {
        let rank = |replica: &&Arc<Replica>| Sha256::digest(format!("{seed} {replica}"));
        self.replicas.iter().max_by_key(rank)
    }

    /// Returns the replica outside `tried` with the fewest queries in flight, of those that admit
    /// the session's calls; among equals, one where the session is open, then the one whose last
    /// new session is oldest. If none admits them, returns one, whose error names the cause.
    fn least_loaded(
        &self,
        session: &str,
        tried: &[Arc<Replica>],
        open_on: &[Arc<Replica>],
    ) -> Option<&Arc<Replica>> {
        let untried = self.replicas.iter().filter(|replica| !contains(tried, replica));
        untried.min_by_key(|replica| {
            let is_out = !replica.would_admit(Call::InSession(session));
            let is_new = !contains(open_on, replica);
            (is_out, replica.load(), is_new, replica.last_assigned())
        })
    }

    /// Reads a replica's description, and compares it with the description by the first replica to
    /// answer.
    pub async fn describe(
        &self,
        replica: &Replica,
        call: Call<'_>,
    ) -> Result<Arc<DescribeResponse>, BackendError> {
        let mut described =
            replica.describe(call, &self.suite, |described| self.agree(replica, described)).await?;
        // If the replica is another gateway, it has set the actual batch mode already.
        if described.batch_mode.is_empty() {
            let batch_size = description::batch_size(&described);
            described.batch_mode = self.batching.describe(batch_size);
            if described.unseeded {
                described.batch_mode.push_str(", unseeded");
            }
        }
        Ok(Arc::new(described))
    }

    fn agree(&self, replica: &Replica, described: &DescribeResponse) -> Result<(), String> {
        let mut agreed = self.agreed.lock().unwrap_or_else(PoisonError::into_inner);
        let by = replica.to_string();
        let first = agreed.get_or_insert_with(|| Agreed {
            described: Arc::new(described.clone()),
            by: by.clone(),
        });
        match description::difference(&first.described, described) {
            None => Ok(()),
            Some(difference) if first.by == by => Err(format!("changed: {difference}")),
            Some(difference) => Err(format!("is no replica of {}: {difference}", first.by)),
        }
    }
}

fn contains(replicas: &[Arc<Replica>], replica: &Arc<Replica>) -> bool {
    replicas.iter().any(|member| Arc::ptr_eq(member, replica))
}

impl fmt::Display for Pool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, replica) in self.replicas.iter().enumerate() {
            let separator = if index == 0 { "" } else { ", " };
            write!(f, "{separator}{replica}")?;
        }
        Ok(())
    }
}
