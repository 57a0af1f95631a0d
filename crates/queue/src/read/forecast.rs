//! How long rollouts would take, from what was measured of late.

use std::collections::BTreeMap;
use std::time::Duration;

use attempt::Pin;
use sqlx::types::Json;

use super::View;
use crate::store::workers::pin;
use crate::store::{Doing, StoreError};

/// How far back a result is looked at, and how many of each campaign.
const RECENT: Duration = Duration::from_secs(7 * 24 * 3_600);
const RECENT_RESULTS: u32 = 200;

/// How long rollouts would take.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Forecast {
    /// The workers alive that run alike, as a campaign requires; of several kinds
    /// those that are done first.
    pub workers: u32,
    /// Their slots.
    pub slots: u32,
    /// Seconds that they take together; none where nothing was measured.
    pub secs: Option<f64>,
    /// Results that this rests on.
    pub results: u64,
    /// Whether they are of the policy that was asked for; else they are of others.
    pub is_of_policy: bool,
    /// Suites without a result: taken to be as fast as the others.
    pub unmeasured_suites: Vec<String>,
}

/// Recent results of one policy in one suite, drawn by one renderer.
#[derive(Clone, Debug, PartialEq, sqlx::FromRow)]
struct Measured {
    policy: String,
    renderer: String,
    suite: String,
    results: i64,
    /// Mean duration of a rollout, seconds.
    secs: f64,
}

impl View {
    /// How long `rollouts`, by suite, would take a policy on the workers that are
    /// alive, if they run nothing else.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn forecast(
        &mut self,
        policy: &str,
        rollouts: &BTreeMap<String, u64>,
    ) -> Result<Forecast, StoreError> {
        let alive_since = self.now.minus(self.timing.worker_alive);
        let workers: Vec<(Json<Pin>, u32)> = sqlx::query_as(concat!(
            "SELECT ",
            pin!("worker"),
            ", slots FROM worker WHERE last_seen_ms >= ? AND stopped_reason IS NULL
                 AND signed_off_ms IS NULL"
        ))
        .bind(alive_since)
        .fetch_all(self.tx())
        .await
        .doing("look at the slots of live workers")?;
        let recent = self.now.minus(RECENT);
        let measured: Vec<Measured> = sqlx::query_as(
            "SELECT p.name AS policy, v.renderer,
                 substr(j.task, 1, instr(j.task, '/') - 1) AS suite, count(*) AS results,
                 avg(r.wall_secs) AS secs
             FROM campaign c JOIN policy p ON p.id = c.policy_id
             JOIN result r ON r.job_id IN
                 (SELECT job_id FROM result WHERE campaign_id = c.id AND committed_ms >= ?
                  ORDER BY committed_ms DESC LIMIT ?)
             JOIN job j ON j.id = r.job_id JOIN provenance v ON v.id = r.provenance_id
             GROUP BY p.name, v.renderer, suite",
        )
        .bind(recent)
        .bind(RECENT_RESULTS)
        .fetch_all(self.tx())
        .await
        .doing("look how long rollouts took of late")?;
        let workers = workers.into_iter().map(|(Json(pin), slots)| (pin, slots));
        Ok(forecast(workers, &measured, policy, rollouts))
    }
}

fn forecast(
    workers: impl Iterator<Item = (Pin, u32)>,
    measured: &[Measured],
    policy: &str,
    rollouts: &BTreeMap<String, u64>,
) -> Forecast {
    // Workers, and their slots, of each kind.
    let mut kinds: Vec<(Pin, u32, u32)> = Vec::new();
    for (pin, slots) in workers {
        match kinds.iter_mut().find(|(kind, ..)| *kind == pin) {
            Some((_, workers, all)) => (*workers, *all) = (*workers + 1, *all + slots),
            None => kinds.push((pin, 1, slots)),
        }
    }
    let of_kinds = kinds.iter().map(|(pin, workers, slots)| {
        let drawn = measured.iter().filter(|it| it.renderer == pin.renderer);
        let drawn: Vec<&Measured> = drawn.collect();
        let on = of_kind(*slots, &drawn, policy, rollouts);
        Forecast {
            workers: *workers,
            slots: *slots,
            ..on
        }
    });
    let least = |a: &Forecast, b: &Forecast| {
        let secs = |it: &Forecast| it.secs.unwrap_or(f64::INFINITY);
        secs(a).total_cmp(&secs(b)).then(b.slots.cmp(&a.slots))
    };
    of_kinds.min_by(least).unwrap_or_default()
}

fn of_kind(
    slots: u32,
    drawn: &[&Measured],
    policy: &str,
    rollouts: &BTreeMap<String, u64>,
) -> Forecast {
    let is_of_policy = drawn.iter().any(|it| it.policy == policy);
    let used = drawn.iter().copied();
    let used = used.filter(|it| !is_of_policy || it.policy == policy);
    let used: Vec<&Measured> = used.collect();
    let Some(any) = mean(used.iter().copied()) else {
        return Forecast::default();
    };
    let mut unmeasured_suites = Vec::new();
    let (mut work, mut longest) = (0.0, 0.0_f64);
    for (suite, count) in rollouts {
        let in_suite = used.iter().copied().filter(|it| it.suite == *suite);
        let secs = mean(in_suite).unwrap_or_else(|| {
            unmeasured_suites.push(suite.clone());
            any
        });
        work += *count as f64 * secs;
        longest = longest.max(secs);
    }
    Forecast {
        // A rollout takes its time, however many slots there are.
        secs: Some((work / f64::from(slots.max(1))).max(longest)),
        results: used.iter().map(|it| it.results.unsigned_abs()).sum(),
        is_of_policy,
        unmeasured_suites,
        ..Forecast::default()
    }
}

/// The mean duration of some results, seconds; none without a result.
fn mean<'a>(measured: impl Iterator<Item = &'a Measured>) -> Option<f64> {
    let (mut secs, mut results) = (0.0, 0.0);
    for it in measured {
        secs += it.secs * it.results as f64;
        results += it.results as f64;
    }
    (results > 0.0).then(|| secs / results)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pin(renderer: &str) -> Pin {
        Pin {
            renderer: renderer.to_owned(),
            ..Pin::default()
        }
    }

    fn measured(policy: &str, renderer: &str, suite: &str, results: i64, secs: f64) -> Measured {
        Measured {
            policy: policy.to_owned(),
            renderer: renderer.to_owned(),
            suite: suite.to_owned(),
            results,
            secs,
        }
    }

    fn of(workers: &[(&str, u32)], measured: &[Measured], rollouts: &[(&str, u64)]) -> Forecast {
        let workers = workers
            .iter()
            .map(|(renderer, slots)| (pin(renderer), *slots));
        let rollouts = rollouts
            .iter()
            .map(|(suite, count)| ((*suite).to_owned(), *count));
        forecast(workers, measured, "ours", &rollouts.collect())
    }

    #[test]
    fn suites_take_what_they_took_on_all_slots_that_run_alike() {
        let took = [
            measured("ours", "software", "goal", 10, 20.0),
            measured("ours", "software", "object", 30, 8.0),
            measured("other", "software", "goal", 50, 1.0),
        ];
        let workers = [("software", 2), ("software", 2), ("gl", 1)];
        let forecast = of(&workers, &took, &[("goal", 100), ("object", 50)]);
        assert_eq!((forecast.workers, forecast.slots), (2, 4));
        assert_eq!(forecast.secs, Some((100.0 * 20.0 + 50.0 * 8.0) / 4.0));
        assert_eq!((forecast.results, forecast.is_of_policy), (40, true));
        assert_eq!(forecast.unmeasured_suites, [""; 0]);
    }

    #[test]
    fn what_was_not_measured_is_said() {
        let took = [measured("other", "software", "object", 5, 6.0)];
        let forecast = of(&[("software", 3)], &took, &[("goal", 30), ("object", 30)]);
        assert_eq!((forecast.secs, forecast.is_of_policy), (Some(120.0), false));
        assert_eq!(forecast.unmeasured_suites, ["goal"]);

        let forecast = of(&[("gl", 3)], &took, &[("goal", 30)]);
        assert_eq!((forecast.secs, forecast.workers), (None, 1));
        assert_eq!(of(&[], &took, &[("goal", 30)]), Forecast::default());
    }

    #[test]
    fn a_rollout_takes_its_time_on_however_many_slots() {
        let took = [measured("ours", "software", "goal", 1, 40.0)];
        let forecast = of(&[("software", 64)], &took, &[("goal", 2)]);
        assert_eq!(forecast.secs, Some(40.0));
    }
}
