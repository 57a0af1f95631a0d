//! Findings of a campaign that explains another, as text for a terminal and as JSON.
//! `adaptive::subsets` defines minimal subsets and chooses the subsets to run.

use std::collections::BTreeMap;
use std::fmt::Write;

use adaptive::Decision;
use adaptive::subsets::{
    Answer, Explained, LatticeError, Occurrence, Repeats, Sample, Unexplained, Verdict,
    configurations, next, occurrences, plan, selected,
};
use libero_ctrl::{AxisSet, Explanation, JsonError};
use paired::{Outcome, Record, Transition, push_wrapped};
use serde::Serialize;

use crate::subject::{Prospect, Subject, agree, pluralise};
use crate::words::push_name;

/// Width of the column of axis names, in characters.
const NAMES: usize = 52;

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
    ///
    /// # Errors
    /// If the campaign perturbs fewer than two axes, has a rollout and replicate twice, or allows
    /// too few repeats to decide an outcome.
    pub fn prospect(
        campaign: &Subject,
        explanation: &Explanation,
    ) -> Result<Prospect, LatticeError> {
        let lattices = configurations(&campaign.counted(), &[], explanation.repeats)?;
        let mut prospect = Prospect { subjects: 0, most_rollouts: BTreeMap::new() };
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
                prospect.subjects += 1;
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
    ///
    /// # Errors
    /// If the explained campaign perturbs fewer than two axes or has a rollout and replicate twice,
    /// or `explaining` perturbs an axis that the explained campaign lacks.
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

    /// Writes the findings as JSON, several lines.
    ///
    /// # Errors
    /// If serialisation fails, which is a defect.
    pub fn json(&self) -> Result<String, JsonError> {
        Ok(serde_json::to_string_pretty(self)?)
    }

    /// Writes the findings as text for a terminal of 80 columns.
    pub fn text(&self) -> String {
        let mut text = String::new();
        push_wrapped(&mut text, "", &format!("{} {}", self.explained_by, self.describe_progress()));
        let is_emergent = |occurrence: &&Occurrence| occurrence.transition == Transition::Emergent;
        let (emergent, compensated): (Vec<&Occurrence>, Vec<&Occurrence>) =
            self.subsets.iter().partition(is_emergent);
        push_subsets(&mut text, "emergent failures: the fewest axes that fail together", &emergent);
        push_subsets(
            &mut text,
            "compensated successes: the fewest axes with which a failing axis succeeds",
            &compensated,
        );
        if !self.configurations.is_empty() {
            text.push_str("\neach configuration\n");
        }
        for explained in &self.configurations {
            push_configuration(&mut text, explained);
        }
        text
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

/// Appends the occurrences of each minimal subset.
fn push_subsets(text: &mut String, title: &str, occurrences: &[&Occurrence]) {
    if occurrences.is_empty() {
        return;
    }
    let _ = writeln!(text, "\n{title}");
    let _ = writeln!(text, "{:NAMES$}{:>15}{:>13}", "", "configurations", "established");
    for occurrence in occurrences {
        let (configurations, established) = (occurrence.configurations, occurrence.established);
        let name = subset(occurrence.start, occurrence.set);
        push_name(text, &name, NAMES);
        let _ = writeln!(text, "{configurations:>15}{established:>13}");
    }
}

/// Formats a subset: `camera+robot`, or `robot with camera` if the search started at robot.
pub(crate) fn subset(start: AxisSet, set: AxisSet) -> String {
    match start.is_empty() {
        true => set.to_string(),
        false => format!("{start} with {}", set.without(start)),
    }
}

fn push_configuration(text: &mut String, explained: &Explained) {
    let Explained { configuration, explanation, rollouts, .. } = explained;
    let name = explanation.transition.name();
    let rollouts = pluralise(u64::from(*rollouts), "rollout");
    let _ = writeln!(text, "{name:<12} {configuration}  {rollouts}");
    for answer in &explanation.answers {
        push_answer(text, answer, explanation.transition);
    }
    let undecided = explained
        .outcomes
        .iter()
        .filter(|outcome| matches!(outcome.verdict, Verdict::Undecided | Verdict::Quarantined));
    let undecided: Vec<&str> = undecided.map(|outcome| outcome.set.name()).collect();
    if !undecided.is_empty() {
        push_wrapped(text, "  undecided: ", &undecided.join(", "));
    }
}

fn push_answer(text: &mut String, answer: &Answer, transition: Transition) {
    let (flipped, unflipped) = match transition {
        Transition::Compensated => ("succeeds", "fails"),
        _ => ("fails", "succeeds"),
    };
    let prefix = match answer.start.is_empty() {
        true => format!("  {flipped}: "),
        false => format!("  {}, which fails alone, {flipped}: ", answer.start),
    };
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
    push_wrapped(text, &prefix, &minimal.collect::<Vec<_>>().join(", "));
    let largest: Vec<&str> = answer.largest_unflipped.iter().map(|set| set.name()).collect();
    push_wrapped(text, &format!("  still {unflipped}: "), &largest.join(", "));
    for pair in &answer.non_monotone {
        let words =
            format!("{} {flipped}, and with more axes {} {unflipped}", pair.minimal, pair.superset);
        push_wrapped(text, "  not monotone: ", &words);
    }
}
