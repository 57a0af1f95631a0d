//! Findings of a campaign that explains another, as blocks of a report and as JSON.
//! `paired::adaptive::subsets` defines minimal subsets and chooses the subsets to run.

use std::collections::BTreeMap;
use std::fmt::Write;

use benchmark::{AxisSet, Explanation};
use paired::adaptive::Decision;
use paired::adaptive::subsets::{
    Answer, Explained, LatticeError, Occurrence, Repeats, Sample, Unexplained, Verdict,
    configurations, next, occurrences, plan, selected,
};
use paired::{Outcome, Record, Transition};
use serde::Serialize;

use crate::block::{self, Block, Rows, Section, Table, cell};
use crate::figures::{self, Link};
use crate::page::figure;
use crate::subject::{Prospect, Subject, agree, pluralise};

const FIGURE: &str = "The smallest sets of axes that change the outcome. Each column of dots is one set: a filled \
     dot is an axis that is perturbed. The bar above a column counts the configurations in which \
     the set changes the outcome and no smaller set that was run does; a configuration can have \
     several such sets. Left, sets that make a rollout fail although it succeeds under every axis \
     alone; right, sets that make a rollout succeed although it fails under one axis alone.";

/// Findings about a campaign's transitions.
#[derive(Clone, Debug, Serialize)]
pub struct Findings {
    /// The campaign whose transitions are explained.
    pub campaign: String,
    /// The campaign that ran the subsets.
    pub explained_by: String,
    pub policy: String,
    /// True if nothing remains to be run.
    pub complete: bool,
    /// Configurations with a transition to be explained.
    pub transitions: u64,
    /// Transitions whose explanation is finished.
    pub explained: u64,
    /// Transitions that repeats did not confirm, so that they may be due to chance.
    pub not_confirmed: u64,
    /// Emergent failures that are not explained because the nominal rollout fails too.
    pub nominal_fails: u64,
    /// Rollouts of the explaining campaign, finished or waiting.
    pub rollouts: u64,
    /// Number of these rollouts without an outcome yet.
    pub waiting: u64,
    /// Occurrences of each minimal subset.
    pub subsets: Vec<Occurrence>,
    /// Explanation of each configuration that ran under a proper subset of two or more axes.
    pub configurations: Vec<Explained>,
}

impl Findings {
    /// Returns the number of transitions to explain and the upper bound of the rollouts that their
    /// explanation takes.
    pub fn prospect(
        campaign: &Subject,
        explanation: &Explanation,
    ) -> Result<Prospect, LatticeError> {
        let lattices = configurations(&campaign.counted(), &[], explanation.repeats)?;
        let mut prospect = Prospect { sought: 0, most_rollouts: BTreeMap::new() };
        for (configuration, lattice) in &lattices {
            let axes = lattice.full().len();
            if let Some(repeats) = explanation.repeats
                && repeats < Repeats::fewest(axes)
            {
                let fewest = Repeats::fewest(axes);
                return Err(LatticeError::TooFewRepeats { axes, repeats, fewest });
            }
            if selected(lattice).is_ok() {
                let suite = configuration.task().suite();
                prospect.sought += 1;
                *prospect.most_rollouts.entry(suite).or_default() +=
                    u64::from(lattice.most_further_rollouts());
            }
        }
        if let Some(budget) = explanation.budget {
            prospect.bound(budget.into());
        }
        Ok(prospect)
    }

    /// Combines the outcomes of the campaign `explaining` with those of the campaign that it
    /// explains; `None` if `explaining` explains no campaign.
    pub fn of(explaining: &Subject) -> Result<Option<Self>, LatticeError> {
        let Some((explanation, records)) = explaining.explains() else {
            return Ok(None);
        };
        let lattices = configurations(records, &explaining.records, explanation.repeats)?;
        let sample = Sample::of(explanation);
        let waiting = explaining.records.iter();
        let waiting = waiting.filter(|record| !is_settled(record)).count();
        let mut findings = Self {
            campaign: explanation.campaign.clone(),
            explained_by: explaining.origin_name().to_owned(),
            policy: explaining.policy.clone(),
            // A configuration with a missing outcome may still turn out to have a transition.
            complete: records.iter().all(is_settled)
                && waiting == 0
                && plan(&lattices, &sample).is_empty(),
            transitions: 0,
            explained: 0,
            not_confirmed: 0,
            nominal_fails: 0,
            rollouts: explaining.records.len() as u64,
            waiting: waiting as u64,
            subsets: Vec::new(),
            configurations: Vec::new(),
        };
        for (&configuration, lattice) in &lattices {
            let explained = match Explained::of(configuration, lattice) {
                Ok(explained) => explained,
                Err(Unexplained::NominalFails) => {
                    findings.nominal_fails += 1;
                    continue;
                }
                Err(reason @ (Unexplained::AwaitsRepeats | Unexplained::NotConfirmed)) => {
                    findings.transitions += 1;
                    findings.not_confirmed += u64::from(reason == Unexplained::NotConfirmed);
                    continue;
                }
                Err(Unexplained::Incomplete | Unexplained::Unchanged(_)) => continue,
            };
            findings.transitions += 1;
            findings.explained += u64::from(next(lattice, sample.strategy) == Decision::Done);
            if explained.rollouts > 0 {
                findings.configurations.push(explained);
            }
        }
        findings.subsets = occurrences(&findings.configurations);
        Ok(Some(findings))
    }

    /// Writes the findings as text for a terminal of 80 columns.
    pub fn text(&self) -> String {
        block::text(self.sections(None).iter().flat_map(|section| &section.blocks))
    }

    /// Returns the sections of a report. Configurations are linked to the URLs that `link` returns.
    pub(crate) fn sections<'a>(&'a self, link: Option<Link<'a>>) -> Vec<Section<'a>> {
        let transitions = [Transition::Emergent, Transition::Compensated];
        let subsets = transitions.map(|transition| {
            let title = match transition {
                Transition::Compensated => {
                    "Compensated successes: the fewest axes with which a failing axis succeeds"
                }
                _ => "Emergent failures: the fewest axes that fail together",
            };
            let subsets = self.subsets.iter().filter(|subset| subset.transition == transition);
            let table = Rows::new(title, subsets)
                .key("axes", |of| cell(subset(of.start, of.set)))
                .column("configurations", "", "", |of| cell(of.configurations))
                .column("established", "", "every smaller subset was run", |of| {
                    cell(of.established)
                });
            Block::Table(table.table())
        });
        let figure = move || {
            let panels = transitions.into_iter();
            figure(FIGURE, panels.filter_map(|of| figures::upset(self, of)).collect())
        };
        let summary = format!("{} {}.", self.explained_by, self.describe_progress());
        let blocks = [Block::Paragraph(summary), Block::Html(Box::new(figure))];
        vec![
            Section {
                title: "Minimal subsets of the axes".to_owned(),
                blocks: blocks.into_iter().chain(subsets).collect(),
            },
            Section { title: String::new(), blocks: vec![Block::Table(self.each(link))] },
        ]
    }

    fn each(&self, link: Option<Link<'_>>) -> Table {
        let list = |of: &Explained, words: fn(&Answer) -> String| {
            let words = of.explanation.answers.iter().map(words);
            let words: Vec<String> = words.filter(|words| !words.is_empty()).collect();
            cell(words.join("; "))
        };
        let undone = |answer: &Answer| {
            let pairs = answer.non_monotone.iter();
            let pairs = pairs.map(|pair| format!("{} by {}", pair.minimal, pair.superset));
            pairs.collect::<Vec<_>>().join(", ")
        };
        let undecided = |of: &Explained| {
            let is_open = |verdict| matches!(verdict, Verdict::Undecided | Verdict::Quarantined);
            let outcomes = of.outcomes.iter().filter(|outcome| is_open(outcome.verdict));
            outcomes.map(|outcome| outcome.set.name()).collect::<Vec<_>>().join(", ")
        };
        let all = || self.configurations.iter();
        let any_undone =
            all().any(|of| of.explanation.answers.iter().any(|a| !undone(a).is_empty()));
        let any_undecided = all().any(|of| !undecided(of).is_empty());
        Rows::new("Each configuration", all())
            .key("configuration", |of| {
                cell(of.configuration).link(link.map(|link| link(of.configuration, 0)))
            })
            .words("transition", |of| cell(of.explanation.transition.name()))
            .words("minimal subsets", |of| list(of, minimal))
            .when(any_undone, |rows| rows.words("undone", move |of| list(of, undone)))
            .words("largest unchanged subsets", |of| {
                list(of, |answer| {
                    let sets = answer.largest_unflipped.iter().map(|set| set.name());
                    sets.collect::<Vec<_>>().join(", ")
                })
            })
            .when(any_undecided, |rows| rows.words("undecided", move |of| cell(undecided(of))))
            .column("rollouts", "", "", |of| cell(of.rollouts))
            .note("robot with camera", "robot fails alone, and succeeds with camera as well")
            .note("undone", "a larger subset that was run does not change the outcome")
            .note("largest unchanged subsets", "those that were run and do not change the outcome")
            .table()
    }

    /// Returns the progress of the explanation: a sentence without subject and full stop.
    pub(crate) fn describe_progress(&self) -> String {
        let Self { transitions, explained, rollouts, waiting, .. } = self;
        let mut words = format!(
            "explains {}: {explained} of {transitions} transitions explained in {}",
            self.campaign,
            pluralise(*rollouts, "rollout")
        );
        if *waiting > 0 {
            let have = agree(*waiting, "has", "have");
            let _ = write!(words, ", of which {waiting} {have} no outcome yet");
        }
        if self.not_confirmed > 0 {
            let _ = write!(
                words,
                "; not confirmed by repeats, so that they may be due to chance: {}",
                self.not_confirmed
            );
        }
        if self.nominal_fails > 0 {
            let _ = write!(
                words,
                "; emergent failures left out because their nominal rollout fails too: {}",
                self.nominal_fails
            );
        }
        words
    }
}

fn is_settled(record: &Record) -> bool {
    record.outcome != Outcome::Missing
}

/// Formats a subset: `camera+robot`, or `robot with camera` if the search started at robot.
pub(crate) fn subset(start: AxisSet, set: AxisSet) -> String {
    match start.is_empty() {
        true => set.to_string(),
        false => format!("{start} with {}", set.without(start)),
    }
}

/// Lists the minimal subsets, and what is open about them.
fn minimal(answer: &Answer) -> String {
    let minimal = answer.minimal.iter().map(|minimal| {
        let name = subset(answer.start, minimal.set);
        match minimal.is_established() {
            true => name,
            false => format!(
                "{name} (not established: {} not run or not decided)",
                pluralise(minimal.open.len() as u64, "smaller subset")
            ),
        }
    });
    minimal.collect::<Vec<_>>().join(", ")
}
