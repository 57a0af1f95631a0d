//! Impossibly large numbers reported by workers must not make sums over workers overflow.

use tonic::Code;

use crate::assertions::assert_refused;
use crate::harness::{Bench, registration, small_spec};
use crate::page::http;

#[tokio::test(flavor = "multi_thread")]
async fn impossibly_large_numbers_from_workers_are_refused_or_capped() {
    let bench = Bench::with(&small_spec("huge")).await;
    let mut worker = bench.worker("w").await;
    let mut slots = registration("many", "primitives");
    slots.slots = u32::MAX;
    let mut cores = registration("many", "primitives");
    cores.cores = u32::MAX;
    for request in [slots, cores] {
        assert_refused(worker.service.register(request).await, Code::InvalidArgument, &[]);
    }
    let lease = worker.claim_one().await;
    let report = worker.report_altered(&lease, true, |of| of.result.wall_secs = 1e308);
    assert_refused(worker.service.commit(report).await, Code::InvalidArgument, &["`wall_secs`"]);
    worker.report_filming(u32::MAX).await;
    let metrics = http(&bench.url, "GET /metrics").await;
    assert_eq!(metrics.code, 200);
    assert!(metrics.text().contains("rollout_worker_slots_alive 2\n"));
}
