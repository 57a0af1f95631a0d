//! Whether a policy server keeps the policy protocol: what `policy-gateway
//! check URL` runs. Responsible for the order of the points and for nothing
//! else: [`probe`] asks, [`verdict`] judges, [`scene`] makes up observations.
//!
//! It judges the protocol, not the policy: the scenes are made up, and no
//! answer to them is a good or a bad one.

use std::{fmt, time::Duration};

use thiserror::Error;
use tonic::Status;

use crate::check;
use probe::{Order, Probe};
use verdict::Verdict;

pub mod probe;
pub mod scene;
pub mod verdict;

/// Queries of one probing episode.
pub const QUERIES: u32 = 5;
/// Episodes at once while throughput is measured.
pub const CONCURRENCY: u32 = 8;

/// What to check.
#[derive(Clone, Debug)]
pub struct Target {
    /// `http://HOST:PORT` or `grpc://HOST:PORT`.
    pub url: String,
    /// Which policy there; empty: the only one.
    pub policy: String,
}

/// One point of the protocol and how the server does on it.
#[derive(Clone, Debug)]
pub struct Finding {
    /// What was checked, as a sentence that should be true.
    pub point: &'static str,
    /// Whether it is.
    pub verdict: Verdict,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.verdict {
            Verdict::Pass { note } if note.is_empty() => write!(f, "pass  {}", self.point),
            Verdict::Pass { note } => write!(f, "pass  {}: {note}", self.point),
            Verdict::Fail { reason } => write!(f, "FAIL  {}: {reason}", self.point),
            Verdict::Skip { reason } => write!(f, "skip  {}: {reason}", self.point),
        }
    }
}

/// Checks a policy server point by point, telling `report` each as it is
/// known. True if none failed.
///
/// # Errors
/// When the server cannot be reached or cannot describe itself: then there is
/// nothing to check.
pub async fn check(
    target: &Target,
    report: &mut dyn FnMut(&Finding),
) -> Result<bool, ConformanceError> {
    let probe = Probe::connect(target).await?;
    let described = probe.described().clone();
    let mut conforms = true;
    let mut note = |point, verdict| {
        conforms &= !matches!(verdict, Verdict::Fail { .. });
        report(&Finding { point, verdict });
    };
    note("the description can be true", {
        verdict::description(&described, check::description(&described))
    });
    note(
        "another protocol version is refused",
        judge(probe.other_version().await, |it| it),
    );
    note(
        "the health service says that it serves",
        judge(probe.health().await, |it| it),
    );

    let first = probe.episode("first", 1, Order::Forward).await;
    let reference = match first {
        Ok(reference) => reference,
        Err(status) => {
            note("an episode is answered", verdict::refused(&status));
            return Ok(false);
        }
    };
    note("answers are finite actions, n × 7, within the horizon", {
        verdict::shapes(&reference.answers, described.horizon)
    });
    note(
        "actions lie within -1..1",
        verdict::range(&reference.answers),
    );
    let same = |it: Vec<_>| verdict::same(&reference.answers, &it);
    note("a retry gets the same actions", {
        judge(probe.retries("retried", 1).await, |(answers, retries)| {
            verdict::same(&answers, &retries)
        })
    });
    note("the same seed gives the same actions", {
        judge(probe.episode("second", 1, Order::Forward).await, |it| {
            same(it.answers)
        })
    });
    note(
        "another seed gives other actions just if the policy is stochastic",
        {
            judge(probe.episode("other seed", 2, Order::Forward).await, |it| {
                verdict::seeds(described.stochastic, &reference.answers, &it.answers)
            })
        },
    );
    note("the order of queries changes nothing", {
        match described.stateful {
            true => verdict::skip("the policy is stateful: its queries come in order"),
            false => judge(probe.episode("backwards", 1, Order::Backward).await, |it| {
                same(it.answers)
            }),
        }
    });
    note(
        "sessions do not touch one another",
        judge(probe.interleaved(1, 3).await, same),
    );
    note(
        "a Reset starts an open session anew",
        judge(probe.restarted(1).await, same),
    );
    note("a batch's neighbours change nothing", {
        match described.max_batch {
            0 | 1 => verdict::skip("the policy declares no batches"),
            largest => judge(probe.batched(1, largest).await, |batched| {
                verdict::batch(&reference.answers, &batched)
            }),
        }
    });
    note(
        "a session that was never opened is refused",
        probe.unopened().await,
    );
    note(
        "it answers at speed",
        measure(&probe, reference.latencies).await,
    );
    Ok(conforms)
}

/// Judges evidence, or the status that came in its place.
fn judge<T>(evidence: Result<T, Status>, verdict: impl FnOnce(T) -> Verdict) -> Verdict {
    match evidence {
        Ok(evidence) => verdict(evidence),
        Err(status) => verdict::refused(&status),
    }
}

async fn measure(probe: &Probe, alone: Vec<Duration>) -> Verdict {
    judge(probe.side_by_side(CONCURRENCY).await, |(wall, together)| {
        verdict::speed(&alone, CONCURRENCY, wall, &together)
    })
}

/// Why a server cannot be checked. Reads after "failed to …".
#[derive(Debug, Error)]
pub enum ConformanceError {
    /// Not `grpc://HOST:PORT`.
    #[error("read {url:?} as a policy server's address: write grpc://HOST:PORT")]
    Url {
        /// As given.
        url: String,
    },
    /// Nothing listens there.
    #[error("reach a policy server at {url}: start it, or correct the address")]
    Connect {
        /// As given.
        url: String,
        /// Why not.
        #[source]
        source: tonic::transport::Error,
    },
    /// It does not say what it is.
    #[error("have {url} describe its policy: it answered {:?}: {}", status.code(), status.message())]
    Describe {
        /// As given.
        url: String,
        /// What it answered.
        status: Box<Status>,
    },
}
