//! Text of forecasts, for terminal and page alike: duration of a campaign, time of a rollout by
//! phase, and the bottleneck.

use proto::coordinator::speed::Bottleneck;
use proto::coordinator::{ForecastResponse, Speed};
use queue::read::{self, Forecast};
use terminal::{counted, wrapped};

use crate::words::duration_text;

/// Smallest share of waiting in a rollout's time at which the text names what is waited for,
/// percent.
const LARGE_WAITING_PERCENT: f64 = 20.0;

/// Converts a forecast to its gRPC message.
pub fn message(forecast: Forecast) -> ForecastResponse {
    ForecastResponse {
        workers: forecast.workers,
        slots: forecast.slots,
        secs: forecast.secs,
        results: forecast.results,
        is_of_policy: forecast.is_of_policy,
        unmeasured_suites: forecast.unmeasured_suites,
        cores: forecast.cores.unwrap_or_default(),
        speed: forecast.speed.map(speed),
    }
}

fn speed(speed: read::Speed) -> Speed {
    let (spent, rate) = (speed.spent, speed.rate);
    let bottleneck = match rate.map(|rate| rate.bottleneck) {
        None => Bottleneck::Unspecified,
        Some(read::Bottleneck::Slots) => Bottleneck::Slots,
        Some(read::Bottleneck::Cores) => Bottleneck::Cores,
        Some(read::Bottleneck::Policy) => Bottleneck::Policy,
    };
    Speed {
        results: speed.results,
        physics_secs: spent.physics_secs,
        drawing_secs: spent.drawing_secs,
        policy_secs: spent.policy_secs,
        waiting_secs: spent.waiting_secs,
        policy_queries: spent.queries,
        bottleneck: bottleneck.into(),
        enough_slots: rate.map(|rate| rate.enough_slots),
        enough_slots_secs: speed.enough_slots_secs,
    }
}

/// Describes the duration of a policy's campaign, wrapped for a terminal.
pub fn describe(forecast: &ForecastResponse, policy: &str) -> String {
    let workers = counted(forecast.workers.into(), "worker");
    let Some(secs) = forecast.secs else {
        return match forecast.workers {
            0 => "no forecast of its duration: no worker is connected".to_owned(),
            _ => format!(
                "no forecast of its duration: no worker has been measured: on the {workers}\n\
                 connected now no rollout was finished in the last week. A campaign with\n\
                 `--configs 0` and one task of each suite measures them"
            ),
        };
    };
    let mut slots = counted(forecast.slots.into(), "slot");
    if forecast.cores > 0 {
        slots = format!("{slots}, {}", counted(forecast.cores.into(), "core"));
    }
    let mut lines = vec![format!(
        "about {} on the {workers} connected now ({slots}), if they run nothing else",
        duration_text(secs)
    )];
    let measured_policies = match forecast.is_of_policy {
        true => format!("of {policy}"),
        false => format!("of other policies, since {policy} has none"),
    };
    lines.push(format!(
        "measured on {} {measured_policies}",
        counted(forecast.results, "recent rollout")
    ));
    if !forecast.unmeasured_suites.is_empty() {
        lines.push(format!(
            "{}: not measured, assumed to be as fast as the rest",
            forecast.unmeasured_suites.join(", ")
        ));
    }
    if let Some(speed) = &forecast.speed {
        lines.push(phase_shares(speed));
        lines.extend(bottleneck(speed, forecast.slots));
    }
    let first = wrapped("", 2, &lines.remove(0));
    let indented = lines.iter().map(|line| wrapped("  ", 4, line));
    let wrapped_lines: Vec<String> = [first].into_iter().chain(indented).collect();
    wrapped_lines.join("\n")
}

/// Describes the mean time of a rollout and the share of each phase in it.
pub fn phase_shares(speed: &Speed) -> String {
    let spans = [
        ("physics", speed.physics_secs),
        ("drawing", speed.drawing_secs),
        ("policy", speed.policy_secs),
        ("waiting", speed.waiting_secs),
    ];
    let total: f64 = spans.iter().map(|(_, secs)| secs).sum();
    let share = |secs: f64| match total > 0.0 {
        true => 100.0 * secs / total,
        false => 0.0,
    };
    let phases = spans.map(|(phase, secs)| match phase {
        "policy" if speed.policy_queries > 0.0 => format!(
            "policy {:.0} % ({:.0} ms a query)",
            share(secs),
            1_000.0 * secs / speed.policy_queries
        ),
        "waiting" if share(secs) >= LARGE_WAITING_PERCENT => {
            format!("waiting {:.0} % (for cores, a graphics card or a disk)", share(secs))
        }
        phase => format!("{phase} {:.0} %", share(secs)),
    });
    format!(
        "a rollout takes {total:.1} s: {}; mean of {}",
        phases.join(", "),
        counted(speed.results, "rollout")
    )
}

/// Describes the bottleneck of rollouts on `slots` slots and the effect of more slots; `None` if
/// the bottleneck is unknown.
pub fn bottleneck(speed: &Speed, slots: u32) -> Option<String> {
    let enough = speed.enough_slots?;
    let enough_duration = duration_text(speed.enough_slots_secs?);
    let enough_slots_text = counted(enough.into(), "slot");
    let fewer = match enough < slots {
        true => format!("; {enough_slots_text} would suffice"),
        false => String::new(),
    };
    Some(match speed.bottleneck() {
        Bottleneck::Unspecified => return None,
        Bottleneck::Slots => format!(
            "bottleneck: slots, which wait for the policy while cores are idle. More slots help up \
             to {enough}: the campaign then takes about {enough_duration} if the policy answers as \
             fast as now"
        ),
        Bottleneck::Cores => format!(
            "bottleneck: the workers' cores, all of which are busy. More slots on them do not \
             help{fewer}; more cores do"
        ),
        Bottleneck::Policy => format!(
            "bottleneck: the policy's server, which answers no faster. More slots do not \
             help{fewer}; more replicas of the policy do"
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(bottleneck: Bottleneck) -> ForecastResponse {
        ForecastResponse {
            workers: 2,
            slots: 16,
            cores: 16,
            secs: Some(12_000.0),
            results: 200,
            is_of_policy: true,
            unmeasured_suites: vec!["libero_10".to_owned(), "libero_goal".to_owned()],
            speed: Some(Speed {
                results: 180,
                physics_secs: 5.0,
                drawing_secs: 2.5,
                policy_secs: 3.75,
                waiting_secs: 1.25,
                policy_queries: 30.0,
                bottleneck: bottleneck.into(),
                enough_slots: Some(22),
                enough_slots_secs: Some(8_700.0),
            }),
        }
    }

    #[test]
    fn a_forecast_states_its_measurements_and_fits_the_terminal() {
        let text = describe(&measured(Bottleneck::Slots), "pi05");
        assert_eq!(
            text,
            "about 3h20m on the 2 workers connected now (16 slots, 16 cores), if they run\n  \
             nothing else\n  \
             measured on 200 recent rollouts of pi05\n  \
             libero_10, libero_goal: not measured, assumed to be as fast as the rest\n  \
             a rollout takes 12.5 s: physics 40 %, drawing 20 %, policy 30 % (125 ms a\n    \
             query), waiting 10 %; mean of 180 rollouts\n  \
             bottleneck: slots, which wait for the policy while cores are idle. More slots\n    \
             help up to 22: the campaign then takes about 2h25m if the policy answers as\n    \
             fast as now"
        );
        assert!(text.lines().all(|line| line.chars().count() <= 80));
    }

    #[test]
    fn a_bottleneck_other_than_slots_is_named_with_its_remedy() {
        let cores = describe(&measured(Bottleneck::Cores), "pi05").replace("\n    ", " ");
        assert!(cores.ends_with("do not help; more cores do"), "{cores}");
        let mut with_enough_slots = measured(Bottleneck::Policy);
        with_enough_slots.slots = 64;
        let policy = describe(&with_enough_slots, "pi05").replace("\n    ", " ");
        let end = "do not help; 22 slots would suffice; more replicas of the policy do";
        assert!(policy.ends_with(end), "{policy}");
    }

    #[test]
    fn unmeasured_parts_are_left_out_of_the_forecast() {
        let unmeasured = ForecastResponse { workers: 1, slots: 2, ..ForecastResponse::default() };
        let text = describe(&unmeasured, "pi05");
        assert!(text.contains("no worker has been measured"), "{text}");
        assert!(text.contains("`--configs 0`"), "{text}");
        let text = describe(&ForecastResponse::default(), "pi05");
        assert!(text.ends_with("no worker is connected"), "{text}");
        let mut without_cores = measured(Bottleneck::Unspecified);
        let speed = without_cores.speed.as_mut().expect("a speed");
        (speed.enough_slots, speed.enough_slots_secs) = (None, None);
        assert!(!describe(&without_cores, "pi05").contains("bottleneck"));
    }

    #[test]
    fn a_large_share_of_waiting_is_explained() {
        let small = phase_shares(&measured(Bottleneck::Slots).speed.expect("a speed"));
        assert!(small.contains("waiting 10 %; mean"), "{small}");
        let mostly_waiting = Speed { physics_secs: 3.0, waiting_secs: 1.0, ..Speed::default() };
        assert!(
            phase_shares(&mostly_waiting).contains("waiting 25 % (for cores, "),
            "{}",
            phase_shares(&mostly_waiting)
        );
    }

    #[test]
    fn phase_shares_of_rollouts_without_duration_are_0_percent() {
        let text = phase_shares(&Speed::default());
        assert!(text.contains("physics 0 %"), "{text}");
    }
}
