//! The replicas of one checkpoint: which of them gets a session or a query, and
//! whether they are replicas of one another at all.

use std::{
    fmt,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
    time::Duration,
};

use proto::policy::DescribeResponse;
use sha2::{Digest, Sha256};

use super::replica::Replica;
use crate::{backend::BackendError, check, config::Batching, health::Call};

/// Replicas that answer alike.
pub struct Pool {
    /// The suite of its checkpoint; empty: all suites.
    suite: String,
    replicas: Vec<Arc<Replica>>,
    batching: Batching,
    /// Description by the first replica to answer, with which the others must
    /// agree.
    agreed: Mutex<Option<Agreed>>,
    sessions_given: AtomicU64,
    /// Sessions whose Reset is under way.
    opening: AtomicUsize,
}

/// A session whose Reset is under way, among those that its pool may have; one less
/// when dropped.
pub struct Opening(Arc<Pool>);

impl Drop for Opening {
    fn drop(&mut self) {
        self.0.opening.fetch_sub(1, Ordering::Relaxed);
    }
}

struct Agreed {
    described: Arc<DescribeResponse>,
    by: String,
}

impl Pool {
    /// A pool of at least one replica, for one suite or, if that is empty, all.
    pub fn new(suite: &str, replicas: Vec<Arc<Replica>>, batching: Batching) -> Self {
        Self {
            suite: suite.to_owned(),
            replicas,
            batching,
            agreed: Mutex::default(),
            sessions_given: AtomicU64::new(0),
            opening: AtomicUsize::new(0),
        }
    }

    /// Counts one more session whose Reset is under way, if the replicas can answer it
    /// in time beside the `open` ones. The caller keeps others from doing so meanwhile.
    pub fn open_one_more(self: &Arc<Self>, open: usize) -> Option<Opening> {
        let sessions = open + self.opening.load(Ordering::Relaxed);
        if self.capacity().is_some_and(|most| sessions >= most) {
            return None;
        }
        self.opening.fetch_add(1, Ordering::Relaxed);
        Some(Opening(Arc::clone(self)))
    }

    /// Returns how many sessions the replicas can answer in time together; none if
    /// the pace of one is not known, or all are out.
    pub fn capacity(&self) -> Option<usize> {
        let up = self.replicas.iter().filter(|it| !it.is_out());
        let capacities = up.map(|replica| replica.capacity());
        let capacity: Option<usize> = capacities.sum();
        capacity.filter(|&sessions| sessions > 0)
    }

    /// Longest time that a Reset waits for another session to end: at 50 s for an answer
    /// 20 s, so that the Reset itself still comes within the 60 s that a worker waits.
    pub fn reset_patience(&self) -> Duration {
        let longest = self.replicas.iter().map(|it| it.answer_within()).max();
        longest.unwrap_or_default() * 2 / 5
    }

    /// Returns the time that the slowest replica takes for each query.
    pub fn per_query(&self) -> Option<Duration> {
        self.replicas.iter().filter_map(|it| it.per_query()).max()
    }

    /// Returns true if another pool has the same replicas' sessions: it is for the
    /// same suite of the same route, before or after a reload.
    pub fn shares_with(&self, other: &Self) -> bool {
        self.suite == other.suite
    }

    /// In the order configured.
    pub fn replicas(&self) -> &[Arc<Replica>] {
        &self.replicas
    }

    /// Returns true if a session must stay with the replica that it was given
    /// to.
    pub fn pins(&self, described: &DescribeResponse) -> bool {
        described.stateful || self.batching == Batching::Deterministic
    }

    /// The replica for a new session with `seed`, of those not in `tried`.
    pub fn for_session(
        &self,
        session: &str,
        seed: u64,
        tried: &[Arc<Replica>],
    ) -> Option<Arc<Replica>> {
        let chosen = match self.batching {
            Batching::Deterministic => self.fixed(seed).filter(|it| !contains(tried, it)),
            Batching::Dynamic | Batching::Single => self.idlest(session, tried, &[]),
        };
        if let Some(replica) = chosen {
            replica.give(self.sessions_given.fetch_add(1, Ordering::Relaxed) + 1);
        }
        chosen.cloned()
    }

    /// The replica for a query of a session that may move and is `open_on` some
    /// already, of those not in `tried`.
    pub fn for_query(
        &self,
        session: &str,
        open_on: &[Arc<Replica>],
        tried: &[Arc<Replica>],
    ) -> Option<Arc<Replica>> {
        self.idlest(session, tried, open_on).cloned()
    }

    /// One replica for all sessions of a seed, as long as it is configured:
    /// the highest of the replicas' hashes with the seed, which leaves the
    /// other seeds where they are when a replica comes or goes.
    fn fixed(&self, seed: u64) -> Option<&Arc<Replica>> {
        let rank = |replica: &&Arc<Replica>| Sha256::digest(format!("{seed} {replica}"));
        self.replicas.iter().max_by_key(rank)
    }

    /// Returns the replica with the fewest queries under way that is not out;
    /// of several, one that knows the session, and then the one whose last new
    /// session is longest ago. If all are out, the first answers why.
    fn idlest(
        &self,
        session: &str,
        tried: &[Arc<Replica>],
        open_on: &[Arc<Replica>],
    ) -> Option<&Arc<Replica>> {
        let left = self.replicas.iter().filter(|it| !contains(tried, it));
        left.min_by_key(|replica| {
            let is_out = !replica.would_admit(Call::Of(session));
            let is_new = !contains(open_on, replica);
            (is_out, replica.load(), is_new, replica.last_given())
        })
    }

    /// Asks a replica what its policy is, and holds it against what the first
    /// one said.
    ///
    /// # Errors
    /// If the replica does not answer, describes itself wrongly, or differs
    /// from the first.
    pub async fn describe(
        &self,
        replica: &Replica,
        call: Call<'_>,
    ) -> Result<Arc<DescribeResponse>, BackendError> {
        let mut described = replica
            .describe(call, &self.suite, |described| {
                self.agree(replica, described)
            })
            .await?;
        // A gateway behind this one knows better how the policy is asked.
        if described.batch_mode.is_empty() {
            let batch_size = check::batch_size(&described);
            described.batch_mode = self.batching.describe(batch_size);
            if described.unseeded {
                described.batch_mode.push_str(", unseeded");
            }
        }
        Ok(Arc::new(described))
    }

    /// Checks that a description agrees with the first one.
    fn agree(&self, replica: &Replica, described: &DescribeResponse) -> Result<(), String> {
        let mut agreed = self.agreed.lock().unwrap_or_else(PoisonError::into_inner);
        let by = replica.to_string();
        let first = agreed.get_or_insert_with(|| Agreed {
            described: Arc::new(described.clone()),
            by: by.clone(),
        });
        match check::difference(&first.described, described) {
            None => Ok(()),
            Some(difference) if first.by == by => Err(format!("changed: {difference}")),
            Some(difference) => Err(format!("is no replica of {}: {difference}", first.by)),
        }
    }
}

fn contains(replicas: &[Arc<Replica>], replica: &Arc<Replica>) -> bool {
    replicas.iter().any(|it| Arc::ptr_eq(it, replica))
}

impl fmt::Display for Pool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, replica) in self.replicas.iter().enumerate() {
            let separator = if at == 0 { "" } else { ", " };
            write!(f, "{separator}{replica}")?;
        }
        Ok(())
    }
}
