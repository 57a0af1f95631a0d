//! `policy-gateway check URL`: checks that a policy server conforms to the policy protocol. This
//! module orders the checks: `probe` queries the server, `verdict` judges the answers,
//! [`scene`] generates observations. Servers of other protocols are checked behind a gateway.
//!
//! The check covers the protocol, not the policy's quality: the scenes are synthetic, so no answer
//! to them is good or bad.

use thiserror::Error;
use tonic::Status;
use transport::{Access, AccessError, ConnectError, status_text};

use crate::doctor::verdict::{Finding, Verdict, points, skip};
use probe::{EpisodeAnswers, Probe, QueryOrder};

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

points! {
    Description "the description is consistent",
    Version "another protocol version is refused",
    Health "the health service reports SERVING",
    Shape "answers are finite actions, n × 7, within the horizon",
    Range "actions lie within -1..1",
    Retry "a retry gets the same actions",
    SameSeed "the same seed gives the same actions",
    OtherSeed "another seed gives other actions exactly if declared stochastic",
    Order "the order of queries does not change the actions",
    Isolation "sessions do not affect one another",
    Restart "a Reset starts an open session anew",
    Batch "other queries of a batch do not change the actions",
    Unopened "a session that was never opened is refused",
    Speed "answer times are measured",
}

/// Checks a policy server point by point, and reports each finding as soon as it is made. Returns
/// true if no point failed.
pub async fn check(
    target: &Target,
    report: &mut dyn FnMut(&Finding<Point>),
) -> Result<bool, ConformanceError> {
    let probe = Probe::connect(target).await?;
    let reference = probe.episode("reference", SEED, QueryOrder::Forward).await;
    let reference = reference.map_err(|status| ConformanceError::Episode {
        url: target.shown.clone(),
        status: status.into(),
    })?;
    let mut conforms = true;
    for &point in Point::ALL {
        let verdict = examine(point, &probe, &reference).await;
        let verdict = verdict.unwrap_or_else(|status| verdict::refused(&status));
        conforms &= !verdict.has_failed();
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
            skip(
                "the policy's random numbers do not depend on the seed, so episodes cannot be \
                 compared",
            )
        }
        Point::Description => {
            verdict::description(described, proto::checks::description(described))
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
            skip("the policy is stateful: it requires queries in order")
        }
        Point::Order => {
            let backward = probe.episode("backward", SEED, QueryOrder::Backward).await?;
            verdict::same(answers, &backward.answers)
        }
        Point::Isolation => verdict::same(answers, &probe.interleaved(SEED, OTHER_SEED).await?),
        Point::Restart => verdict::same(answers, &probe.restarted(SEED, OTHER_SEED).await?),
        Point::Batch if described.max_batch <= 1 => skip("the policy declares no batches"),
        Point::Batch => verdict::batch(answers, &probe.batched(SEED).await?),
        Point::Unopened => probe.unopened().await,
        Point::Speed => {
            let (wall, concurrent) = probe.concurrent_episodes(CONCURRENCY).await?;
            verdict::speed(&reference.latencies, CONCURRENCY, wall, &concurrent)
        }
    })
}
