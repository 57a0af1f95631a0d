//! A replicate changes only the policy's seed, and the seed stays with the rollout from the
//! specification to the result.

use std::collections::{BTreeMap, BTreeSet};

use proto::coordinator as wire;
use serde_json::{Value, json};

use crate::harness::{Bench, rollout_id, small_spec, with};

const REPLICATES: u32 = 3;
/// Python's `zlib.crc32` of the id, and of the id with `#r1` and `#r2`.
const CAMERA: (&str, [u64; 3]) =
    ("object/t0/camera/L1/c00", [2_407_598_533, 1_434_740_286, 3_431_806_852]);
/// `zlib.crc32` of the id of another condition of the same configuration.
const SIMULTANEOUS: (&str, u64) = ("object/t0/simultaneous/L1/c00", 2_351_656_207);

fn spec(name: &str, realisation: &str) -> Value {
    with(
        small_spec(name),
        json!({"replicates": REPLICATES, "realisation": realisation, "record": "failures"}),
    )
}

/// Creates a campaign of four rollouts in three replicates, commits all of its leases and returns
/// them.
async fn run(bench: &Bench, spec: &Value) -> Vec<wire::Lease> {
    bench.create(spec).await.expect("created");
    let mut worker = bench.worker("a").await;
    let leases = worker.claim(64).await;
    assert_eq!(leases.len(), 4 * REPLICATES as usize);
    assert!(leases.iter().all(|lease| lease.record_video && lease.record_failures_only));
    worker.commit_all(&leases, true).await;
    leases
}

fn seeds(leases: &[wire::Lease]) -> BTreeMap<(String, u32), u64> {
    let seeds = leases.iter();
    seeds.map(|lease| ((rollout_id(lease), lease.replicate), lease.policy_seed)).collect()
}

#[tokio::test]
async fn seeds_match_the_protocol_in_every_campaign_and_differ_between_rollouts() {
    let bench = Bench::start().await;
    let matched = seeds(&run(&bench, &spec("matched", "matched")).await);
    for (replicate, seed) in (0..).zip(CAMERA.1) {
        assert_eq!(matched[&(CAMERA.0.to_owned(), replicate)], seed);
    }
    assert_eq!(matched[&(SIMULTANEOUS.0.to_owned(), 0)], SIMULTANEOUS.1);
    let distinct: BTreeSet<u64> = matched.values().copied().collect();
    assert_eq!(distinct.len(), matched.len(), "{matched:?}");
    let reference = seeds(&run(&bench, &spec("reference", "reference")).await);
    assert_eq!(matched, reference);
}

#[tokio::test]
async fn a_replicate_changes_the_policys_seed_and_nothing_else_and_the_seed_is_stored() {
    let bench = Bench::start().await;
    let leases = run(&bench, &spec("thrice", "matched")).await;
    let first_replicates = leases.iter().filter(|lease| lease.replicate == 0);
    for first in first_replicates {
        let replicates = leases.iter().filter(|lease| rollout_id(lease) == rollout_id(first));
        for lease in replicates {
            let expected = wire::Lease {
                attempt_id: lease.attempt_id.clone(),
                job_id: lease.job_id,
                attempt: lease.attempt,
                replicate: lease.replicate,
                policy_seed: lease.policy_seed,
                ..first.clone()
            };
            assert_eq!(*lease, expected);
        }
    }

    // The seeds are stored with the results.
    let pool = bench.database().await;
    let stored: Vec<(String, u32, i64)> = sqlx::query_as(
        "SELECT j.rollout_id, j.replicate, j.policy_seed FROM result r JOIN job j ON j.id = r.job_id",
    )
    .fetch_all(&pool)
    .await
    .expect("results");
    pool.close().await;
    let stored: BTreeMap<(String, u32), u64> = stored
        .into_iter()
        .map(|(id, replicate, seed)| ((id, replicate), seed.cast_unsigned()))
        .collect();
    assert_eq!(stored, seeds(&leases));
}
