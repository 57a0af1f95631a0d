//! A comparison of two policies as text for a terminal of 80 columns.

use libero_ctrl::Condition;

use crate::bootstrap::Bootstrap;
use crate::comparison::{ComparedCell, Comparison};
use crate::comparison_further::{further_meanings, push_further, push_progress};
use crate::difference::Difference;
use crate::legend::interval_entries;
use crate::text::{ABSENT, p_value, push_columns, push_legend, push_wrapped, separate};

/// Writes the comparison as a table with its legend. Rates are in percent, differences in
/// percentage points. [`Comparison::left_out`] lists the rollouts that it excludes.
pub fn comparison_table(comparison: &Comparison, bootstrap: &Bootstrap) -> String {
    let mut text = String::new();
    push_columns(&mut text, &rows(comparison));
    let cells = comparison.cells.iter();
    let gaps: Vec<String> = cells.clone().filter_map(gap).collect();
    if !gaps.is_empty() {
        separate(&mut text);
        push_wrapped(&mut text, "incomplete: ", &gaps.join("; "));
    }
    let seeds: Vec<String> = cells.clone().filter_map(seeds).collect();
    if !seeds.is_empty() {
        separate(&mut text);
        push_wrapped(&mut text, "A - B of each seed, points: ", &seeds.join("; "));
    }
    let bounds: Vec<String> = cells.filter_map(bounds).collect();
    if !bounds.is_empty() {
        separate(&mut text);
        push_wrapped(&mut text, "worst and best A - B: ", &bounds.join("; "));
    }
    push_further(&mut text, comparison);
    push_progress(&mut text, comparison);
    separate(&mut text);
    push_legend(&mut text, &legend(comparison, bootstrap));
    text
}

fn heads() -> (String, Vec<String>) {
    let heads = ["n", "A %", "B %", "A - B", "95 %", "A only", "B only", "Holm p"];
    (String::new(), heads.map(str::to_owned).to_vec())
}

/// Returns a row per cell, grouped under headings for the level.
fn rows(comparison: &Comparison) -> Vec<(String, Vec<String>)> {
    let mut rows = vec![heads()];
    let mut heading = None;
    for cell in &comparison.cells {
        let label = cell.condition.label();
        let label = match cell.condition {
            // No heading precedes the nominal rollouts, although their level is L0.
            Condition::Clean => label.to_owned(),
            _ => {
                if heading.replace(cell.level) != Some(cell.level) {
                    rows.push((cell.level.to_string(), Vec::new()));
                }
                format!(" {label}")
            }
        };
        let values = cell.difference.as_ref().map_or_else(empty_values, values);
        rows.push((label, values));
    }
    rows
}

/// Returns the columns of a cell without a rollout to compare.
fn empty_values() -> Vec<String> {
    let mut values = vec![ABSENT.to_owned(); heads().1.len()];
    "0".clone_into(&mut values[0]);
    values
}

fn values(difference: &Difference) -> Vec<String> {
    let point = |value: f64| format!("{:+.1}", 100.0 * value);
    let interval = match (difference.difference_ci95, difference.no_interval) {
        (Some([low, high]), _) => format!("[{}, {}]", point(low), point(high)),
        (None, Some(reason)) => reason.to_string(),
        (None, None) => ABSENT.to_owned(),
    };
    vec![
        difference.n.to_string(),
        format!("{:.1}", 100.0 * difference.s_a),
        format!("{:.1}", 100.0 * difference.s_b),
        point(difference.difference),
        interval,
        difference.a_only.to_string(),
        difference.b_only.to_string(),
        p_value(difference.holm_p),
    ]
}

fn gap(cell: &ComparedCell) -> Option<String> {
    let gap = match (cell.missing, cell.quarantined) {
        (0, 0) => return None,
        (missing, 0) => format!("{missing} missing"),
        (0, quarantined) => format!("{quarantined} quarantined"),
        (missing, quarantined) => format!("{missing} missing, {quarantined} quarantined"),
    };
    Some(format!("{} {gap}", cell.name()))
}

/// Lists A − B of each replicate, whose rollouts both policies ran with seeds of the same number.
fn seeds(cell: &ComparedCell) -> Option<String> {
    let each = cell.by_replicate.values().map(|value| format!("{:+.1}", 100.0 * value));
    let each: Vec<String> = each.collect();
    (!each.is_empty()).then(|| format!("{} {}", cell.name(), each.join(", ")))
}

fn bounds(cell: &ComparedCell) -> Option<String> {
    let [low, high] = cell.bounds.as_ref()?.difference.map(|value| 100.0 * value);
    Some(format!("{} {low:+.1} to {high:+.1}", cell.name()))
}

fn legend(comparison: &Comparison, bootstrap: &Bootstrap) -> Vec<(&'static str, String)> {
    let mut entries = Vec::new();
    let mut add = |symbol, meaning: &str| entries.push((symbol, meaning.to_owned()));
    add(
        "n",
        "rollouts with an outcome for both policies; all rates and differences are over these \
         rollouts",
    );
    add("A %, B %", "success rates over these rollouts");
    add("A - B", "difference of the success rates, in points: above 0, A succeeds more often");
    add("A only, B only", "rollouts that only A solves, and that only B solves");
    add(
        "Holm p",
        "exact two-sided sign-flip test of A - B over tasks, corrected for the rows of the table",
    );
    entries.extend(further_meanings(comparison));
    let mut add = |symbol, meaning: &str| entries.push((symbol, meaning.to_owned()));
    if comparison.cells.iter().any(|cell| cell.bounds.is_some()) {
        add("worst and best", "range over every outcome that quarantined rollouts could have had");
    }
    let differences = comparison.cells.iter();
    let differences = differences.filter_map(|cell| cell.difference.as_ref());
    let absent: Vec<_> = differences.map(|difference| difference.no_interval).collect();
    if !absent.is_empty() {
        entries.extend(interval_entries(bootstrap, absent));
    }
    entries
}
