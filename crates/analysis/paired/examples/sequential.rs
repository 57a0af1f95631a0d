//! Savings and coverage of confidence sequences: OpenVLA-OFT's published outcomes
//! replayed in random orders.
//!
//! `cargo run --release -p paired --example sequential [ORDERS]`
//!
//! The second table has a row per rule and level. Its columns: `early`, the share of orders in
//! rounds of tasks that stop early; `mean` and `med`, the mean and the median share of rollouts
//! saved, for each design of orders; `n` and `saved`, the size and the saving of a fixed sample.

use libero_ctrl::{Clause, Level, Measure, StopRule};
use paired::quantile;

#[path = "../tests/replay/mod.rs"]
mod replay;

use replay::{Design, Population};

/// Default number of orders per level.
const ORDERS: u64 = 2000;
/// Designs of orders, each with a divisor of the number of orders. Designs with rounds of four
/// configurations or of a single one update the intervals more often, so that an order takes
/// longer; fewer orders are replayed.
const DESIGNS: [(&str, Design, u64); 3] = [
    ("rounds of tasks", Design::Tasks, 1),
    ("rounds of suites", Design::Suites, 10),
    ("simple order", Design::Simple, 10),
];

const RULES: [&str; 7] = [
    "width(I) < 0.08",
    "width(I) < 0.12",
    "width(I) < 0.2",
    "I excludes 0",
    "width(S_sim) < 0.1",
    "width(R_e) < 0.1",
    "width(R_d) < 0.1",
];

const NOTES: &str = "
fixed n: one measure, one look, 95 % normal interval with the finite-population
correction, planned with the true variance and mean.
Published savings of sequential tests of two policies: 32-70 % (STEP, Snyder et
al. 2025, arXiv 2503.10966; N-SCORE, Beyond binary success, 2026).";

/// Normal quantile of a two-sided 95 % interval: Φ⁻¹(0.975).
const Z: f64 = 1.959963984540054;

/// Returns the smallest number of configurations at which a fixed-sample interval meets a
/// rule: the normal interval of simple random sampling without replacement,
/// ± z·√(S²/n·(1 − n/N)), with the true S² of the population and, for `excludes`, its true mean.
/// Source: W. G. Cochran, Sampling Techniques (3rd ed., 1977), section 2.8.
fn fixed_n(population: &Population, rule: &StopRule) -> usize {
    let units = population.units.len();
    let half_width = |n: usize, measure| {
        let correction = 1.0 - n as f64 / units as f64;
        Z * (variance(population, measure) / n as f64 * correction).sqrt()
    };
    let mean = |measure| population.total(measure) as f64 / units as f64;
    let holds = |clause: &Clause, n| match *clause {
        Clause::Width(measure, width) => 2.0 * half_width(n, measure) < width,
        Clause::Excludes(measure, value) => half_width(n, measure) < (mean(measure) - value).abs(),
    };
    let meets_rule = |n: &usize| rule.clauses().iter().all(|clause| holds(clause, *n));
    (1..=units).find(meets_rule).unwrap_or(units)
}

/// Returns the variance of a measure over single configurations, with the divisor N − 1.
fn variance(population: &Population, measure: Measure) -> f64 {
    let n = population.units.len() as f64;
    let mean = population.total(measure) as f64 / n;
    let squares = population.values(measure).map(|x| (x as f64 - mean).powi(2));
    squares.sum::<f64>() / (n - 1.0)
}

/// Result of replaying one level.
struct Replayed {
    orders: u64,
    /// Orders in which all intervals hold at all looks.
    held: u64,
    /// Share of configurations that each order saves, ascending, by rule.
    saved: Vec<Vec<f64>>,
}

fn replay_level(
    population: &Population,
    rules: &[StopRule],
    orders: u64,
    design: Design,
) -> Replayed {
    let units = population.units.len();
    let mut replayed = Replayed { orders, held: 0, saved: vec![Vec::new(); rules.len()] };
    for seed in 0..orders {
        let (held, met) = population.replay(&population.order(seed, design), rules);
        replayed.held += u64::from(held);
        for (saved, met) in replayed.saved.iter_mut().zip(met) {
            saved.push(1.0 - met.unwrap_or(units) as f64 / units as f64);
        }
    }
    for saved in &mut replayed.saved {
        saved.sort_unstable_by(f64::total_cmp);
    }
    replayed
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

fn main() {
    let orders = match std::env::args().nth(1).map(|argument| argument.parse()) {
        None => ORDERS,
        Some(Ok(orders)) if orders > 0 => orders,
        Some(_) => {
            eprintln!("usage: sequential [ORDERS], a whole number above 0");
            std::process::exit(2);
        }
    };
    let rules: Vec<StopRule> = RULES.map(|text| text.parse().expect("a rule")).to_vec();
    let populations = Level::PERTURBED.map(Population::published);
    let replayed = DESIGNS.map(|(_, design, divisor)| {
        let orders = orders.div_ceil(divisor);
        populations.each_ref().map(|population| replay_level(population, &rules, orders, design))
    });
    print_coverage(&replayed);
    print_saved(&populations, &rules, &replayed);
    println!("{NOTES}");
}

fn print_coverage(replayed: &[[Replayed; 3]; 3]) {
    let measures = Measure::ALL.map(Measure::name).join(", ");
    println!("OpenVLA-OFT's 400 configurations per level, in random orders");
    println!("\n{measures}: all intervals hold at all looks");
    println!("{:<16}{:>20}{:>20}{:>20}", "", "L1", "L2", "L3");
    for ((name, ..), levels) in DESIGNS.iter().zip(replayed) {
        let coverage = levels.each_ref().map(|level| {
            let Replayed { orders, held, .. } = *level;
            let share = percent(held as f64 / orders as f64);
            format!("{held}/{orders} {share:>6} %")
        });
        let [l1, l2, l3] = coverage;
        println!("{name:<16}{l1:>20}{l2:>20}{l3:>20}");
    }
}

fn print_saved(populations: &[Population; 3], rules: &[StopRule], replayed: &[[Replayed; 3]; 3]) {
    println!("\nrollouts saved by early stops, % (mean and median), and orders that stop early, %");
    println!("                        by task             by suite    simple      fixed n");
    println!("                         early  mean   med   mean   med   mean   med    n saved");
    for (i, rule) in rules.iter().enumerate() {
        for (level, population) in populations.iter().enumerate() {
            let [task, suite, simple] = replayed.each_ref().map(|levels| &levels[level].saved[i]);
            let early = task.iter().filter(|&&saved| saved > 0.0).count();
            let n = fixed_n(population, rule);
            println!(
                "{:<20}{:<3}{:>7}{:>6}{:>6}{:>7}{:>6}{:>7}{:>6}{n:>6}{:>6}",
                if level == 0 { RULES[i] } else { "" },
                Level::PERTURBED[level].to_string(),
                percent(early as f64 / task.len() as f64),
                percent(mean(task)),
                percent(quantile(task, 0.5)),
                percent(mean(suite)),
                percent(quantile(suite, 0.5)),
                percent(mean(simple)),
                percent(quantile(simple, 0.5)),
                percent(1.0 - n as f64 / population.units.len() as f64),
            );
        }
    }
}
