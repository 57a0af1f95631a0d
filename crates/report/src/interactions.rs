//! Interactions of the axes in a campaign by level, over the configurations whose whole
//! lattice was run, as blocks of a report and as JSON. `paired::adaptive::subsets` defines
//! the interactions.

use std::collections::BTreeMap;

use benchmark::{AxisSet, Level, RolloutId};
use paired::Bootstrap;
use paired::adaptive::subsets::{
    CompleteLattice, Estimate, IncompleteLattice, Interactions, Lattice, LatticeError,
    configurations, own_configurations,
};
use serde::{Serialize, Serializer};
use serde_json::{Value, json};

use crate::block::{self, Block, Cell, Rows, Section, cell};
use crate::page::findings::sentence;
use crate::subject::Subject;
use crate::words::{percent, points, points_interval};

#[derive(Clone, Debug, Serialize)]
pub struct AxisInteractions {
    pub campaign: String,
    pub policy: String,
    /// Warnings to be read first.
    pub notes: Vec<String>,
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

    /// Writes the interactions as text for a terminal of 80 columns.
    pub fn text(&self) -> String {
        let head = format!("campaign {}\npolicy {}\n\n", self.campaign, self.policy);
        let section = self.section("");
        format!("{head}{}", block::text(&section.blocks))
    }

    /// Returns the section of a report in which the policy has this label, unless it is empty.
    pub(crate) fn section(&self, label: &str) -> Section<'_> {
        let notes = self.notes.iter().map(|note| Block::Paragraph(sentence(note)));
        let levels = self.levels.iter().flat_map(LevelInteractions::blocks);
        let policy = if label.is_empty() { String::new() } else { format!(": {label}") };
        Section {
            title: format!("Interactions of the axes{policy}"),
            blocks: notes.chain(levels).collect(),
        }
    }
}

/// Returns the outcomes of a configuration under every subset.
fn complete_lattice(
    id: &RolloutId,
    lattice: &Lattice,
) -> Result<CompleteLattice, IncompleteLattice> {
    CompleteLattice::new(id.task(), lattice.full(), |set| lattice.verdict(set).success())
}

impl LevelInteractions {
    /// Returns nominal success and success with all axes perturbed.
    fn ends(&self) -> [&Estimate; 2] {
        let success = &self.interactions.success;
        [&success[&AxisSet::EMPTY], &success[&self.interactions.full]]
    }

    fn blocks(&self) -> Vec<Block<'_>> {
        let Interactions { n, tasks, success, moebius, sizes, shapley, pairs, .. } =
            &self.interactions;
        let mut summary = format!("{}: {n} configurations of {tasks} tasks", self.level);
        if self.left_out > 0 {
            summary += &format!("; {} lack an outcome and are left out", self.left_out);
        }
        let [nominal, simultaneous] = self.ends();
        let steps = sizes.iter().map(|(axes, effect)| match axes {
            1 => ("+ each axis alone".to_owned(), None, Some(effect)),
            axes => (format!("+ sets of {axes} axes"), None, Some(effect)),
        });
        let steps = [("nominal".to_owned(), Some(nominal), None)].into_iter().chain(steps);
        let steps = steps.chain([("= simultaneous".to_owned(), Some(simultaneous), None)]);
        let subsets = success.iter();
        let subsets =
            subsets.map(|(set, success)| (set.to_string(), Some(success), moebius.get(set)));
        let effects =
            |title: &str, name, rows: Vec<(String, Option<&Estimate>, Option<&Estimate>)>| {
                let rows = Rows::new(format!("{title} at {}", self.level), rows)
                    .key(name, |(name, ..)| cell(name))
                    .column("success", "%", "", |(_, success, _)| {
                        cell(success.map_or_else(String::new, |success| percent(success.value)))
                    })
                    .column("effect", "points", EFFECT, |(.., effect)| change(*effect))
                    .column("95 %", "", INTERVAL, |(.., effect)| interval(*effect));
                Block::Table(rows.table())
            };
        let values = |title: &str, name, note: &str, rows: Vec<(&'static str, &Estimate)>| {
            let rows = Rows::new(format!("{title} at {}", self.level), rows)
                .key("axes", |(name, _)| cell(name))
                .column(name, "points", note, |(_, value)| change(Some(value)))
                .column("95 %", "", INTERVAL, |(_, value)| interval(Some(value)));
            Block::Table(rows.table())
        };
        vec![
            Block::Paragraph(format!("{summary}.")),
            effects("From nominal to simultaneous", "step", steps.collect()),
            values(
                "Shares of the change",
                "share",
                "Shapley value: the axis's effect, averaged over all orders in which axes can be \
                 added",
                shapley.iter().map(|(axis, value)| (axis.name(), value)).collect(),
            ),
            values(
                "Pairs",
                "index",
                "Shapley interaction index: the amount by which one axis changes the effect of the \
                 other; below 0 they do more harm together",
                pairs.iter().map(|(pair, value)| (pair.name(), value)).collect(),
            ),
            effects("Every subset", "axes", subsets.collect()),
        ]
    }
}

const EFFECT: &str = "Moebius interaction: the effect of the axes together beyond the effects of their smaller \
     subsets; nominal success and all interactions add up to simultaneous success";
const INTERVAL: &str = "holds simultaneously for all shares, for all pairs, and for all subsets";

fn change(effect: Option<&Estimate>) -> Cell {
    cell(effect.map_or_else(String::new, |effect| points(effect.value)))
}

fn interval(effect: Option<&Estimate>) -> Cell {
    let interval = effect.map(|effect| {
        let interval = effect.simultaneous_ci95.or(effect.ci95);
        points_interval(interval, effect.no_interval)
    });
    cell(interval.unwrap_or_default().trim_start())
}

/// Lists in place of maps, so that every key is a fixed field name.
impl Serialize for LevelInteractions {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Interactions { full, n, tasks, success, moebius, sizes, shapley, pairs } =
            &self.interactions;
        let subsets = success.iter().map(
            |(set, success)| json!({"set": set, "success": success, "moebius": moebius.get(set)}),
        );
        let sizes = sizes.iter().map(|(axes, sum)| json!({"axes": axes, "moebius": sum}));
        let shares = shapley.iter().map(|(axis, value)| json!({"axis": axis, "shapley": value}));
        let pairs = pairs.iter().map(|(set, index)| json!({"set": set, "shapley": index}));
        let [subsets, sizes, shares, pairs]: [Vec<Value>; 4] =
            [subsets.collect(), sizes.collect(), shares.collect(), pairs.collect()];
        json!({
            "level": self.level, "axes": full, "n": n, "tasks": tasks, "left_out": self.left_out,
            "subsets": subsets, "sizes": sizes, "shares": shares, "pairs": pairs,
        })
        .serialize(serializer)
    }
}
