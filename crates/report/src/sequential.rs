//! Confidence sequences of a campaign that may end early, valid at any look, and the
//! rollouts that an early end saved.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Clause, Level, Measure, StopRule, Strata};
use paired::{CampaignLook, DuplicateRecord, Finding, FindingKind, Outcome, Records};
use serde::Serialize;

use crate::subject::{EarlyStop, Subject};

/// The confidence sequences of a campaign: at the look at which it stopped early, or over all
/// outcomes so far if it has not stopped.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sequential {
    pub rule: StopRule,
    /// Seed of the drawn order of the configurations.
    pub seed: u64,
    /// Strata of the order: each round has one configuration of each stratum.
    pub strata: Strata,
    pub has_stopped: bool,
    /// Configurations of the campaign: the population of the intervals.
    pub configurations: usize,
    /// Number of configurations from which the intervals are computed: the first in the drawn
    /// order.
    pub used: usize,
    pub rollouts: usize,
    /// Rollouts that were not run because the campaign stopped early.
    pub saved: usize,
    /// Interval by level and measure, fractions.
    pub levels: BTreeMap<Level, BTreeMap<Measure, [f64; 2]>>,
    /// Point estimates by level and measure, with strata weighted by their share of the
    /// intervals' population; only for levels with a known outcome in every stratum.
    pub estimates: BTreeMap<Level, BTreeMap<Measure, f64>>,
    /// Measures whose estimates are overstated, because the campaign ended as soon as the
    /// interval of the measure excluded a value. The end of the interval that is nearest to
    /// this value bounds the overstatement.
    pub overstated: BTreeSet<Measure>,
}

/// Describes an early stop: after how many configurations, by which rule, and how many
/// rollouts it saved.
pub fn describe_early_stop(
    [used, configurations]: [u64; 2],
    rule: &str,
    [saved, rollouts]: [u64; 2],
) -> String {
    let percent = (saved * 100).checked_div(rollouts).unwrap_or_default();
    format!(
        "stopped early after {used} of {configurations} configurations: {rule}; saved {saved} \
         rollouts ({percent} %)"
    )
}

impl Sequential {
    /// Computes the sequences; `None` if the campaign has no rule for ending early, or no
    /// configuration at a level other than L0.
    pub(crate) fn from_subject(subject: &Subject) -> Result<Option<Self>, DuplicateRecord> {
        let Some(EarlyStop { stop, has_stopped }) = &subject.early_stop else {
            return Ok(None);
        };
        let records = Records::new(&subject.records)?;
        let stopped = match has_stopped {
            true => CampaignLook::when_met(&records, stop),
            false => None,
        };
        let look = stopped.or_else(|| CampaignLook::now(&records, stop));
        let missing = subject.records.iter();
        let missing = missing.filter(|record| record.outcome == Outcome::Missing);
        Ok(look.map(|look| Self {
            estimates: look.estimates(&records, stop),
            overstated: match has_stopped {
                true => excluded(&stop.rule),
                false => BTreeSet::new(),
            },
            rule: stop.rule.clone(),
            seed: stop.seed,
            strata: stop.strata,
            has_stopped: *has_stopped,
            configurations: look.units,
            used: look.used.len(),
            rollouts: subject.records.len(),
            saved: match has_stopped {
                true => missing.count(),
                false => 0,
            },
            levels: look
                .levels
                .into_iter()
                .map(|(level, look)| {
                    let intervals = look.intervals.into_iter();
                    let intervals = intervals
                        .map(|(measure, interval)| (measure, [interval.low(), interval.high()]));
                    (level, intervals.collect())
                })
                .collect(),
        }))
    }

    /// Returns the findings that are valid at any look, which replace those of a fixed sample: by
    /// level, the intervals of simultaneous success and of the net effect of simultaneity.
    pub(crate) fn findings(&self) -> Vec<Finding> {
        let levels = self.levels.iter().filter_map(|(&level, measures)| {
            let [success, net] = [Measure::SSim, Measure::I].map(|measure| measures.get(&measure));
            let percent = |value: f64| format!("{:.1}", 100.0 * value);
            let [[low, high], [least, most]] = [*success?, *net?].map(|ends| ends.map(percent));
            Some(Finding {
                kind: FindingKind::Simultaneity,
                level,
                claims: false,
                holm_p: None,
                sentence: format!(
                    "At {level}, {low} to {high} % of the campaign's {} configurations succeed \
                     under simultaneous perturbation, and the net effect of simultaneity on them \
                     is {least} to {most} points: these confidence sequences are valid at any \
                     look, and for these configurations only.",
                    self.configurations
                ),
            })
        });
        levels.collect()
    }

    /// Returns the warning that the campaign stopped early or may still do so; `None` if it did not
    /// stop and all configurations are complete.
    pub(crate) fn warning(&self) -> Option<String> {
        if self.has_stopped {
            let configurations = [self.used as u64, self.configurations as u64];
            let rollouts = [self.saved as u64, self.rollouts as u64];
            return Some(format!(
                "{}; other figures cover these {} configurations only, and their bootstrap \
                 intervals and p-values are not valid, because they assume a sample size fixed in advance: \
                 use the confidence sequences, whose estimates weight suites as the campaign does. \
                 Other rates weight suites by the number of drawn configurations{}",
                describe_early_stop(configurations, &self.rule.to_string(), rollouts),
                self.used,
                self.overstatement_clause()
            ));
        }
        (self.used < self.configurations).then(|| {
            format!(
                "the campaign ends early once {}: until it ends, use the confidence sequences; \
                 bootstrap intervals and p-values assume a sample size fixed in advance",
                self.rule
            )
        })
    }

    /// Returns the clause of the warning about overstated measures; empty without such measures.
    fn overstatement_clause(&self) -> String {
        let names: Vec<&str> = self.overstated.iter().map(|measure| measure.name()).collect();
        match names.as_slice() {
            [] => String::new(),
            names => format!(
                "; estimates of {} are overstated in all of this report, because the campaign \
                 ended when they were large",
                names.join(", ")
            ),
        }
    }

    /// Returns the explanation of the star; empty if no estimate has one.
    fn star_explanation(&self) -> &'static str {
        let measures = self.levels.values().flat_map(BTreeMap::keys);
        match measures.copied().any(|measure| self.overstated.contains(&measure)) {
            true => {
                ". An estimate marked * is overstated, because the campaign ended when it was \
                 large; the end of its interval that is nearest to the excluded value bounds it"
            }
            false => "",
        }
    }

    /// Returns a definition of the intervals and their population.
    pub(crate) fn explanation(&self) -> String {
        format!(
            "Confidence sequences: at each level, they hold together at all looks with a \
             probability of 95 %, whichever rule ends the campaign. They concern all {} configurations, and are \
             computed from the first {} configurations in the order of seed {} (rounds of {}). The \
             estimates beside them weight suites or tasks as in that population{}",
            self.configurations,
            self.used,
            self.seed,
            self.strata.name(),
            self.star_explanation()
        )
    }
}

/// Returns the measures that end a campaign by excluding a value.
fn excluded(rule: &StopRule) -> BTreeSet<Measure> {
    let clauses = rule.clauses().iter();
    let clauses = clauses.filter(|clause| !matches!(clause, Clause::Width(..)));
    clauses.map(Clause::measure).collect()
}
