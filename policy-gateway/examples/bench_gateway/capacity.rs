//! Observations per second if every slot sends its next query as soon as the last one is answered.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::Args;
use serde_json::{Value, json};
use tokio::task::JoinSet;

use crate::{
    Measure,
    load::{Slot, percentiles, spread},
    programs::Running,
    simulated,
};

/// Answers within this time are not counted, since queues are still filling.
const WARM_UP: Duration = Duration::from_secs(2);

#[derive(Args)]
pub(crate) struct Slots {
    /// Address of the policy server or gateway
    #[arg(long, value_name = "HOST:PORT")]
    address: String,
    /// Name of the policy, if the server has several
    #[arg(long, default_value = "")]
    policy: String,
    /// Number of slots
    #[arg(long, default_value_t = 64)]
    slots: u32,
    /// Seconds of the measurement, after two seconds of warm-up
    #[arg(long, default_value_t = 20)]
    secs: u64,
}

/// Measures a gateway in front of a simulated server, and the share of that server's capacity that
/// the slots get.
pub(crate) async fn measure(measure: &Measure) -> Result<Value> {
    let options = simulated::Options {
        batch_millis: measure.batch_millis,
        max_batch: measure.max_batch,
        stalled: false,
    };
    let server = Running::simulated(&options).await?;
    let gateway = Running::gateway(&server).await?;
    let mut report = run_slots(&Slots {
        address: gateway.address.clone(),
        policy: String::new(),
        slots: measure.slots,
        secs: measure.secs,
    })
    .await?;
    let capacity = f64::from(measure.max_batch) * 1e3 / measure.batch_millis.max(1) as f64;
    let answered = report["answers_per_sec"]["mean"].as_f64();
    report["batch_millis"] = measure.batch_millis.into();
    report["max_batch"] = measure.max_batch.into();
    report["server_answers_per_sec"] = capacity.into();
    report["share_of_server"] = (answered.context("a mean")? / capacity).into();
    Ok(report)
}

/// Runs the slots against a server. Returns the answers per second and the latencies as JSON; fails
/// if a query fails.
pub(crate) async fn run_slots(slots: &Slots) -> Result<Value> {
    let counted_from = Instant::now() + WARM_UP;
    let ends = counted_from + Duration::from_secs(slots.secs);
    let mut running = JoinSet::new();
    for slot in Slot::open_all(&slots.address, &slots.policy, slots.slots).await? {
        running.spawn(query_until(slot, ends));
    }
    let mut answers = Vec::new();
    while let Some(ended) = running.join_next().await {
        let counted = ended??.into_iter().filter(|(answered_at, _)| *answered_at >= counted_from);
        answers.extend(counted);
    }
    let mut seconds = vec![0.0; slots.secs as usize];
    for (answered_at, _) in &answers {
        let second = (*answered_at - counted_from).as_secs() as usize;
        // Answers to queries still in flight at the end arrive later and are not in the rate.
        if let Some(second) = seconds.get_mut(second) {
            *second += 1.0;
        }
    }
    let latencies: Vec<_> = answers.iter().map(|(_, latency)| *latency).collect();
    let mut per_sec = spread(&seconds);
    per_sec["mean"] = (seconds.iter().sum::<f64>() / seconds.len().max(1) as f64).into();
    Ok(json!({
        "slots": slots.slots,
        "secs": slots.secs,
        "answers_per_sec": per_sec,
        "latency_millis": percentiles(&latencies),
    }))
}

/// Returns the time and the latency of each answer.
async fn query_until(slot: Slot, ends: Instant) -> Result<Vec<(Instant, Duration)>> {
    let mut answered = Vec::new();
    for query_index in 0.. {
        let sent_at = Instant::now();
        if sent_at >= ends {
            break;
        }
        slot.query(query_index).await?;
        let answered_at = Instant::now();
        answered.push((answered_at, answered_at - sent_at));
    }
    Ok(answered)
}
