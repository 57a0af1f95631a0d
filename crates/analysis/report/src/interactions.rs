//! Interactions of the axes in a campaign by level, over the configurations whose whole
//! lattice was run, as text for a terminal and as JSON. `adaptive::subsets` defines
//! the interactions.

use std::collections::BTreeMap;
use std::fmt::Write;

use adaptive::subsets::{
    CompleteLattice, Estimate, IncompleteLattice, Interactions, Lattice, LatticeError,
    configurations, own_configurations,
};
use libero_ctrl::{Axis, AxisSet, JsonError, Level, RolloutId};
use paired::{Bootstrap, push_wrapped};
use serde::Serialize;

use crate::subject::Subject;
use crate::words::{percent, points, points_interval};

/// Width of the column of axis names, in characters.
const NAMES: usize = 48;
/// Width of the column of success rates, in characters.
const RATE: usize = 7;
/// Width of the column of changes of success, in characters.
const CHANGE: usize = 8;

/// Interactions of a campaign's axes.
#[derive(Clone, Debug)]
pub struct AxisInteractions {
    pub campaign: String,
    pub policy: String,
    /// Warnings to be read first.
    pub notes: Vec<String>,
    /// Settings of the intervals.
    pub bootstrap: Bootstrap,
    /// Each level with a configuration whose whole lattice was run, in order of radius.
    pub levels: Vec<LevelInteractions>,
}

#[derive(Clone, Debug)]
pub struct LevelInteractions {
    pub level: Level,
    /// Configurations that lack an outcome under some subset.
    pub left_out: u64,
    /// Interactions over the configurations with an outcome under every subset.
    pub interactions: Interactions,
}

/// Reason why no interactions can be computed.
#[derive(Clone, Debug, thiserror::Error)]
pub enum NoInteractions {
    #[error(transparent)]
    Axes(#[from] LatticeError),
    /// The campaign has no perturbed configuration.
    #[error("compute the interactions of `{0}`: it perturbs nothing; create it with `--axes`")]
    Empty(String),
    #[error(
        "compute the interactions of `{campaign}`: none of its {configurations} configurations has \
         an outcome under every subset of the axes, nominal included ({first}: {gap}); wait for its \
         rollouts, create a campaign with `--subsets all`, or explain one with `--exhaustive`"
    )]
    Incomplete { campaign: String, configurations: usize, first: RolloutId, gap: IncompleteLattice },
}

impl AxisInteractions {
    /// Computes the interactions of a subject from its own subsets or, if it explains a campaign,
    /// from its outcomes and those of that campaign.
    ///
    /// # Errors
    /// If the campaign's axes or records are invalid ([`LatticeError`]), or no configuration has an
    /// outcome under every subset of the axes.
    pub fn of(subject: &Subject) -> Result<Self, NoInteractions> {
        let campaign = subject.origin_name();
        let explains = subject.explains();
        let lattices = match explains {
            Some((explanation, records)) => {
                configurations(records, &subject.records, explanation.repeats)?
            }
            None => own_configurations(&subject.counted())?,
        };
        let mut notes = Vec::new();
        if let Some((explanation, _)) = explains {
            notes.push(format!(
                "these configurations were picked because simultaneous perturbation changes their \
                 outcome: the results hold for them, and not for all configurations of `{}`; to \
                 measure all configurations, create a campaign with `--subsets all`",
                explanation.campaign
            ));
        }
        let bootstrap = Bootstrap::default();
        let mut levels: BTreeMap<Level, Vec<Result<CompleteLattice, IncompleteLattice>>> =
            BTreeMap::new();
        for (id, lattice) in &lattices {
            levels.entry(id.level()).or_default().push(complete_lattice(id, lattice));
        }
        let interactions = |(level, lattices): (Level, Vec<Result<_, _>>)| {
            let all = lattices.len() as u64;
            let complete: Vec<CompleteLattice> = lattices.into_iter().flatten().collect();
            Some(LevelInteractions {
                level,
                left_out: all - complete.len() as u64,
                interactions: Interactions::of(&complete, &bootstrap)?,
            })
        };
        let levels: Vec<LevelInteractions> = levels.into_iter().filter_map(interactions).collect();
        match lattices
            .iter()
            .find_map(|(id, lattice)| Some((id, complete_lattice(id, lattice).err()?)))
        {
            _ if !levels.is_empty() => Ok(Self {
                campaign: campaign.to_owned(),
                policy: subject.policy.clone(),
                notes,
                bootstrap,
                levels,
            }),
            None => Err(NoInteractions::Empty(campaign.to_owned())),
            Some((first, gap)) => Err(NoInteractions::Incomplete {
                campaign: campaign.to_owned(),
                configurations: lattices.len(),
                first: *first,
                gap,
            }),
        }
    }

    /// Writes the interactions as JSON, several lines.
    ///
    /// # Errors
    /// If serialisation fails, which is a defect.
    pub fn json(&self) -> Result<String, JsonError> {
        Ok(serde_json::to_string_pretty(&self.form())?)
    }

    pub(crate) fn form(&self) -> JsonForm<'_> {
        JsonForm {
            campaign: &self.campaign,
            policy: &self.policy,
            notes: &self.notes,
            bootstrap: self.bootstrap,
            levels: self.levels.iter().map(JsonLevel::new).collect(),
        }
    }

    /// Writes the interactions as text for a terminal of 80 columns.
    pub fn text(&self) -> String {
        let mut text = format!("campaign {}\npolicy {}\n\n", self.campaign, self.policy);
        for note in &self.notes {
            push_wrapped(&mut text, "! ", note);
        }
        if !self.notes.is_empty() {
            text.push('\n');
        }
        for level in &self.levels {
            level.push(&mut text);
        }
        push_wrapped(
            &mut text,
            "",
            "Success is the success rate under the subset, in percent. Effect is the subset's \
             Moebius interaction, in points: the effect of its axes together beyond the effects of \
             its smaller subsets. Nominal success and all interactions add up to simultaneous \
             success. A share is an axis's Shapley value: its effect, averaged over all orders in \
             which axes can be added. The index of a pair is its Shapley interaction index: the \
             amount by which one axis changes the effect of the other; below 0 they do more harm \
             together. Brackets hold 95 % intervals, which hold simultaneously for all shares, for \
             all pairs, and for all effects of subsets.",
        );
        text
    }
}

/// Returns the outcomes of a configuration under every subset.
///
/// # Errors
/// If an outcome is missing.
fn complete_lattice(
    id: &RolloutId,
    lattice: &Lattice,
) -> Result<CompleteLattice, IncompleteLattice> {
    CompleteLattice::new(id.task(), lattice.full(), |set| lattice.verdict(set).success())
}

impl LevelInteractions {
    /// Returns nominal success and success with all axes perturbed.
    pub(crate) fn ends(&self) -> [&Estimate; 2] {
        let success = &self.interactions.success;
        [&success[&AxisSet::EMPTY], &success[&self.interactions.full]]
    }

    fn push(&self, text: &mut String) {
        let Interactions { n, tasks, success, moebius, sizes, shapley, pairs, .. } =
            &self.interactions;
        let _ = write!(text, "{}: {n} configurations of {tasks} tasks", self.level);
        if self.left_out > 0 {
            let _ = write!(text, "; {} lack an outcome and are left out", self.left_out);
        }
        text.push_str("\n\n");
        let [nominal, simultaneous] = self.ends();
        push_line(text, "from nominal to simultaneous", "success", "effect");
        push_line(text, "nominal", &rate(nominal), "");
        for (axes, estimate) in sizes {
            let name = match axes {
                1 => "+ each axis alone".to_owned(),
                axes => format!("+ sets of {axes} axes"),
            };
            push_line(text, &name, "", &change(estimate));
        }
        push_line(text, "= simultaneous", &rate(simultaneous), "");
        text.push('\n');
        push_line(text, "shares of the change", "", "share");
        for (axis, estimate) in shapley {
            push_line(text, axis.name(), "", &change(estimate));
        }
        text.push('\n');
        push_line(text, "pairs", "", "index");
        for (pair, estimate) in pairs {
            push_line(text, pair.name(), "", &change(estimate));
        }
        text.push('\n');
        push_line(text, "subsets", "success", "effect");
        for (set, estimate) in success {
            let beyond = moebius.get(set).map(change).unwrap_or_default();
            push_line(text, set.name(), &rate(estimate), &beyond);
        }
        text.push('\n');
    }
}

/// Appends a line; the change is right-aligned in its column and its interval follows.
fn push_line(text: &mut String, name: &str, success: &str, change: &str) {
    let (number, interval) = change.split_once(' ').unwrap_or((change, ""));
    let line = format!("{name:<NAMES$}{success:>RATE$}{number:>CHANGE$} {interval}");
    text.push_str(line.trim_end());
    text.push('\n');
}

fn rate(estimate: &Estimate) -> String {
    percent(estimate.value)
}

/// Formats a change in ASCII, such as `-12.3 [-20.1, -4.0]`.
fn change(estimate: &Estimate) -> String {
    let interval = estimate.simultaneous_ci95.or(estimate.ci95);
    let interval = points_interval(interval, estimate.no_interval);
    format!("{}{interval}", points(estimate.value)).replace('−', "-")
}

/// JSON form, with lists in place of maps so that every key is a fixed field name.
#[derive(Serialize)]
pub(crate) struct JsonForm<'a> {
    campaign: &'a str,
    policy: &'a str,
    notes: &'a [String],
    bootstrap: Bootstrap,
    levels: Vec<JsonLevel<'a>>,
}

#[derive(Serialize)]
struct JsonLevel<'a> {
    level: Level,
    axes: AxisSet,
    n: u64,
    tasks: u64,
    left_out: u64,
    subsets: Vec<JsonSubset<'a>>,
    sizes: Vec<JsonSize<'a>>,
    shares: Vec<JsonShare<'a>>,
    pairs: Vec<JsonPair<'a>>,
}

#[derive(Serialize)]
struct JsonSubset<'a> {
    set: AxisSet,
    success: &'a Estimate,
    /// Null for the empty set.
    moebius: Option<&'a Estimate>,
}

#[derive(Serialize)]
struct JsonSize<'a> {
    axes: usize,
    moebius: &'a Estimate,
}

#[derive(Serialize)]
struct JsonShare<'a> {
    axis: Axis,
    shapley: &'a Estimate,
}

#[derive(Serialize)]
struct JsonPair<'a> {
    set: AxisSet,
    shapley: &'a Estimate,
}

impl<'a> JsonLevel<'a> {
    fn new(level: &'a LevelInteractions) -> Self {
        let interactions = &level.interactions;
        let subset =
            |(&set, success)| JsonSubset { set, success, moebius: interactions.moebius.get(&set) };
        let size = |(&axes, moebius)| JsonSize { axes, moebius };
        let share = |(&axis, shapley)| JsonShare { axis, shapley };
        let pair = |(&set, shapley)| JsonPair { set, shapley };
        Self {
            level: level.level,
            axes: interactions.full,
            n: interactions.n,
            tasks: interactions.tasks,
            left_out: level.left_out,
            subsets: interactions.success.iter().map(subset).collect(),
            sizes: interactions.sizes.iter().map(size).collect(),
            shares: interactions.shapley.iter().map(share).collect(),
            pairs: interactions.pairs.iter().map(pair).collect(),
        }
    }
}
