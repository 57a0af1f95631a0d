//! Forecast of the duration of rollouts from measured ones, and the limiting resource. Pure
//! functions.

use std::collections::BTreeMap;

use rollout_types::Pin;

use super::speed::{Machine, Rate, Spent, rate};

/// Forecast of the duration of rollouts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Forecast {
    /// Number of live workers with one pin, since a campaign runs on workers of a single pin. If
    /// workers have several pins, the forecast is for the pin that finishes first.
    pub workers: u32,
    pub slots: u32,
    /// Cores of these workers; `None` if a worker does not report its cores.
    pub cores: Option<u32>,
    /// Seconds until all rollouts are done; `None` without measurements.
    pub secs: Option<f64>,
    /// Number of results that the forecast is based on.
    pub results: u64,
    /// True if these results are of the requested policy, false if they are of other policies.
    pub is_of_policy: bool,
    /// Suites without a result, assumed to be as fast as the others.
    pub unmeasured_suites: Vec<String>,
    /// Time of a rollout and the bottleneck; `None` without results.
    pub speed: Option<Speed>,
}

/// Time that a rollout takes, and the bottleneck of the forecast.
#[derive(Clone, Debug, PartialEq)]
pub struct Speed {
    /// Number of results that it is based on.
    pub results: u64,
    /// Mean time of one rollout, by part.
    pub spent: Spent,
    /// Rate on the workers of the forecast; `None` if a worker does not report its number of cores,
    /// or the results took no processor time.
    pub rate: Option<Rate>,
    /// Seconds that the rollouts take with [`Rate::enough_slots`]; further slots do not raise the
    /// rate.
    pub enough_slots_secs: Option<f64>,
}

/// Rollouts to be forecast.
#[derive(Clone, Debug, Default)]
pub struct Planned<'a> {
    pub policy: &'a str,
    /// Numbers of rollouts, by suite.
    pub rollouts: BTreeMap<String, u64>,
    /// Most queries per second that the policy's server answers, if known.
    pub policy_rate: Option<f64>,
}

/// Recent results of one policy in one suite, rendered by one renderer.
#[derive(Clone, Debug, Default, PartialEq, sqlx_macros::FromRow)]
pub(super) struct Measured {
    pub(super) policy: String,
    pub(super) renderer: String,
    pub(super) suite: String,
    /// True if every slot had a core to itself.
    pub(super) is_roomy: bool,
    pub(super) results: i64,
    /// Mean duration of a rollout, seconds. The fields below are means per rollout, too, as in
    /// [`Spent`].
    pub(super) secs: f64,
    pub(super) physics_secs: f64,
    pub(super) drawing_secs: f64,
    pub(super) policy_secs: f64,
    pub(super) waiting_secs: f64,
    pub(super) queries: f64,
}

/// A worker that is alive.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(super) struct Live {
    #[sqlx(json)]
    pub(super) pin: Pin,
    pub(super) slots: u32,
    pub(super) cores: Option<u32>,
}

/// Forecasts the planned rollouts on the workers of the pin that finishes first.
pub(super) fn forecast(workers: &[Live], measured: &[Measured], planned: &Planned<'_>) -> Forecast {
    let mut pins: Vec<(&Pin, Vec<&Live>)> = Vec::new();
    for worker in workers {
        match pins.iter_mut().find(|(pin, _)| **pin == worker.pin) {
            Some((_, workers)) => workers.push(worker),
            None => pins.push((&worker.pin, vec![worker])),
        }
    }
    let by_pin = pins.iter().map(|(pin, workers)| {
        let of_renderer = measured.iter().filter(|results| results.renderer == pin.renderer);
        forecast_for_pin(workers, &of_renderer.collect::<Vec<_>>(), planned)
    });
    let by_duration = |a: &Forecast, b: &Forecast| {
        let secs = |forecast: &Forecast| forecast.secs.unwrap_or(f64::INFINITY);
        secs(a).total_cmp(&secs(b)).then(b.slots.cmp(&a.slots))
    };
    by_pin.min_by(by_duration).unwrap_or_default()
}

/// Returns the forecast for workers with one pin, from results of the pin's renderer.
fn forecast_for_pin(
    workers: &[&Live],
    of_renderer: &[&Measured],
    planned: &Planned<'_>,
) -> Forecast {
    let slots = saturating_sum(workers.iter().map(|worker| worker.slots));
    let machine = |worker: &&Live| worker.cores.map(|cores| Machine { slots: worker.slots, cores });
    let machines: Option<Vec<Machine>> = workers.iter().map(machine).collect();
    let is_of_policy = of_renderer.iter().any(|results| results.policy == planned.policy);
    let used = of_renderer.iter().copied();
    let used = used.filter(|results| !is_of_policy || results.policy == planned.policy);
    let used: Vec<&Measured> = used.collect();
    let forecast = Forecast {
        workers: u32::try_from(workers.len()).unwrap_or(u32::MAX),
        slots,
        cores: machines.as_ref().map(|all| saturating_sum(all.iter().map(|worker| worker.cores))),
        ..Forecast::default()
    };
    let duration: MeanAccessors = (|row| row.secs, |row| row.results);
    let Some(overall_mean) = mean(&used, duration) else {
        return forecast;
    };
    let mut unmeasured_suites = Vec::new();
    let (mut work, mut longest) = (0.0, 0.0_f64);
    for (suite, count) in &planned.rollouts {
        let secs = mean(&of_suite(&used, suite), duration).unwrap_or_else(|| {
            unmeasured_suites.push(suite.clone());
            overall_mean
        });
        work += *count as f64 * secs;
        longest = longest.max(secs);
    }
    let rollouts = total(&planned.rollouts);
    // Additional slots do not shorten a single rollout.
    let secs_at_rate = |per_sec: f64| (rollouts as f64 / per_sec).max(longest);
    let speed = spent(&used, &planned.rollouts).map(|(results, spent)| {
        let rate = rate(machines.as_deref().unwrap_or(&[]), &spent, planned.policy_rate);
        Speed {
            results,
            spent,
            rate,
            enough_slots_secs: rate.map(|rate| secs_at_rate(rate.most_per_sec)),
        }
    });
    let rate = speed.as_ref().and_then(|speed| speed.rate);
    let secs_by_slots = || (work / f64::from(slots.max(1))).max(longest);
    Forecast {
        secs: Some(rate.map_or_else(secs_by_slots, |rate| secs_at_rate(rate.per_sec))),
        results: used.iter().map(|row| row.results.unsigned_abs()).sum(),
        is_of_policy,
        unmeasured_suites,
        speed,
        ..forecast
    }
}

/// Sums numbers reported by workers. Saturates, since a worker may report any number.
fn saturating_sum(numbers: impl Iterator<Item = u32>) -> u32 {
    numbers.fold(0, u32::saturating_add)
}

fn total(rollouts: &BTreeMap<String, u64>) -> u64 {
    rollouts.values().copied().fold(0, u64::saturating_add)
}

/// Accessors of a mean value and of the number of results that it covers.
type MeanAccessors = (fn(&Measured) -> f64, fn(&Measured) -> i64);

fn of_suite<'a>(measured: &[&'a Measured], suite: &str) -> Vec<&'a Measured> {
    let in_suite = measured.iter().filter(|row| row.suite == suite);
    in_suite.copied().collect()
}

/// Returns the mean time of a planned rollout by part, and the number of results that it is based
/// on. A suite without results is assumed to take the mean time of all results. `None` without
/// results.
fn spent(used: &[&Measured], rollouts: &BTreeMap<String, u64>) -> Option<(u64, Spent)> {
    let results: i64 = used.iter().map(|row| row.results).sum();
    let total = total(rollouts);
    // Without planned rollouts there are no weights, and the mean of all results is used.
    let weight = |suite: &str| match total {
        0 => 0.0,
        _ => rollouts.get(suite).copied().unwrap_or_default() as f64 / total as f64,
    };
    let weighted_mean = |rows: &[&Measured], value: fn(&Measured) -> f64| {
        let all = mean(rows, (value, |row| row.results))?;
        let suites = rollouts.keys().map(|suite| {
            let secs = mean(&of_suite(rows, suite), (value, |row| row.results));
            weight(suite) * secs.unwrap_or(all)
        });
        Some(match total {
            0 => all,
            _ => suites.sum(),
        })
    };
    let roomy = used.iter().copied().filter(|row| row.is_roomy);
    let roomy: Vec<&Measured> = roomy.collect();
    let spent = Spent {
        physics_secs: weighted_mean(used, |row| row.physics_secs)?,
        drawing_secs: weighted_mean(used, |row| row.drawing_secs)?,
        policy_secs: weighted_mean(used, |row| row.policy_secs)?,
        waiting_secs: weighted_mean(used, |row| row.waiting_secs)?,
        // Measured only where every slot had its own core: on shared cores, slots also wait for one
        // another.
        taken_secs: weighted_mean(&roomy, |row| row.waiting_secs).unwrap_or(0.0),
        queries: weighted_mean(used, |row| row.queries)?,
    };
    Some((results.unsigned_abs(), spent))
}

/// Returns the mean of a value over some results; `None` without results.
fn mean(measured: &[&Measured], (value, count): MeanAccessors) -> Option<f64> {
    let (mut sum, mut results) = (0.0, 0.0);
    for row in measured {
        sum += value(row) * count(row) as f64;
        results += count(row) as f64;
    }
    (results > 0.0).then(|| sum / results)
}

#[cfg(test)]
mod tests {
    use super::super::speed::Bottleneck;
    use super::*;

    fn pin(renderer: &str) -> Pin {
        Pin { renderer: renderer.to_owned(), ..Pin::default() }
    }

    fn measured(policy: &str, renderer: &str, suite: &str, results: i64, secs: f64) -> Measured {
        Measured {
            policy: policy.to_owned(),
            renderer: renderer.to_owned(),
            suite: suite.to_owned(),
            results,
            secs,
            ..Measured::default()
        }
    }

    fn forecast_without_cores(
        workers: &[(&str, u32)],
        measured: &[Measured],
        rollouts: &[(&str, u64)],
    ) -> Forecast {
        forecast_with_cores(None, workers, measured, rollouts)
    }

    fn forecast_with_cores(
        cores: Option<u32>,
        workers: &[(&str, u32)],
        measured: &[Measured],
        rollouts: &[(&str, u64)],
    ) -> Forecast {
        let live =
            |(renderer, slots): &(&str, u32)| Live { pin: pin(renderer), slots: *slots, cores };
        let workers: Vec<Live> = workers.iter().map(live).collect();
        let rollouts = rollouts.iter().map(|(suite, count)| ((*suite).to_owned(), *count));
        let planned = Planned { policy: "ours", rollouts: rollouts.collect(), policy_rate: None };
        forecast(&workers, measured, &planned)
    }

    /// A rollout of ten seconds: four on a core, five for the policy, one waiting.
    fn with_times(suite: &str, is_roomy: bool) -> Measured {
        Measured {
            is_roomy,
            physics_secs: 3.0,
            drawing_secs: 1.0,
            policy_secs: 5.0,
            waiting_secs: 1.0,
            queries: 25.0,
            ..measured("ours", "software", suite, 10, 10.0)
        }
    }

    #[test]
    fn a_suite_is_forecast_from_its_measured_durations_on_the_fastest_pin() {
        let measurements = [
            measured("ours", "software", "goal", 10, 20.0),
            measured("ours", "software", "object", 30, 8.0),
            measured("other", "software", "goal", 50, 1.0),
        ];
        let workers = [("software", 2), ("software", 2), ("gl", 1)];
        let forecast =
            forecast_without_cores(&workers, &measurements, &[("goal", 100), ("object", 50)]);
        assert_eq!((forecast.workers, forecast.slots), (2, 4));
        assert_eq!(forecast.secs, Some((100.0 * 20.0 + 50.0 * 8.0) / 4.0));
        assert_eq!((forecast.results, forecast.is_of_policy), (40, true));
        assert_eq!(forecast.unmeasured_suites, [""; 0]);
    }

    #[test]
    fn unmeasured_suites_and_policies_are_reported() {
        let measurements = [measured("other", "software", "object", 5, 6.0)];
        let forecast = forecast_without_cores(
            &[("software", 3)],
            &measurements,
            &[("goal", 30), ("object", 30)],
        );
        assert_eq!((forecast.secs, forecast.is_of_policy), (Some(120.0), false));
        assert_eq!(forecast.unmeasured_suites, ["goal"]);

        let forecast = forecast_without_cores(&[("gl", 3)], &measurements, &[("goal", 30)]);
        assert_eq!((forecast.secs, forecast.workers), (None, 1));
        assert_eq!(
            forecast_without_cores(&[], &measurements, &[("goal", 30)]),
            Forecast::default()
        );
    }

    #[test]
    fn additional_slots_do_not_shorten_a_rollout() {
        let measurements = [measured("ours", "software", "goal", 1, 40.0)];
        let forecast = forecast_without_cores(&[("software", 64)], &measurements, &[("goal", 2)]);
        assert_eq!(forecast.secs, Some(40.0));
    }

    #[test]
    fn the_time_of_each_part_determines_the_bottleneck() {
        let measurements = [with_times("goal", true)];
        let workers = [("software", 4)];
        let forecast = forecast_with_cores(Some(4), &workers, &measurements, &[("goal", 100)]);
        assert_eq!(forecast.cores, Some(4));
        let speed = forecast.speed.expect("known");
        assert_eq!((speed.results, speed.spent.queries), (10, 25.0));
        let rate = speed.rate.expect("cores are known");
        assert_eq!(rate.bottleneck, Bottleneck::Slots);
        assert_eq!(forecast.secs, Some(250.0));
        // A rollout occupies a core for five of its ten seconds: the waiting second counts, too.
        assert_eq!((rate.enough_slots, speed.enough_slots_secs), (8, Some(125.0)));
    }

    #[test]
    fn waiting_on_shared_cores_is_not_attributed_to_other_resources() {
        let measurements = [with_times("goal", false)];
        let forecast =
            forecast_with_cores(Some(4), &[("software", 9)], &measurements, &[("goal", 100)]);
        let speed = forecast.speed.expect("known");
        assert_eq!((speed.spent.waiting_secs, speed.spent.taken_secs), (1.0, 0.0));
        let rate = speed.rate.expect("cores are known");
        assert_eq!((rate.bottleneck, rate.enough_slots), (Bottleneck::Cores, 9));
        assert_eq!(forecast.secs, Some(100.0));
    }

    #[test]
    fn suites_are_weighted_by_their_number_of_rollouts() {
        let slow = Measured { physics_secs: 9.0, ..with_times("long", true) };
        let measurements = [with_times("goal", true), slow];
        let rollouts = [("goal", 30), ("long", 10), ("object", 0)];
        let forecast = forecast_with_cores(Some(1), &[("software", 1)], &measurements, &rollouts);
        let speed = forecast.speed.expect("known");
        assert_eq!((speed.results, speed.spent.physics_secs), (20, 4.5));
        let unplanned = forecast_with_cores(Some(1), &[("software", 1)], &measurements, &[]);
        assert_eq!(unplanned.speed.expect("known").spent.physics_secs, 6.0);
    }

    #[test]
    fn huge_reported_numbers_saturate() {
        let measurements = [with_times("goal", true), with_times("long", true)];
        let workers = [("software", u32::MAX), ("software", u32::MAX)];
        let rollouts = [("goal", u64::MAX), ("long", u64::MAX)];
        let forecast = forecast_with_cores(Some(u32::MAX), &workers, &measurements, &rollouts);
        assert_eq!((forecast.slots, forecast.cores), (u32::MAX, Some(u32::MAX)));
        assert!(forecast.secs.is_some_and(f64::is_finite));
    }

    #[test]
    fn workers_without_a_core_count_are_forecast_by_their_slots() {
        let measurements = [with_times("goal", true)];
        let forecast = forecast_without_cores(&[("software", 4)], &measurements, &[("goal", 100)]);
        let speed = forecast.speed.expect("known");
        assert_eq!((speed.rate, speed.enough_slots_secs), (None, None));
        assert_eq!((forecast.secs, forecast.cores), (Some(250.0), None));
    }
}
