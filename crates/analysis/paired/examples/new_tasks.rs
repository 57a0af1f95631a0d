//! Error rates and savings of stop rules about new tasks, over simulated campaigns of 40
//! tasks with ten configurations each.
//!
//! `cargo run --release -p paired --example new_tasks [CAMPAIGNS [SEED]]`
//!
//! New tasks are drawn for every campaign. The columns are `ends`, the share of campaigns that end
//! early; `wrong`, the share of campaigns that end early and wrongly; and `saved`, the mean share
//! of configurations that do not run because of an early end. An early end is wrong if the mean of
//! I over all tasks is 0 or has the sign opposite to the interval's. `I excludes 0` is a rule about
//! the campaign's own configurations: its early ends are not savings for new tasks, but show that
//! this rule says nothing about new tasks. The last two columns are for the t interval for new
//! tasks, computed once after the whole campaign: there, `ends` are the intervals that exclude 0.

use libero_ctrl::{Level, Measure, Stop, Strata};
use paired::{Bootstrap, CampaignLook, Cell, Options, Records, report};

// Tests use the functions of the module that this example does not.
#[allow(dead_code)]
#[path = "../tests/simulated/mod.rs"]
mod simulated;

use simulated::{Chance, NetEffect};

/// Default number of campaigns of each kind.
const CAMPAIGNS: u64 = 1000;
/// Kinds of campaigns: a label, which names the mean effect of simultaneity in points, and the
/// effects of the tasks.
const KINDS: [(&str, NetEffect); 6] = [
    ("none, tasks alike", effect(0.0, 0.0, 0.0)),
    ("none, half differ by 20", effect(0.0, 0.5, 0.2)),
    ("none, one in 20 by 90", effect(0.0, 0.05, 0.9)),
    ("-10", effect(-0.1, 0.5, 0.1)),
    ("-15", effect(-0.15, 0.5, 0.1)),
    ("-20", effect(-0.2, 0.5, 0.1)),
];

const fn effect(mean: f64, share: f64, spread: f64) -> NetEffect {
    NetEffect { mean, share, spread }
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
                "usage: new_tasks [CAMPAIGNS [SEED]], whole numbers, with at least 1 campaign"
            );
            std::process::exit(2);
        }
    };
    let rules =
        [("I excludes 0 for new tasks", Strata::WholeTasks), ("I excludes 0", Strata::Suites)];
    // The bootstrap intervals are not used, so that two resamplings suffice.
    let options = Options {
        bootstrap: Bootstrap { replicates: 2, ..Bootstrap::default() },
        ..Options::default()
    };
    println!("{campaigns} campaigns of each kind, seed {seed}; percent");
    println!(
        "\n                               for new tasks        I excludes 0     t, at the end"
    );
    println!("I of new tasks, points       ends  wrong  saved     ends  wrong       ends  wrong");
    for (name, kind) in KINDS {
        let mut chance = Chance::new(seed);
        let mut ended = [0.0; 3];
        let mut wrong = [0.0; 3];
        let mut saved = 0.0;
        for campaign in 0..campaigns {
            let all = kind.campaign(&mut chance);
            let records = Records::new(&all).expect("each rollout once");
            let mut count_end = |column: usize, is_positive: bool| {
                ended[column] += 1.0;
                let is_right = kind.mean != 0.0 && is_positive == (kind.mean > 0.0);
                wrong[column] += f64::from(u8::from(!is_right));
            };
            for (column, (rule, strata)) in rules.into_iter().enumerate() {
                let stop = Stop { rule: rule.parse().expect("a rule"), seed: campaign, strata };
                if let Some(look) = CampaignLook::when_met(&records, &stop) {
                    let interval = look.levels[&Level::L2].intervals[&Measure::I];
                    count_end(column, interval.low() > 0.0);
                    if column == 0 {
                        saved += 1.0 - look.used.len() as f64 / look.units as f64;
                    }
                }
            }
            let report = report(&all, &options).expect("each rollout once");
            let is_l2 = |cell: &&Cell| cell.level == Level::L2;
            let cell = report.cells.iter().find(is_l2).expect("L2");
            let inference = cell.inference.as_ref().expect("complete");
            if let Some([low, high]) = inference.paired.i.new_tasks
                && (low > 0.0 || high < 0.0)
            {
                count_end(2, low > 0.0);
            }
        }
        let percent = |count: f64| 100.0 * count / campaigns as f64;
        println!(
            "{name:<26}{:>7.1}{:>7.1}{:>7.1}{:>9.1}{:>7.1}{:>11.1}{:>7.1}",
            percent(ended[0]),
            percent(wrong[0]),
            percent(saved),
            percent(ended[1]),
            percent(wrong[1]),
            percent(ended[2]),
            percent(wrong[2]),
        );
    }
}
