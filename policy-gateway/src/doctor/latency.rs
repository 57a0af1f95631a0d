//! Latency of a policy server under load, in control steps. A campaign's execution model draws its
//! delays from this distribution.

use std::collections::BTreeMap;
use std::time::Duration;

use benchmark::{CONTROL_HZ, Delays, LatencyFileError};
use serde::Serialize;

use crate::doctor::check::CONCURRENCY;
use crate::doctor::probe::{ExaminationError, Probe, Target};
use crate::doctor::verdict::percentile;

const ROUNDS: u32 = 20;

/// Latencies of a server that is queried by several rollouts at once. Also the content of the file
/// that `coordinator campaign create --execution overlap:@FILE` reads.
#[derive(Clone, Debug, Serialize)]
pub struct Latency {
    pub server: String,
    pub policy: String,
    pub checkpoint: String,
    /// Number of concurrent rollouts.
    pub at_once: u32,
    pub answers: usize,
    /// Median of the answers' times, milliseconds.
    pub median_ms: f64,
    /// 95th percentile of the answers' times, milliseconds.
    pub p95_ms: f64,
    /// Longest time of an answer, milliseconds.
    pub slowest_ms: f64,
    /// Control steps per second, the unit of delays.
    pub control_hz: u32,
    /// Number of answers by delay in control steps, rounded up: an answer takes effect in the first
    /// control step after its arrival.
    pub delay_steps: BTreeMap<u16, u64>,
    /// True if the server uses the commands that are executed until its answer takes effect.
    pub real_time_chunking: bool,
}

pub async fn measure(target: &Target) -> Result<Latency, ExaminationError> {
    let probe = Probe::connect(target).await?;
    let mut latencies = Vec::new();
    for _ in 0..ROUNDS {
        let round = probe.concurrent_episodes(CONCURRENCY).await;
        let (_, round) = round.map_err(|status| probe.failed(status))?;
        latencies.extend(round);
    }
    let described = &probe.described;
    Ok(Latency {
        server: target.shown.clone(),
        policy: described.name.clone(),
        checkpoint: described.checkpoint.clone(),
        real_time_chunking: described.real_time_chunking,
        ..Latency::from_latencies(latencies)
    })
}

impl Latency {
    /// Computes the figures from at least one latency; leaves the names empty and
    /// `real_time_chunking` false.
    fn from_latencies(mut latencies: Vec<Duration>) -> Self {
        latencies.sort();
        let percentile = |percent| percentile(&latencies, percent).as_secs_f64() * 1000.0;
        let mut delay_steps = BTreeMap::new();
        for &latency in &latencies {
            *delay_steps.entry(steps(latency)).or_default() += 1;
        }
        Self {
            server: String::new(),
            policy: String::new(),
            checkpoint: String::new(),
            at_once: CONCURRENCY,
            answers: latencies.len(),
            median_ms: percentile(50),
            p95_ms: percentile(95),
            slowest_ms: percentile(100),
            control_hz: CONTROL_HZ,
            delay_steps,
            real_time_chunking: false,
        }
    }

    pub fn delays(&self) -> Result<Delays, LatencyFileError> {
        Delays::measured(self.delay_steps.clone())
    }

    pub fn describe(&self) -> String {
        let step = |milliseconds: f64| steps(Duration::from_secs_f64(milliseconds / 1000.0));
        let steps =
            |milliseconds: f64| terminal::counted(step(milliseconds).into(), "control step");
        let rtc = if self.real_time_chunking { "uses" } else { "does not use" };
        format!(
            "latency with {} rollouts at once: median {:.0} ms, {} at {} Hz; 95 % within {:.0} ms, \
             {}; slowest {:.0} ms, {}; it {rtc} real-time chunking",
            self.at_once,
            self.median_ms,
            steps(self.median_ms),
            self.control_hz,
            self.p95_ms,
            steps(self.p95_ms),
            self.slowest_ms,
            steps(self.slowest_ms),
        )
    }
}

fn steps(latency: Duration) -> u16 {
    let steps = (latency.as_secs_f64() * f64::from(CONTROL_HZ)).ceil();
    // A cast from float to integer saturates, at almost an hour.
    steps as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latencies_are_counted_in_control_steps_rounded_up() {
        let milliseconds = [1, 50, 51, 120, 149, 150, 151, 160, 170, 420];
        let latencies = milliseconds.map(Duration::from_millis).to_vec();
        let latency = Latency::from_latencies(latencies);
        let counts: Vec<(u16, u64)> = latency.delay_steps.clone().into_iter().collect();
        assert_eq!(counts, [(1, 2), (2, 1), (3, 3), (4, 3), (9, 1)]);
        assert_eq!(latency.median_ms.round(), 149.0);
        assert_eq!(latency.slowest_ms.round(), 420.0);
        let words = latency.describe();
        assert!(words.contains("median 149 ms, 3 control steps at 20 Hz"), "{words}");
        let text = serde_json::to_string(&latency).expect("JSON");
        let read = Delays::from_json(&text).expect("delays");
        assert_eq!(read.to_string(), "1*200+2*100+3*300+4*300+9*100");
        assert_eq!(latency.delays().expect("delays"), read);
    }
}
