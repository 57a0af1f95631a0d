//! `policy-gateway check URL`: checks that a policy server conforms to the policy protocol. This
//! module orders the checks: `probe` queries the server, `verdict` judges the answers,
//! [`scene`] generates observations. Servers of other protocols are checked behind a gateway.
//!
//! The check covers the protocol, not the policy's quality: the scenes are synthetic, so no answer
//! to them is good or bad.

use std::fmt;

use thiserror::Error;
use tonic::Status;
use transport::{Access, AccessError, ConnectError, status_text};

use probe::{EpisodeAnswers, Probe, QueryOrder};
pub use verdict::Verdict;

pub mod latency;
mod probe;
pub mod scene;
pub(crate) mod verdict;

const SEED: u64 = 1;
/// Seed of episodes whose answers may differ from those of the reference episode.
const OTHER_SEED: u64 = 2;
const CONCURRENCY: u32 = 8;
/// Queries per episode.
const QUERIES: u32 = 5;

/// Server and policy to check.
#[derive(Clone, Debug)]
pub struct Target {
    /// `grpc://HOST:PORT` or `http://HOST:PORT`; over TLS, `https://HOST:PORT`.
    pub url: String,
    /// Address as the user gave it, for messages.
    pub shown: String,
    /// Name of the policy; empty selects the only policy of the server.
    pub policy: String,
    /// Suite of the synthetic task, one of `scene::TASKS`.
    pub suite: String,
    pub access: Access,
}

/// Reason why a server cannot be checked. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum ConformanceError {
    #[error(
        "read {url:?} as a policy server's address: write grpc://HOST:PORT, or https://HOST:PORT \
         over TLS, or ws://HOST:PORT for an openpi server, or vla-eval://HOST:PORT for a model \
         server of vla-eval"
    )]
    Url { url: String },
    #[error(transparent)]
    Access(#[from] AccessError),
    #[error("reach the policy server at {url}: {trouble}")]
    Connect { url: String, trouble: Box<ConnectError> },
    #[error("have {url} describe its policy: {}", status_text(status))]
    Describe { url: String, status: Box<Status> },
    #[error("play one episode with {url}: {}", status_text(status))]
    Episode { url: String, status: Box<Status> },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    Description,
    Version,
    Health,
    Shape,
    Range,
    Retry,
    SameSeed,
    OtherSeed,
    Order,
    Isolation,
    Restart,
    Batch,
    Unopened,
    Speed,
}

impl Point {
    /// All points, in the order of the checks.
    pub const ALL: [Self; 14] = [
        Self::Description,
        Self::Version,
        Self::Health,
        Self::Shape,
        Self::Range,
        Self::Retry,
        Self::SameSeed,
        Self::OtherSeed,
        Self::Order,
        Self::Isolation,
        Self::Restart,
        Self::Batch,
        Self::Unopened,
        Self::Speed,
    ];
}

impl fmt::Display for Point {
    /// Writes the requirement as a sentence that is true of a conforming server.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Description => "the description is consistent",
            Self::Version => "another protocol version is refused",
            Self::Health => "the health service reports SERVING",
            Self::Shape => "answers are finite actions, n × 7, within the horizon",
            Self::Range => "actions lie within -1..1",
            Self::Retry => "a retry gets the same actions",
            Self::SameSeed => "the same seed gives the same actions",
            Self::OtherSeed => "another seed gives other actions exactly if declared stochastic",
            Self::Order => "the order of queries does not change the actions",
            Self::Isolation => "sessions do not affect one another",
            Self::Restart => "a Reset starts an open session anew",
            Self::Batch => "other queries of a batch do not change the actions",
            Self::Unopened => "a session that was never opened is refused",
            Self::Speed => "answer times are measured",
        })
    }
}

#[derive(Clone, Debug)]
pub struct Finding {
    pub point: Point,
    pub verdict: Verdict,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (word, text) = match &self.verdict {
            Verdict::Pass { note } => ("pass", note),
            Verdict::Fail { reason } => ("FAIL", reason),
            Verdict::Skip { reason } => ("skip", reason),
        };
        let separator = if text.is_empty() { "" } else { ": " };
        write!(f, "{word}  {}{separator}{text}", self.point)
    }
}

/// Checks a policy server point by point, and reports each finding as soon as it is made. Returns
/// true if no point failed.
pub async fn check(
    target: &Target,
    report: &mut dyn FnMut(&Finding),
) -> Result<bool, ConformanceError> {
    let probe = Probe::connect(target).await?;
    let reference = probe.episode("reference", SEED, QueryOrder::Forward).await;
    let reference = reference.map_err(|status| ConformanceError::Episode {
        url: target.shown.clone(),
        status: status.into(),
    })?;
    let mut conforms = true;
    for point in Point::ALL {
        let verdict = examine(point, &probe, &reference).await;
        let verdict = verdict.unwrap_or_else(|status| verdict::refused(&status));
        conforms &= !matches!(verdict, Verdict::Fail { .. });
        report(&Finding { point, verdict });
    }
    Ok(conforms)
}

/// Checks one point, by comparison with the reference episode.
async fn examine(
    point: Point,
    probe: &Probe,
    reference: &EpisodeAnswers,
) -> Result<Verdict, Status> {
    let described = probe.described();
    let answers = &reference.answers;
    Ok(match point {
        Point::SameSeed
        | Point::OtherSeed
        | Point::Order
        | Point::Isolation
        | Point::Restart
        | Point::Batch
            if described.unseeded =>
        {
            verdict::skip(
                "the policy's random numbers do not depend on the seed, so episodes cannot be \
                 compared",
            )
        }
        Point::Description => {
            verdict::description(described, policy_protocol::description(described))
        }
        Point::Version => probe.other_version().await,
        Point::Health => probe.health().await?,
        Point::Shape => verdict::shapes(answers, described.horizon),
        Point::Range => verdict::range(answers),
        Point::Retry => {
            let (first, second) = probe.retries(SEED).await?;
            verdict::same(&first, &second)
        }
        Point::SameSeed => {
            let again = probe.episode("again", SEED, QueryOrder::Forward).await?;
            verdict::same(answers, &again.answers)
        }
        Point::OtherSeed => {
            let other = probe.episode("other seed", OTHER_SEED, QueryOrder::Forward).await?;
            verdict::seeds(described.stochastic, answers, &other.answers)
        }
        Point::Order if described.stateful => {
            verdict::skip("the policy is stateful: it requires queries in order")
        }
        Point::Order => {
            let backward = probe.episode("backward", SEED, QueryOrder::Backward).await?;
            verdict::same(answers, &backward.answers)
        }
        Point::Isolation => verdict::same(answers, &probe.interleaved(SEED, OTHER_SEED).await?),
        Point::Restart => verdict::same(answers, &probe.restarted(SEED, OTHER_SEED).await?),
        Point::Batch if described.max_batch <= 1 => verdict::skip("the policy declares no batches"),
        Point::Batch => verdict::batch(answers, &probe.batched(SEED).await?),
        Point::Unopened => probe.unopened().await,
        Point::Speed => {
            let (wall, concurrent) = probe.concurrent_episodes(CONCURRENCY).await?;
            verdict::speed(&reference.latencies, CONCURRENCY, wall, &concurrent)
        }
    })
}
