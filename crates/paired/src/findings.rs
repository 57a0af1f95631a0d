//! Findings of a report as sentences. Every sentence follows from figures of the report;
//! docs/dev/STATISTICS.md lists the condition under which each sentence is written.

use std::collections::BTreeMap;

use benchmark::{Condition, Level};
use serde::{Deserialize, Serialize};

use crate::inference::estimate::Estimate;
use crate::inference::floor::chance_bounds;
use crate::inference::hypotheses::{EQUIVALENCE_MARGIN, holm};
use crate::inference::loss::Loss;
use crate::replication::Flips;
use crate::report::{Cell, Report};
use crate::text::{listed, percent, points};

/// Significance level of sentences that claim an effect, for p-values after Holm's correction:
/// costs are corrected over the conditions of a level, claims about simultaneity and directions
/// together over all levels. It is stricter than the 5 % of the intervals because readers act on
/// sentences. Other levels: `EQUIVALENCE_ALPHA`, `estimate::ALPHA` and the quantiles of `bootstrap`
/// (intervals), `design::Z_TEST` (planning), `SEQUENTIAL_ALPHA` (early stops), `non_inferiority::ALPHA`
/// (the gate), `Repeats::error` (explanations).
pub const FINDING_ALPHA: f64 = 0.01;

/// Significance level of claims of equivalence, whose p-values are not corrected.
const EQUIVALENCE_ALPHA: f64 = 0.05;

/// Returns the findings: for each level costs, simultaneity and, if success depends on the
/// direction, directions.
pub fn findings(report: &Report) -> Vec<Finding> {
    let cells: Vec<&Cell> = report.cells.iter().collect();
    let corrected = CorrectedPValues::new(&cells);
    let mut findings = Vec::new();
    for cell in cells.iter().filter(|cell| cell.level != Level::L0) {
        findings.extend(cost(cell));
        findings.extend(simultaneity(cell, report, &corrected));
        findings.extend(directions(cell, &corrected));
    }
    findings
}

/// A tested effect of simultaneous perturbation at a level. Its p-value is two-sided; the effect is
/// claimed if the p-value is small and the estimate has the effect's sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Hypothesis {
    /// R_e is above the noise floor.
    Emergent,
    /// R_c is above the noise floor.
    Compensated,
    /// I is below 0; tested if no noise floor is known.
    BelowZero,
    /// Simultaneous success depends on the direction of the perturbations.
    Directions,
}

/// Corrected p-values of all tested hypotheses.
struct CorrectedPValues(BTreeMap<(Level, Hypothesis), f64>);

impl CorrectedPValues {
    fn new(cells: &[&Cell]) -> Self {
        let mut tested: BTreeMap<(Level, Hypothesis), f64> = BTreeMap::new();
        for cell in cells.iter().filter(|cell| cell.level != Level::L0) {
            let Some(inference) = &cell.inference else {
                continue;
            };
            let mut test = |hypothesis, p| tested.insert((cell.level, hypothesis), p);
            match &inference.excess {
                Some(excess) => {
                    // Without a standard error, no effect is claimed.
                    let p = |estimate: &Estimate| estimate.p().unwrap_or(1.0);
                    test(Hypothesis::Emergent, p(&excess.excess.r_e));
                    test(Hypothesis::Compensated, p(&excess.excess.r_c));
                }
                None => {
                    test(Hypothesis::BelowZero, inference.i_sign_flip_p);
                }
            }
            if let Some(directions) = &inference.directions {
                test(Hypothesis::Directions, directions.p);
            }
        }
        let p_values: Vec<f64> = tested.values().copied().collect();
        for (p, corrected) in tested.values_mut().zip(holm(&p_values)) {
            *p = corrected;
        }
        Self(tested)
    }

    fn p(&self, cell: &Cell, hypothesis: Hypothesis) -> f64 {
        let p = self.0.get(&(cell.level, hypothesis));
        p.copied().unwrap_or(1.0)
    }
}

/// Writes the finding about losses under single axes: the greatest if it is claimed, otherwise those
/// that are, or that none is. It ends with the axes that are equivalent to nominal success.
fn cost(cell: &Cell) -> Option<Finding> {
    let losses = cell.inference.as_ref().map(|inference| &inference.losses)?;
    let singles = losses.iter().filter_map(|(condition, loss)| match condition {
        Condition::Single(axis) => Some((axis.name(), loss)),
        _ => None,
    });
    let singles: Vec<(&str, &Loss)> = singles.collect();
    let by_loss =
        |a: &&(&str, &Loss), b: &&(&str, &Loss)| a.1.loss.value.total_cmp(&b.1.loss.value);
    let (most, loss) = *singles.iter().max_by(by_loss)?;
    // Without nominal success nothing can be lost, and losses on too few tasks for an interval do
    // not show that nothing is lost.
    let is_costly = |loss: &Loss| loss.holm_p < FINDING_ALPHA && loss.loss.value > 0.0;
    let has_interval = loss.nominal.new_tasks.or(loss.success.new_tasks).is_some();
    if loss.nominal.value == 0.0 || !has_interval && !is_costly(loss) {
        return None;
    }
    let level = cell.level;
    let is_equivalent = |loss: &Loss| loss.equivalence_p.is_some_and(|p| p < EQUIVALENCE_ALPHA);
    let names = |predicate: &dyn Fn(&Loss) -> bool| -> Vec<String> {
        let named = singles.iter().filter(|(_, loss)| predicate(loss));
        named.map(|(name, _)| (*name).to_owned()).collect()
    };
    let equivalent = names(&|loss| !is_costly(loss) && is_equivalent(loss));
    let costly = names(&is_costly);
    let claimed = singles.iter().map(|(_, loss)| *loss).filter(|loss| is_costly(loss));
    let p = match is_costly(loss) {
        true => loss.holm_p,
        false => claimed.map(|loss| loss.holm_p).reduce(f64::min).unwrap_or(loss.holm_p),
    };
    let mut sentence = match (is_costly(loss), costly.is_empty()) {
        (true, _) => format!(
            "Of the single axes at {level}, {most} costs the most: {} points{} of success, against \
             nominal rollouts of the same initial states",
            percent(Some(loss.loss.value)),
            interval_of_new_tasks(&loss.loss)
        ),
        (false, false) => format!(
            "Success is shown to be lost at {level} under {} alone, but not under {most}, where the \
             loss is greatest: {} points{}",
            listed(&costly),
            percent(Some(loss.loss.value)),
            interval_of_new_tasks(&loss.loss)
        ),
        (false, true) if loss.loss.value <= 0.0 => {
            format!("No single axis is shown to cost success at {level}")
        }
        (false, true) => format!(
            "No single axis is shown to cost success at {level}; the greatest loss is {} points{}, \
             under {most}",
            percent(Some(loss.loss.value)),
            interval_of_new_tasks(&loss.loss)
        ),
    };
    if !equivalent.is_empty() {
        let verb = if equivalent.len() == 1 { "is" } else { "are" };
        let margin = 100.0 * EQUIVALENCE_MARGIN;
        let equivalent = listed(&equivalent);
        sentence.push_str(&format!("; {equivalent} {verb} within {margin} points of nominal"));
    }
    sentence.push('.');
    Some(Finding {
        kind: FindingKind::Cost,
        level,
        claims: !costly.is_empty(),
        holm_p: Some(p),
        sentence,
    })
}

fn simultaneity(cell: &Cell, report: &Report, corrected: &CorrectedPValues) -> Option<Finding> {
    let inference = cell.inference.as_ref()?;
    let level = cell.level;
    // A policy that never succeeds has no outcome that simultaneity could change.
    if inference.paired.s_conj.value == 0.0 && inference.paired.s_sim.value == 0.0 {
        return None;
    }
    let Some(excess) = &inference.excess else {
        return without_floor(cell, report, corrected);
    };
    let measured = [
        (
            Hypothesis::Emergent,
            "failures emerge",
            "fail only simultaneously",
            inference.paired.r_e,
            excess.excess.r_e,
        ),
        (
            Hypothesis::Compensated,
            "failures are compensated",
            "succeed simultaneously although an axis alone makes them fail",
            inference.paired.r_c,
            excess.excess.r_c,
        ),
    ];
    let is_shown = |hypothesis, excess: &Estimate| {
        corrected.p(cell, hypothesis) < FINDING_ALPHA && excess.value > 0.0
    };
    let shown = measured.iter().filter(|(hypothesis, .., excess)| is_shown(*hypothesis, excess));
    let parts: Vec<String> = shown
        .map(|(_, effect, outcomes, measure, excess)| {
            format!(
                "{effect} beyond chance: {} % of configurations {outcomes}, {} points{} above the \
                 noise floor",
                percent(Some(measure.value)),
                percent(Some(excess.value)),
                interval_of_new_tasks(excess)
            )
        })
        .collect();
    let sentence = match parts.as_slice() {
        [] => format!(
            "At {level}, simultaneity is not shown to change more outcomes than chance does: \
             emergent failures are {} points{}, compensated successes {} points{} from the \
             noise floor.",
            points(excess.excess.r_e.value),
            interval_of_new_tasks(&excess.excess.r_e),
            points(excess.excess.r_c.value),
            interval_of_new_tasks(&excess.excess.r_c),
        ),
        parts => format!("At {level}, {}.", parts.join("; ")),
    };
    let p = measured.map(|(hypothesis, ..)| corrected.p(cell, hypothesis));
    Some(Finding {
        kind: FindingKind::Simultaneity,
        level,
        claims: !parts.is_empty(),
        holm_p: Some(p[0].min(p[1])),
        sentence,
    })
}

/// Writes the finding about simultaneity if no noise floor is known.
fn without_floor(cell: &Cell, report: &Report, corrected: &CorrectedPValues) -> Option<Finding> {
    let inference = cell.inference.as_ref()?;
    let (level, i) = (cell.level, &inference.paired.i);
    let p = corrected.p(cell, Hypothesis::BelowZero);
    let claims = p < FINDING_ALPHA && i.value < 0.0;
    let sentence = match claims {
        true => format!(
            "At {level}, failures emerge: more configurations fail only simultaneously than \
             succeed only simultaneously, by {} points{}. By chance alone, without an effect of \
             any axis, this difference has the opposite sign.",
            percent(Some(-i.value)),
            interval_of_new_tasks(&i.negated())
        ),
        false if inference.paired.r_d.value == 0.0 => {
            format!("At {level}, every simultaneous outcome is the one that the single axes imply.")
        }
        false => {
            let r_d = percent(Some(inference.paired.r_d.value));
            let n = cell.paired.as_ref()?.n;
            // A share of 0 among a few rollouts gives no upper bound of chance.
            let flips = flips(cell, report).filter(|(_, flips)| *flips > 0.0);
            let bound = flips.map_or_else(String::new, |(subject, flips)| {
                let [r_d_by_chance, _] = chance_bounds(flips, report.axes.len());
                format!(
                    " {subject} in {} %; chance that changes so many can by itself change up to {} % \
                     of the simultaneous outcomes.",
                    percent(Some(flips)),
                    percent(Some(r_d_by_chance)),
                )
            });
            let cause = match report.cells.iter().any(|cell| cell.level == Level::L0) {
                true => "because the placebo level L0 has no complete configuration of these axes"
                    .to_owned(),
                false => format!("without a placebo (`--levels L0,{level}`)"),
            };
            format!(
                "At {level}, the simultaneous outcome of {r_d} % of {n} configurations is not the \
                 one that the single axes imply; how many of them differ by chance is unknown \
                 {cause}.{bound}"
            )
        }
    };
    Some(Finding { kind: FindingKind::Simultaneity, level, claims, holm_p: Some(p), sentence })
}

/// Returns the beginning of a sentence, and the share of pairs of nearly identical rollouts that end
/// differently: nominal rollouts of two replicates, otherwise a nominal and a language-perturbed
/// rollout. Language has an effect of its own, so that the second share is an upper bound of chance.
fn flips(cell: &Cell, report: &Report) -> Option<(&'static str, f64)> {
    if let Some(rate) = report.flips.get(&Condition::Nominal).and_then(Flips::rate) {
        return Some(("Nominal rollouts of two replicates end differently", rate));
    }
    let language = Condition::Single(benchmark::Axis::Language);
    let loss = cell.inference.as_ref()?.losses.get(&language)?;
    let differ = loss.nominal_only + loss.condition_only;
    let rate = differ as f64 / loss.n as f64;
    Some(("Nominal and language rollouts end differently", rate))
}

/// Writes the finding about the dependence on the direction, if it is significant.
fn directions(cell: &Cell, corrected: &CorrectedPValues) -> Option<Finding> {
    let test = cell.inference.as_ref()?.directions.as_ref()?;
    let p = corrected.p(cell, Hypothesis::Directions);
    let [low, high] = test.range();
    (p < FINDING_ALPHA).then(|| Finding {
        kind: FindingKind::Directions,
        level: cell.level,
        claims: true,
        holm_p: Some(p),
        sentence: format!(
            "At {}, success depends on the direction: simultaneously, {} to {} % succeed under \
             the {} directions. Beyond these directions, only the intervals for new tasks and \
             directions hold.",
            cell.level,
            percent(Some(low)),
            percent(Some(high)),
            test.rates.len()
        ),
    })
}

/// Formats the interval for new tasks: ` (-14.2 to -6.0)`.
fn interval_of_new_tasks(estimate: &Estimate) -> String {
    estimate.new_tasks.map_or_else(String::new, |[low, high]| {
        format!(" ({:.1} to {:.1})", 100.0 * low, 100.0 * high)
    })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FindingKind {
    /// Cost of single axes.
    Cost,
    /// Change by simultaneity beyond chance.
    Simultaneity,
    /// Dependence of success on the direction.
    Directions,
}

/// A generated sentence of a report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    pub kind: FindingKind,
    pub level: Level,
    /// True if the sentence claims an effect.
    pub claims: bool,
    /// The corrected p-value behind the sentence, or the smallest of several; absent if no test is
    /// behind it.
    pub holm_p: Option<f64>,
    pub sentence: String,
}
