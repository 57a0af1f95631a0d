//! Paired comparison of two campaigns of one benchmark of LIBERO's family: two policies, or one
//! policy under two protocols. Protocols are never pooled, but a variant can be paired with itself
//! under another protocol.

use std::collections::BTreeMap;
use std::fmt::Write;

use benchmark::RolloutId;
use benchmark::family::{Case, Subject as CaseSubject};
use paired::{Interval, NoInterval, Record};
use serde::Serialize;

use crate::block::{self, Block, Rows, cell};
use crate::comparison::{SHARED, Side, Unpairable, property_difference};
use crate::family::{Counted, Family, FamilyError, Line, group, interval, number};
use crate::subject::{Subject, agree, pluralise};

/// Comparison of two campaigns over the rollouts that have an outcome in both.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FamilyComparison {
    pub a: Side,
    pub b: Side,
    /// Number of rollouts with an outcome in A but not in B, and in B but not in A.
    pub unpaired: [u64; 2],
    pub unperturbed: PairedLine,
    /// Dimensions, suites or types, in the benchmark's order.
    pub groups: Vec<PairedLine>,
    /// All variants together.
    pub all: PairedLine,
}

/// A row of the table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairedLine {
    /// Dimension, suite or type; `unperturbed` or `all`.
    pub name: String,
    pub tasks: u64,
    /// Rollouts with an outcome in both campaigns.
    pub pairs: u64,
    pub a_successes: u64,
    pub b_successes: u64,
    pub only_a: u64,
    pub only_b: u64,
    /// Success of A less that of B, percentage points.
    pub difference: Option<f64>,
    /// 95 % interval of `difference`, by a bootstrap over tasks.
    pub interval: Option<Interval>,
    pub no_interval: Option<NoInterval>,
}

/// Failure to compare two campaigns of LIBERO's family or of suite files.
#[derive(Debug, thiserror::Error)]
pub enum FamilyComparisonError {
    /// This program does not know a campaign's protocol or one of its variants.
    #[error(transparent)]
    Family(#[from] FamilyError),
    #[error(transparent)]
    Unpairable(#[from] Unpairable),
}

impl FamilyComparison {
    /// Compares two campaigns; `None` if one of them is neither of LIBERO's family nor of a suite
    /// file.
    pub fn of(a: &Subject, b: &Subject) -> Result<Option<Self>, FamilyComparisonError> {
        let (Some(family_a), Some(family_b)) = (Family::of(a)?, Family::of(b)?) else {
            return Ok(None);
        };
        let sides = [(a, &family_a), (b, &family_b)].map(|(subject, family)| Side {
            label: format!("{} under {}", family.policy, family.protocol),
            policy: family.policy.clone(),
            origin: subject.origin.clone(),
        });
        let shared = SHARED.iter();
        let mut reasons: Vec<String> =
            shared.filter_map(|property| property_difference(property, [a, b], &sides)).collect();
        if family_a.benchmark != family_b.benchmark {
            reasons.push(format!(
                "their benchmarks are {} and {}: run both with the same benchmark",
                family_a.benchmark, family_b.benchmark
            ));
        }
        let (outcomes_a, outcomes_b) = (outcomes(a), outcomes(b));
        // A's success takes the place of the unperturbed rollout's: `broken` then counts the pairs
        // in which only A succeeds, `gained` those in which only B does.
        let counted: Vec<Counted> = outcomes_a
            .iter()
            .filter_map(|(rollout, a_success)| {
                Some(Counted {
                    case: Case::of_id(rollout.0).ok()?,
                    success: *outcomes_b.get(rollout)?,
                    unperturbed_success: Some(*a_success),
                })
            })
            .collect();
        if counted.is_empty() && reasons.is_empty() {
            reasons.push(
                "they have no rollout in common: give both campaigns the same variants, suites or \
                 trials"
                    .to_owned(),
            );
        }
        let [a, b] = sides;
        if !reasons.is_empty() {
            let (a, b) = (a.label, b.label);
            return Err(Unpairable { a, b, reasons }.into());
        }
        let paired = counted.len();
        let unpaired = [&outcomes_a, &outcomes_b].map(|all| (all.len() - paired) as u64);
        let (unperturbed, variants): (Vec<Counted>, Vec<Counted>) =
            counted.into_iter().partition(|pair| pair.case.subject == CaseSubject::Unperturbed);
        let mut groups: BTreeMap<_, Vec<&Counted>> = BTreeMap::new();
        for variant in &variants {
            groups.entry(group(&variant.case)).or_default().push(variant);
        }
        Ok(Some(Self {
            a,
            b,
            unpaired,
            unperturbed: PairedLine::new(Line::new("unperturbed", unperturbed.iter())),
            groups: groups
                .into_iter()
                .map(|((_, name), pairs)| PairedLine::new(Line::new(&name, pairs.into_iter())))
                .collect(),
            all: PairedLine::new(Line::new("all", variants.iter())),
        }))
    }

    /// Writes the comparison for a terminal.
    pub fn text(&self) -> String {
        let mut text = format!("A: {}\nB: {}\n", self.a.label, self.b.label);
        for (name, unpaired) in ["A", "B"].into_iter().zip(self.unpaired) {
            if unpaired > 0 {
                let _ = writeln!(
                    text,
                    "{} of {name} {} no outcome in the other campaign.",
                    pluralise(unpaired, "rollout"),
                    agree(unpaired, "has", "have")
                );
            }
        }
        let unperturbed = [&self.unperturbed].into_iter().filter(|line| line.pairs > 0);
        let percent = |line: &PairedLine, successes: u64| {
            cell(number((line.pairs > 0).then(|| 100.0 * successes as f64 / line.pairs as f64)))
        };
        let table = Rows::new("Pairs", unperturbed.chain(&self.groups).chain([&self.all]))
            .key("variants", |line| cell(&line.name))
            .column(
                "pairs",
                "",
                "a rollout of A is paired with that of B of the same variant and initial state",
                |line| cell(line.pairs),
            )
            .column("A", "%", "", |line| percent(line, line.a_successes))
            .column("B", "%", "", |line| percent(line, line.b_successes))
            .column("only A", "", "pairs in which A succeeds and B fails", |line| cell(line.only_a))
            .column("only B", "", "", |line| cell(line.only_b))
            .column("A − B", "points", "", |line| cell(number(line.difference)))
            .column("95 % interval", "", "resamples whole tasks", |line| {
                cell(interval(line.interval, line.no_interval))
            });
        text.push('\n');
        text.push_str(&block::text(&[Block::Table(table.table())]));
        text
    }
}

impl PairedLine {
    /// Converts a line whose `broken` are the pairs in which only A succeeds, and whose `gained`
    /// are those in which only B does.
    fn new(line: Line) -> Self {
        Self {
            a_successes: line.successes + line.broken - line.gained,
            b_successes: line.successes,
            name: line.name,
            tasks: line.tasks,
            pairs: line.pairs,
            only_a: line.broken,
            only_b: line.gained,
            difference: line.loss,
            interval: line.loss_interval,
            no_interval: line.no_loss_interval,
        }
    }
}

/// Returns the outcomes of a campaign's rollouts by id and replicate.
fn outcomes(subject: &Subject) -> BTreeMap<(RolloutId, u32), bool> {
    let records = subject.records.iter();
    let outcome =
        |record: &Record| Some(((record.id, record.replicate), record.outcome.success()?));
    records.filter_map(outcome).collect()
}
