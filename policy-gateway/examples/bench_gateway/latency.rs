//! Latency that the gateway adds to a query: the same open loop of queries at a fixed rate,
//! alternately direct and through the gateway. The server answers at once and takes no batches, so
//! that no query waits deliberately.

use std::{
    thread,
    time::{Duration, Instant},
};

use anyhow::Result;
use serde_json::{Value, json};
use tokio::{sync::mpsc, task::JoinSet};

use crate::{
    Measure,
    load::{Slot, percentile_millis, spread},
    programs::Running,
    simulated,
};

/// Number of slots that take turns; each sends its next query long after its last answer.
const SLOTS: u32 = 64;

pub(crate) async fn measure(measure: &Measure) -> Result<Value> {
    let options = simulated::Options { batch_millis: 0, max_batch: 1, stalled: false };
    let server = Running::simulated(&options).await?;
    let gateway = Running::gateway(&server).await?;
    let direct = Slot::open_all(&server.address, "", SLOTS).await?;
    let through = Slot::open_all(&gateway.address, "", SLOTS).await?;
    let secs = Duration::from_secs(measure.secs);
    let mut first_query = 0;
    let mut rounds = Vec::new();
    // The first round warms up connections and memory, and is not counted.
    for _ in 0..=measure.rounds {
        let queries = first_query..first_query + measure.rate * measure.secs as u32;
        first_query = queries.end;
        let direct_latencies = open_loop(&direct, measure.rate, secs, queries.start).await?;
        let gateway_latencies = open_loop(&through, measure.rate, secs, queries.start).await?;
        rounds.push((direct_latencies, gateway_latencies));
    }
    let counted = &rounds[1..];
    let percentile_summary = |share: f64| {
        let percentile = |latencies: &[Duration]| percentile_millis(latencies, share);
        let direct: Vec<_> =
            counted.iter().map(|(direct_latencies, _)| percentile(direct_latencies)).collect();
        let through: Vec<_> =
            counted.iter().map(|(_, gateway_latencies)| percentile(gateway_latencies)).collect();
        let pairs = direct.iter().zip(&through);
        let added: Vec<_> = pairs.map(|(direct, through)| through - direct).collect();
        json!({
            "direct_millis": spread(&direct),
            "through_millis": spread(&through),
            "added_millis": spread(&added),
        })
    };
    Ok(json!({
        "rate_per_sec": measure.rate,
        "rounds": measure.rounds,
        "secs_per_round": measure.secs,
        "p50": percentile_summary(0.5),
        "p99": percentile_summary(0.99),
    }))
}

/// Sends queries at a fixed rate, even if earlier queries are not answered yet. Returns the latency
/// of each query from its scheduled time.
async fn open_loop(
    slots: &[Slot],
    rate: u32,
    span: Duration,
    first_query: u32,
) -> Result<Vec<Duration>> {
    let queries = rate * span.as_secs() as u32;
    let (schedule, mut due_queries) = mpsc::unbounded_channel();
    // A separate thread, since the runtime's timer has a resolution of a millisecond.
    let ticker = thread::spawn(move || {
        let began = Instant::now();
        for number in 0..queries {
            let scheduled = began + Duration::from_secs(1) * number / rate;
            thread::sleep(scheduled.saturating_duration_since(Instant::now()));
            if schedule.send((number, scheduled)).is_err() {
                break;
            }
        }
    });
    let mut in_flight = JoinSet::new();
    while let Some((number, scheduled)) = due_queries.recv().await {
        let slot = slots[number as usize % slots.len()].clone();
        in_flight.spawn(async move {
            slot.query(first_query + number).await?;
            anyhow::Ok(scheduled.elapsed())
        });
    }
    let mut latencies = Vec::new();
    while let Some(latency) = in_flight.join_next().await {
        latencies.push(latency??);
    }
    ticker.join().expect("the ticker does not panic");
    Ok(latencies)
}
