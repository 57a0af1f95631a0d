//! Coverage of intervals for 5, 10, 20 and 40 tasks of ten configurations.
//!
//! `cargo run --release -p paired --example coverage [CAMPAIGNS [SEED]]`
//!
//! Every campaign draws new tasks and new directions from a known population, and new
//! outcomes. Each interval is compared with the true value of its own target: the drawn
//! tasks and directions, all tasks under the drawn directions, or all tasks and directions.
//! The first table is about the report of one policy, the second about the comparison of two.
//! *All rows together* is the share of campaigns in which every simultaneous interval holds.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::Level;
use paired::{Cell, Comparison, Estimate, Interval, Options, report};

// Tests use the functions of the module that this example does not.
#[allow(dead_code)]
#[path = "../tests/it/simulated/mod.rs"]
mod simulated;

use simulated::two::{MEASURES, Truth, TwoPolicies, row};
use simulated::{CONFIGURATIONS, Chance, Population, estimates};

/// Default number of campaigns of each size.
const CAMPAIGNS: u64 = 1000;
/// Numbers of tasks and of the suites that they are drawn from.
const SIZES: [(usize, usize); 4] = [(5, 1), (10, 1), (20, 2), (40, 4)];
/// Names of the targets of inference in the table: the drawn tasks and directions, new tasks, and
/// new tasks and directions.
const TARGETS: [&str; 3] = ["these", "new tasks", "new both"];

/// Number of computed intervals, and number of those that contain the true value.
#[derive(Clone, Copy, Default)]
struct Coverage {
    computed: u64,
    covering: u64,
}

impl Coverage {
    fn add(&mut self, interval: Option<Interval>, truth: f64) {
        if let Some([low, high]) = interval {
            self.computed += 1;
            self.covering += u64::from((low..=high).contains(&truth));
        }
    }
}

/// Coverage by figure and target.
#[derive(Default)]
struct Table(BTreeMap<(String, usize), Coverage>);

impl Table {
    fn add(&mut self, name: &str, target: usize, interval: Option<Interval>, truth: f64) {
        let coverage = self.0.entry((name.to_owned(), target)).or_default();
        coverage.add(interval, truth);
    }

    fn add_each(&mut self, name: &str, estimate: &Estimate, truths: [f64; 3]) {
        let intervals =
            [estimate.these_tasks, estimate.new_tasks, estimate.new_tasks_and_directions];
        for (target, (interval, truth)) in intervals.into_iter().zip(truths).enumerate() {
            self.add(name, target, interval, truth);
        }
    }

    fn add_comparison(&mut self, comparison: &Comparison, truths: [&Truth; 3]) {
        let mut row_holds = Vec::new();
        for cell in &comparison.cells {
            let (row, label) = (row(cell.condition), cell.condition.name());
            let name = |measure: &str| format!("{measure}, {label}");
            let truths_of = |measure: usize| truths.map(|truth| truth[measure][row]);
            let difference = cell.difference.as_ref().expect("outcomes");
            let progress = cell.progress.as_ref().expect("progress");
            let estimates = [
                difference.estimate,
                progress.goal.expect("goals").difference,
                progress.steps.expect("steps").difference,
                difference.profile.improvement,
            ];
            for (measure, estimate) in estimates.iter().enumerate() {
                self.add_each(&name(MEASURES[measure]), estimate, truths_of(measure));
            }
            // Target 1 is new tasks, measure 0 the success rate.
            let truth = truths[1][0][row];
            let percentiles = difference.difference_ci95;
            self.add(&name("A - B, percentiles"), 1, percentiles, truth);
            if let Some([low, high]) = difference.simultaneous_ci95 {
                row_holds.push((low..=high).contains(&truth));
            }
        }
        let row = self.0.entry(("all rows together".to_owned(), 1));
        let row = row.or_default();
        row.computed += u64::from(!row_holds.is_empty());
        row.covering += u64::from(!row_holds.is_empty() && row_holds.iter().all(|holds| *holds));
    }
}

fn simulate(tasks: usize, suites: usize, campaigns: u64, seed: u64) -> Table {
    let population = Population::standard();
    let mut chance = Chance::new(seed + tasks as u64);
    let all_tasks_truth = population.truth_of_all_tasks(suites, None);
    let mut coverage = Table::default();
    for _ in 0..campaigns {
        let drawn = population.tasks(tasks, &mut chance);
        let directions = population.directions(CONFIGURATIONS, &mut chance);
        let records = population.campaign(&drawn, suites, &directions, &mut chance);
        let report = report(&records, &Options::default()).expect("each rollout once");
        let is_l2 = |cell: &&Cell| cell.level == Level::L2;
        let cell = report.cells.iter().find(is_l2).expect("L2");
        let truths = [
            population.truth(&drawn, suites, &directions),
            population.truth_of_all_tasks(suites, Some(&directions)),
        ];
        for (name, estimate) in estimates(cell) {
            let truths = [truths[0][name], truths[1][name], all_tasks_truth[name]];
            coverage.add_each(name, &estimate, truths);
        }
        let measures = cell.paired.as_ref().expect("complete");
        for (name, measure, interval) in [
            ("I, percentiles", "I", measures.i_ci95),
            ("R_d, percentiles", "R_d", measures.r_d_ci95),
        ] {
            coverage.add(name, 1, interval, truths[1][measure]);
        }
    }
    coverage
}

fn simulate_two(tasks: usize, suites: usize, campaigns: u64, seed: u64) -> Table {
    let policies = TwoPolicies::standard();
    let mut chance = Chance::new(seed + tasks as u64);
    let all_tasks_truth = policies.truth_of_all_tasks(suites, None);
    let mut coverage = Table::default();
    for _ in 0..campaigns {
        let drawn = policies.tasks(tasks, &mut chance);
        let directions = policies.directions(&mut chance);
        let comparison = policies.compare(&drawn, suites, &directions, &mut chance);
        let drawn_truth = policies.truth(&drawn, suites, &directions);
        let new_tasks = policies.truth_of_all_tasks(suites, Some(&directions));
        coverage.add_comparison(&comparison, [&drawn_truth, &new_tasks, &all_tasks_truth]);
    }
    coverage
}

fn print(title: &str, sizes: &[Table]) {
    print!("\n{title:<34}{:<11}", "tasks");
    SIZES.iter().for_each(|(tasks, _)| print!("{tasks:>8}"));
    println!();
    let keys = sizes.iter().flat_map(|table| table.0.keys());
    for key in keys.collect::<BTreeSet<_>>() {
        let by_size = sizes.iter().map(|table| table.0.get(key));
        let by_size: Vec<Coverage> =
            by_size.map(|coverage| coverage.copied().unwrap_or_default()).collect();
        // Skips the targets for which a figure never has an interval.
        if by_size.iter().all(|coverage| coverage.computed == 0) {
            continue;
        }
        print!("{:<34}{:<11}", key.0, TARGETS[key.1]);
        for Coverage { computed, covering } in by_size {
            match computed {
                0 => print!("{:>8}", "-"),
                _ => print!("{:>8.1}", 100.0 * covering as f64 / computed as f64),
            }
        }
        println!();
    }
}

fn main() {
    let arguments: Result<Vec<u64>, _> =
        std::env::args().skip(1).map(|argument| argument.parse()).collect();
    let (campaigns, seed) = match arguments.as_deref() {
        Ok([]) => (CAMPAIGNS, 0),
        Ok([campaigns]) if *campaigns > 0 => (*campaigns, 0),
        Ok([campaigns, seed]) if *campaigns > 0 => (*campaigns, *seed),
        _ => {
            eprintln!(
                "usage: coverage [CAMPAIGNS [SEED]], whole numbers, with at least 1 campaign"
            );
            std::process::exit(2);
        }
    };
    println!("coverage of 95 % intervals, %, {campaigns} campaigns of each size, seed {seed}");
    print("one policy", &SIZES.map(|(tasks, suites)| simulate(tasks, suites, campaigns, seed)));
    print(
        "two policies",
        &SIZES.map(|(tasks, suites)| simulate_two(tasks, suites, campaigns, seed)),
    );
}
