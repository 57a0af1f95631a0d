//! Legend of the table's symbols for readers who do not have the paper at hand. It has a
//! line for each symbol that the table prints.

use crate::bootstrap::Bootstrap;
use crate::inference_table;
use crate::interval::{MIN_TASKS, NoInterval};
use crate::report::{Cell, Report};
use crate::text::push_legend;

/// Writes the legend of the tables of some reports, for a terminal of 80 columns; empty if
/// the tables print no symbol.
pub fn legend(reports: &[&Report]) -> String {
    let cells = || reports.iter().flat_map(|report| &report.cells);
    let has_pairs = cells().any(|cell| cell.simultaneous.is_some());
    let has_loss = cells().any(|cell| {
        let mut axes = cell.alone.values().chain(&cell.latency);
        axes.any(|axis| axis.clean_relative_loss.is_some())
    });
    let mut entries: Vec<(&str, String)> = Vec::new();
    let mut add = |symbol, meaning: &str| entries.push((symbol, meaning.to_owned()));
    if has_loss {
        add("loss", "1 - success / nominal success");
    }
    if has_pairs {
        add("simultaneous", "all of these axes in one rollout");
        add("n complete", "configurations with all outcomes known");
        add(
            "S_indep",
            "product of the axes' success rates, which counts nominal failures once per axis",
        );
        add("S_conj", "share of configurations that succeed under every axis alone");
        add("S_sim", "share that succeeds under simultaneous perturbation");
        add(
            "D",
            "dependence of the axes' failures: above 0 if they coincide in the same configurations",
        );
        add("I", "net effect of simultaneity, S_sim - S_conj; chance alone makes it positive");
        add("b emergent", "every axis alone succeeds, the simultaneous rollout fails");
        add("c compensated", "some axis alone fails, the simultaneous rollout succeeds");
        add("R_e, R_c, R_d", "shares of configurations: emergent, compensated, changed");
        add("emergent share", "share of b in all simultaneous failures");
        add("McNemar p", "exact two-sided test of b against c");
        add(
            "detectable |I|",
            "smallest |I| that a test at 5 % detects with a power of 80 %, given the number of \
             configurations and R_d",
        );
    }
    if has_pairs && reports.iter().any(|report| !report.overstated.is_empty()) {
        add(
            "*",
            "overstated: the campaign ended because this measure was large at its last look; the \
             confidence sequence of the measure remains valid",
        );
    }
    if cells().any(|cell| cell.solvable.is_some()) {
        add("solvable", "only configurations whose nominal rollout succeeds");
    }
    if cells().any(|cell| cell.bounds.is_some()) {
        add("worst and best", "range over every outcome that quarantined rollouts could have had");
    }
    let all: Vec<&Cell> = cells().collect();
    let directions = Report::common_directions(reports.iter().copied());
    for (symbol, meaning) in inference_table::meanings(&all, directions) {
        entries.push((symbol, meaning.to_owned()));
    }
    let measures = cells().flat_map(|cell| cell.paired.iter().chain(&cell.solvable));
    let absent: Vec<_> = measures.map(|measures| measures.no_interval).collect();
    if cells().any(|cell| cell.paired.is_some()) {
        let bootstrap = reports.first().map_or_else(Bootstrap::default, |report| report.bootstrap);
        entries.extend(interval_entries(&bootstrap, absent));
    }
    let mut text = String::new();
    push_legend(&mut text, &entries);
    text
}

/// Returns the legend entries that define intervals and the marks of absent ones.
pub(crate) fn interval_entries(
    bootstrap: &Bootstrap,
    absent: impl IntoIterator<Item = Option<NoInterval>>,
) -> Vec<(&'static str, String)> {
    let absent: Vec<NoInterval> = absent.into_iter().flatten().collect();
    let mut entries = vec![(
        "95 %",
        format!(
            "interval for the value on new tasks, from {} resamplings of whole tasks",
            bootstrap.replicates
        ),
    )];
    if absent.contains(&NoInterval::TooFewTasks) {
        let name = NoInterval::TooFewTasks.name();
        let meaning =
            format!("too few tasks for an interval by resampling, which needs {MIN_TASKS}");
        entries.push((name, meaning));
    }
    if absent.contains(&NoInterval::NoSpread) {
        let meaning = "no interval: resampling the tasks does not change the value, so that it \
                       says nothing about the value's uncertainty";
        entries.push((NoInterval::NoSpread.name(), meaning.to_owned()));
    }
    entries
}
