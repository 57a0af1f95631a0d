//! Memory use of the gateway in front of a server that never answers, with more waiting queries
//! than the gateway accepts.

use std::time::Duration;

use anyhow::{Result, bail};
use serde_json::{Value, json};
use tokio::task::JoinSet;
use tonic::Code;

use crate::{Measure, load::Slot, programs::Running, simulated};

/// Number of connections over which the queries are sent.
const CONNECTIONS: u32 = 64;
/// The load is complete once no query is refused and memory does not grow for this long.
const QUIET: Duration = Duration::from_secs(2);

pub(crate) async fn measure(measure: &Measure) -> Result<Value> {
    let options = simulated::Options { batch_millis: 0, max_batch: 1, stalled: true };
    let server = Running::simulated(&options).await?;
    let gateway = Running::gateway(&server).await?;
    let slots = Slot::open_all(&gateway.address, "", CONNECTIONS).await?;
    let mut waiting = Vec::new();
    for number in 0..measure.stalled_queries {
        waiting.push(slots[(number % CONNECTIONS) as usize].open_another(number).await?);
    }
    let before = gateway.memory_mib("VmRSS")?;
    let mut queries_in_flight = JoinSet::new();
    for slot in waiting {
        queries_in_flight.spawn(async move { slot.query(0).await });
    }
    let mut refused = 0;
    let mut highest = before;
    loop {
        while let Ok(Some(answered)) =
            tokio::time::timeout(QUIET, queries_in_flight.join_next()).await
        {
            match answered? {
                Err(status) if status.code() == Code::ResourceExhausted => refused += 1,
                other => bail!("a query to the stalled server ended otherwise: {other:?}"),
            }
        }
        let now = gateway.memory_mib("VmRSS")?;
        if now <= highest {
            break;
        }
        highest = now;
    }
    Ok(json!({
        "queries": measure.stalled_queries,
        "refused": refused,
        "waiting": queries_in_flight.len(),
        "before_mib": before,
        "with_waiting_mib": gateway.memory_mib("VmRSS")?,
        "most_mib": gateway.memory_mib("VmHWM")?,
    }))
}
