//! Forecast of the duration of rollouts on the live workers: the mean time of recent rollouts,
//! divided by the workers' slots.

use std::collections::BTreeMap;
use std::time::Duration;

use benchmark::attempt::Pin;
use serde::{Deserialize, Serialize};

use super::View;
use crate::store::workers::pin;
use crate::store::{Doing, StoreError};

/// Largest age of the results that a forecast uses.
const RECENT: Duration = Duration::from_secs(7 * 24 * 3_600);
/// Most results of one campaign that a forecast uses.
const RECENT_RESULTS: u32 = 200;

/// Forecast of the duration of rollouts, as operators get it; docs/JSON.md describes the keys.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// Number of live workers with one pin, since a campaign runs on workers of a single pin; of
    /// several pins, the one with the most slots.
    pub workers: u64,
    pub slots: u64,
    /// Seconds until all rollouts are done; `None` without measurements.
    pub secs: Option<f64>,
    pub results: u64,
    /// True if these results are of the requested policy, false if they are of other policies.
    pub is_of_policy: bool,
    /// Suites without a result, assumed to be as fast as the others.
    pub unmeasured_suites: Vec<String>,
    /// Number of slots that keep the workers' cores busy although slots wait for the policy;
    /// `None` without measurements, or if a worker does not report its cores.
    pub useful_slots: Option<u64>,
}

/// Recent results of one policy in one suite, drawn by one renderer.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
struct Measured {
    policy: String,
    renderer: String,
    suite: String,
    results: i64,
    /// Seconds of these rollouts together, as the fields below.
    secs: f64,
    /// Processor time of physics and drawing.
    processor_secs: f64,
    policy_secs: f64,
}

#[derive(Clone, Debug, sqlx_macros::FromRow)]
struct Live {
    #[sqlx(json)]
    pin: Pin,
    slots: u32,
    cores: Option<u32>,
}

impl View {
    /// Forecasts the duration of numbers of rollouts by suite on the live workers, assuming that
    /// the workers run no other rollouts.
    pub async fn forecast(
        &mut self,
        policy: &str,
        rollouts: &BTreeMap<String, u64>,
    ) -> Result<Forecast, StoreError> {
        let alive_since = self.now.minus(self.timing.worker_alive);
        let workers = sqlx::query_as(concat!(
            "SELECT ",
            pin!("worker"),
            " AS pin, slots, cores FROM worker WHERE last_seen_ms >= ?
                 AND stopped_reason IS NULL AND signed_off_ms IS NULL"
        ));
        let workers = workers.bind(alive_since).fetch_all(self.tx()).await;
        let workers: Vec<Live> = workers.doing("read the slots of live workers")?;
        let measured: Result<Vec<Measured>, _> = sqlx::query_as(
            "SELECT p.name AS policy, v.renderer,
                 substr(j.task, 1, instr(j.task, '/') - 1) AS suite, count(*) AS results,
                 sum(r.wall_secs) AS secs,
                 sum((r.outcome ->> '$.parts.physics_secs')
                     + (r.outcome ->> '$.parts.drawing_secs')) AS processor_secs,
                 sum(r.outcome ->> '$.parts.policy_secs') AS policy_secs
             FROM campaign c JOIN policy p ON p.id = c.policy_id
             JOIN result r ON r.job_id IN
                 (SELECT job_id FROM result WHERE campaign_id = c.id AND committed_ms >= ?1
                  ORDER BY committed_ms DESC LIMIT ?2)
             JOIN job j ON j.id = r.job_id JOIN provenance v ON v.id = r.provenance_id
             GROUP BY p.name, v.renderer, suite",
        )
        .bind(self.now.minus(RECENT))
        .bind(RECENT_RESULTS)
        .fetch_all(self.tx())
        .await;
        let measured = measured.doing("read the recent durations of rollouts")?;
        Ok(forecast(&workers, measured, policy, rollouts))
    }
}

fn forecast(
    workers: &[Live],
    mut measured: Vec<Measured>,
    policy: &str,
    rollouts: &BTreeMap<String, u64>,
) -> Forecast {
    let of_pin = |pin: &Pin| workers.iter().filter(|worker| worker.pin == *pin).collect::<Vec<_>>();
    let slots = |workers: &[&Live]| workers.iter().map(|worker| u64::from(worker.slots)).sum();
    let groups = workers.iter().map(|worker| of_pin(&worker.pin));
    let Some(workers) = groups.max_by_key(|workers| slots(workers)) else {
        return Forecast::default();
    };
    measured.retain(|row| row.renderer == workers[0].pin.renderer);
    let is_of_policy = measured.iter().any(|row| row.policy == policy);
    measured.retain(|row| !is_of_policy || row.policy == policy);
    let mean = |suite: Option<&str>| {
        let rows = measured.iter().filter(|row| suite.is_none_or(|suite| row.suite == suite));
        let (secs, results) =
            rows.fold((0.0, 0), |sums, row| (sums.0 + row.secs, sums.1 + row.results));
        (results > 0).then(|| secs / results as f64)
    };
    let sum = |value: fn(&Measured) -> f64| measured.iter().map(value).sum::<f64>();
    let [processor, answers] = [sum(|row| row.processor_secs), sum(|row| row.policy_secs)];
    let cores: Option<u64> = workers.iter().map(|worker| worker.cores.map(u64::from)).sum();
    let cores = cores.filter(|_| processor > 0.0);
    let slots: u64 = slots(&workers);
    let secs = mean(None).map(|mean_secs| {
        let secs = |suite: &String| mean(Some(suite)).unwrap_or(mean_secs);
        let work: f64 = rollouts.iter().map(|(suite, count)| *count as f64 * secs(suite)).sum();
        // Additional slots do not shorten a single rollout.
        let longest = rollouts.keys().map(secs).fold(0.0, f64::max);
        (work / slots.max(1) as f64).max(longest)
    });
    let unmeasured = rollouts.keys().filter(|suite| secs.is_some() && mean(Some(suite)).is_none());
    Forecast {
        workers: workers.len() as u64,
        slots,
        secs,
        results: measured.iter().map(|row| row.results.unsigned_abs()).sum(),
        is_of_policy,
        unmeasured_suites: unmeasured.cloned().collect(),
        // A float cast saturates.
        useful_slots: cores.map(|cores| (cores as f64 * (1.0 + answers / processor)).ceil() as u64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forecast_of(workers: &[(&str, u32)], rollouts: &[(&str, u64)]) -> Forecast {
        let live = |&(renderer, slots): &(&str, u32)| Live {
            pin: Pin { renderer: renderer.to_owned(), ..Pin::default() },
            slots,
            cores: (slots < 9).then_some(4),
        };
        // Policy, renderer, suite, results, and seconds of a rollout.
        let measured = [
            ("ours", "software", "goal", 10, 20.0),
            ("ours", "software", "object", 30, 8.0),
            ("other", "software", "goal", 50, 1.0),
            ("other", "gl", "object", 5, 6.0),
        ];
        let measured = measured.map(|(policy, renderer, suite, results, secs)| Measured {
            policy: policy.to_owned(),
            renderer: renderer.to_owned(),
            suite: suite.to_owned(),
            results,
            secs: secs * results as f64,
            processor_secs: 2.0 * results as f64,
            policy_secs: 3.0 * results as f64,
        });
        let rollouts = rollouts.iter().map(|(suite, count)| ((*suite).to_owned(), *count));
        let workers: Vec<Live> = workers.iter().map(live).collect();
        forecast(&workers, measured.into(), "ours", &rollouts.collect())
    }

    #[test]
    fn rollouts_take_their_suites_mean_time_on_the_slots_of_the_largest_pin() {
        let both = [("goal", 100), ("object", 50)];
        let ours = forecast_of(&[("software", 2), ("gl", 3), ("software", 2)], &both);
        assert_eq!((ours.workers, ours.slots, ours.results), (2, 4, 40));
        assert_eq!(ours.secs, Some((100.0 * 20.0 + 50.0 * 8.0) / 4.0));
        assert_eq!((ours.is_of_policy, ours.unmeasured_suites.len()), (true, 0));
        // A rollout needs a core for two of five seconds; there are eight cores.
        assert_eq!(ours.useful_slots, Some(20));
        let others = forecast_of(&[("gl", 3)], &both);
        assert_eq!((others.secs, others.is_of_policy), (Some(300.0), false));
        assert_eq!(others.unmeasured_suites, ["goal"]);
        let many = forecast_of(&[("software", 64)], &[("goal", 2)]);
        assert_eq!((many.secs, many.useful_slots), (Some(20.0), None));
        let unmeasured = forecast_of(&[("osmesa", 1)], &both);
        assert_eq!((unmeasured.workers, unmeasured.secs, unmeasured.useful_slots), (1, None, None));
        assert_eq!(forecast_of(&[], &both), Forecast::default());
        let huge = forecast_of(&[("software", u32::MAX)], &[("goal", u64::MAX), ("object", 1)]);
        assert!(huge.secs.is_some_and(f64::is_finite));
    }
}
