//! Coverage of intervals for 5, 10, 20 and 40 tasks of ten configurations.
//!
//! `cargo run --release -p paired --example coverage [CAMPAIGNS [SEED]]`
//!
//! Every campaign draws new tasks and new directions from a known population, and new
//! outcomes. Each interval is compared with the true value of its own target: the drawn
//! tasks and directions, all tasks under the drawn directions, or all tasks and directions.

use std::collections::BTreeMap;

use libero_ctrl::Level;
use paired::{Cell, Estimate, Interval, Options, report};

// The tests use the other functions of this module.
#[allow(dead_code)]
#[path = "../tests/simulated/mod.rs"]
mod simulated;

use simulated::{CONFIGURATIONS, Chance, Population, estimates};

/// Default number of campaigns of each size.
const CAMPAIGNS: u64 = 1000;
/// Numbers of tasks and of the suites that they are drawn from.
const SIZES: [(usize, usize); 4] = [(5, 1), (10, 1), (20, 2), (40, 4)];
const TARGETS: [&str; 3] = ["these", "new tasks", "new both"];

/// Counts of the intervals computed and of those that contain the true value.
#[derive(Clone, Copy, Default)]
struct Coverage {
    made: u64,
    held: u64,
}

impl Coverage {
    fn add(&mut self, interval: Option<Interval>, truth: f64) {
        if let Some([low, high]) = interval {
            self.made += 1;
            self.held += u64::from((low..=high).contains(&truth));
        }
    }
}

type Key = (&'static str, usize);

fn simulate(tasks: usize, suites: usize, campaigns: u64, seed: u64) -> BTreeMap<Key, Coverage> {
    let population = Population::usual();
    let mut chance = Chance::new(seed + tasks as u64);
    let everywhere = population.truth_of_all_tasks(suites, None);
    let mut coverage: BTreeMap<Key, Coverage> = BTreeMap::new();
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
            let Estimate {
                these_tasks,
                new_tasks,
                new_tasks_and_directions,
                ..
            } = estimate;
            let intervals = [these_tasks, new_tasks, new_tasks_and_directions];
            let truths = [truths[0][name], truths[1][name], everywhere[name]];
            for (target, (interval, truth)) in intervals.into_iter().zip(truths).enumerate() {
                coverage
                    .entry((name, target))
                    .or_default()
                    .add(interval, truth);
            }
        }
        let measures = cell.paired.as_ref().expect("complete");
        for (name, of, interval) in [
            ("I, percentiles", "I", measures.i_ci95),
            ("R_d, percentiles", "R_d", measures.r_d_ci95),
        ] {
            let one = coverage.entry((name, 1)).or_default();
            one.add(interval, truths[1][of]);
        }
    }
    coverage
}

fn main() {
    let given: Result<Vec<u64>, _> = std::env::args().skip(1).map(|it| it.parse()).collect();
    let (campaigns, seed) = match given.as_deref() {
        Ok([]) => (CAMPAIGNS, 0),
        Ok([campaigns]) if *campaigns > 0 => (*campaigns, 0),
        Ok([campaigns, seed]) if *campaigns > 0 => (*campaigns, *seed),
        _ => {
            eprintln!("read the number of campaigns and a seed: whole numbers, the first above 0");
            std::process::exit(2);
        }
    };
    let sizes = SIZES.map(|(tasks, suites)| simulate(tasks, suites, campaigns, seed));
    println!("coverage of 95 % intervals, %, {campaigns} campaigns of each size, seed {seed}");
    print!("\n{:<24}{:<11}", "", "tasks");
    SIZES.iter().for_each(|(tasks, _)| print!("{tasks:>8}"));
    println!();
    for (name, target) in sizes[3].keys() {
        print!("{name:<24}{:<11}", TARGETS[*target]);
        for of_size in &sizes {
            match of_size.get(&(*name, *target)) {
                Some(Coverage { made, held }) if *made > 0 => {
                    print!("{:>8.1}", 100.0 * *held as f64 / *made as f64);
                }
                _ => print!("{:>8}", "-"),
            }
        }
        println!();
    }
}
