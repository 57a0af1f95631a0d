//! The seven policies of the paper, whose published figures stand beside the measured ones.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

use benchmark::{Axis, Condition, Level, Look, Realisation, RolloutId, Suite, TaskRef};
use serde::Deserialize;

use crate::analysis::Analysis;
use crate::block::{Rows, Table, cell, or_dash};
use crate::document::Document;
use crate::subject::Origin;
use crate::warnings::PRIMITIVES;
use crate::words::percent;

/// Configurations behind each published figure, and nominal rollouts.
const CONFIGURATIONS: f64 = 400.0;
const NOMINAL: f64 = 2000.0;

#[derive(Deserialize)]
struct Paper {
    source: String,
    policies: Vec<Published>,
}

#[derive(Deserialize)]
struct Published {
    policy: String,
    /// Nominal successes by suite.
    nominal: [f64; 4],
    levels: BTreeMap<Level, Cell>,
}

#[derive(Deserialize)]
struct Cell {
    /// Success under each axis alone, per cent.
    #[serde(flatten)]
    alone: BTreeMap<Axis, f64>,
    simultaneous: f64,
    b: f64,
    c: f64,
}

static PAPER: LazyLock<Paper> = LazyLock::new(|| {
    serde_json::from_str(include_str!("paper.json")).expect("the paper's figures are JSON")
});

/// Returns the names of the paper's policies.
pub fn published_policies() -> Vec<&'static str> {
    PAPER.policies.iter().map(|of| of.policy.as_str()).collect()
}

/// Returns the published success of a policy in rollouts like one: of its suite if it is nominal,
/// otherwise under its condition at its level. `None` if the paper has no such figure. `pi05` and
/// `openvla_oft` are names of policies, too.
pub fn published_rate(policy: &str, id: RolloutId) -> Option<f64> {
    let plain = |name: &str| {
        let name = name.to_lowercase().replace('π', "pi");
        name.chars().filter(char::is_ascii_alphanumeric).collect::<String>()
    };
    let of = PAPER.policies.iter().find(|of| plain(&of.policy) == plain(policy))?;
    let at = of.levels.get(&id.level());
    match id.condition() {
        Condition::Nominal => {
            let suite = Suite::ALL.iter().position(|suite| *suite == id.task().suite())?;
            Some(of.nominal[suite] * Suite::ALL.len() as f64 / NOMINAL)
        }
        Condition::Simultaneous => Some(at?.simultaneous / 100.0),
        Condition::Single(axis) => Some(at?.alone.get(&axis)? / 100.0),
        _ => None,
    }
}

/// One policy at one level, measured or published; rates are fractions.
pub(crate) struct Point {
    pub(crate) policy: String,
    /// Capital of a measured policy, small of a published one; policies beyond the 26th share one.
    pub(crate) letter: char,
    pub(crate) level: Level,
    pub(crate) is_published: bool,
    pub(crate) nominal: Option<f64>,
    pub(crate) alone: BTreeMap<Axis, f64>,
    pub(crate) s_sim: f64,
    pub(crate) r_e: f64,
    pub(crate) r_c: f64,
    /// Intervals of `s_sim`, `r_e` and `r_c`.
    pub(crate) intervals: [Option<[f64; 2]>; 3],
    /// Differences from the paper's set-up.
    differs: String,
}

/// Returns the measured cells of the paper's levels and axes, then the published ones; empty if
/// there are no such measured cells.
pub(crate) fn points(document: &Document) -> Vec<Point> {
    let measured = document.analyses.iter().zip(letters('A'..='Z')).flat_map(|(of, letter)| {
        of.report.cells.iter().filter_map(move |at| {
            let (measures, sim) = (at.paired.as_ref()?, at.simultaneous?.rate()?);
            let alone =
                Axis::ALL.into_iter().map(|axis| Some((axis, at.alone.get(&axis)?.count.rate()?)));
            let estimates = at.inference.as_ref().map(|inference| &inference.paired);
            let intervals = estimates.map(|of| [of.s_sim, of.r_e, of.r_c].map(|of| of.new_tasks));
            let is_of_paper = PAPER.policies[0].levels.contains_key(&at.level);
            Some(Point {
                policy: of.label.clone(),
                letter,
                level: at.level,
                is_published: false,
                nominal: of.report.nominal.as_ref().and_then(|nominal| nominal.count.rate()),
                alone: alone.collect::<Option<_>>().filter(|_| is_of_paper)?,
                s_sim: sim,
                r_e: measures.r_e,
                r_c: measures.r_c,
                intervals: intervals.unwrap_or_default(),
                differs: differences(of).join(", "),
            })
        })
    });
    let mut points: Vec<Point> = measured.collect();
    if !points.is_empty() {
        points.extend(PAPER.policies.iter().zip(letters('a'..='z')).flat_map(|(of, letter)| {
            of.levels.iter().map(move |(&level, at)| Point {
                policy: format!("{} (paper)", of.policy),
                letter,
                level,
                is_published: true,
                nominal: Some(of.nominal.iter().sum::<f64>() / NOMINAL),
                alone: at.alone.iter().map(|(&axis, rate)| (axis, rate / 100.0)).collect(),
                s_sim: at.simultaneous / 100.0,
                r_e: at.b / CONFIGURATIONS,
                r_c: at.c / CONFIGURATIONS,
                intervals: [None; 3],
                differs: String::new(),
            })
        }));
    }
    points
}

fn letters(alphabet: std::ops::RangeInclusive<char>) -> impl Iterator<Item = char> {
    let last = *alphabet.end();
    alphabet.chain(std::iter::repeat(last))
}

/// Names what differs from the paper's set-up, or is not known.
fn differences(analysis: &Analysis) -> Vec<String> {
    let subject = &analysis.subject;
    let tasks: BTreeSet<TaskRef> = subject.records.iter().map(|record| record.id.task()).collect();
    let is_primitive = subject.provenances.iter().any(|of| of.pin.asset_pack == PRIMITIVES);
    let looks = subject.looks();
    let is_campaign = matches!(subject.origin, Origin::Campaign { .. });
    let all = TaskRef::all().count();
    let parts = [
        (tasks.len() < all).then(|| format!("{} of {all} tasks", tasks.len())),
        is_primitive.then(|| "assets".to_owned()),
        (looks != BTreeSet::from([Look::default()]))
            .then(|| if looks.is_empty() { "look not known" } else { "look" }.to_owned()),
        match subject.realisation {
            Some(Realisation::Reference) => None,
            Some(_) => Some("realisation".to_owned()),
            None => Some("realisation not known".to_owned()),
        },
        // The released code's results have its sentences, all others those of this project.
        (is_campaign || subject.realisation == Some(Realisation::Matched))
            .then(|| "sentences".to_owned()),
        (!subject.execution.is_wait()).then(|| "execution model".to_owned()),
    ];
    parts.into_iter().flatten().collect()
}

/// Measured and published success, a row per policy and level.
pub(crate) fn table(document: &Document) -> Table {
    let rows = points(document);
    let differs = rows.iter().any(|of| !of.differs.is_empty());
    let mut table = Rows::new("Beside the paper's policies, %", rows)
        .key("policy", |of| cell(&of.policy))
        .key("level", |of| cell(of.level))
        .column("nominal", "", "", |of| or_dash(of.nominal.map(percent)));
    for axis in Axis::ALL {
        let rate = move |of: &Point| or_dash(of.alone.get(&axis).copied().map(percent));
        table = table.column(axis.name(), "", "", rate);
    }
    table
        .column(Condition::Simultaneous.name(), "", "", |of| cell(percent(of.s_sim)))
        .column("R_e", "", "", |of| cell(percent(of.r_e)))
        .column("R_c", "", "", |of| cell(percent(of.r_c)))
        .when(differs, |rows| rows.words("differs in", |of| cell(&of.differs)))
        .note("(paper)", &PAPER.source)
        .table()
}
