//! The analysis of one policy: its subject, its matched records and its statistics, or
//! the findings of a campaign that is derived from another.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Condition, Level, RolloutId};
use paired::{Cell, DuplicateRecord, Matched, Options, Progress, Record, Records, Report};

use crate::block::Section;
use crate::explanation::Findings;
use crate::figures::Link;
use crate::interactions::AxisInteractions;
use crate::sequential::Sequential;
use crate::subject::Subject;
use crate::threshold_report::ThresholdReport;
use crate::warnings;

#[derive(Clone, Debug)]
pub struct Analysis {
    /// Name of the policy, unique in this document.
    pub label: String,
    /// Subject: the outcomes and their provenance.
    pub subject: Subject,
    /// Matched outcomes. If the campaign stopped early, only the configurations from which its
    /// confidence sequences are computed. Empty for a derived campaign.
    pub records: Records,
    /// Records from which the figures are computed; `None` if these are all records of the subject.
    counted: Option<Vec<Record>>,
    /// Progress of the rollouts, by replicate and id.
    progress: BTreeMap<(u32, RolloutId), Progress>,
    /// Confidence sequences; `None` if the campaign has no rule for ending early.
    pub sequential: Option<Sequential>,
    /// The statistics. They are empty for a derived campaign, which runs only some of the
    /// rollouts of each configuration.
    pub report: Report,
    /// Explanations of another campaign's transitions, if this campaign explains them.
    pub findings: Option<Findings>,
    /// Thresholds of another campaign, if this campaign measures them.
    pub thresholds: Option<ThresholdReport>,
    /// Interactions of the axes; `None` if no configuration has an outcome under every subset.
    pub interactions: Option<AxisInteractions>,
}

impl Analysis {
    /// Computes the statistics of a subject.
    pub(crate) fn new(label: String, subject: Subject) -> Result<Self, DuplicateRecord> {
        let sequential = Sequential::from_subject(&subject)?;
        let counted = match subject.counted() {
            Cow::Owned(counted) => Some(counted),
            Cow::Borrowed(_) => None,
        };
        let mut records = Records::new(counted.as_deref().unwrap_or(&subject.records))?;
        let mut notes = warnings::subject_warnings(&subject);
        let warning = sequential.as_ref().and_then(Sequential::warning);
        let is_interim = warning.is_some();
        notes.splice(0..0, warning);
        let findings = Findings::of(&subject).unwrap_or_else(|error| {
            notes.push(error.to_string());
            None
        });
        let mut report = paired::report_of(
            &records,
            &Options {
                notes,
                published_nominal: subject.published_nominal,
                published_by_suite: subject.published_by_suite.clone(),
                reported_nominal: subject.reported_nominal,
                directions: subject.directions,
                overstated: sequential
                    .as_ref()
                    .map_or_else(BTreeSet::new, |sequential| sequential.overstated.clone()),
                ..Options::default()
            },
        );
        if let Some(sequential) = sequential.as_ref().filter(|_| is_interim) {
            report.findings = sequential.findings();
        }
        if subject.derived.is_some() {
            records = Records::default();
            report = Report {
                axes: Vec::new(),
                nominal: None,
                cells: Vec::new(),
                by_task: Vec::new(),
                flips: BTreeMap::new(),
                components: Vec::new(),
                findings: Vec::new(),
                ..report
            };
        }
        Ok(Self {
            label,
            interactions: AxisInteractions::of(&subject).ok(),
            thresholds: ThresholdReport::of(&subject),
            progress: subject
                .progress
                .iter()
                .map(|progress| ((progress.replicate, progress.id), *progress))
                .collect(),
            subject,
            records,
            counted,
            sequential,
            report,
            findings,
        })
    }

    /// Returns true if the campaign runs whole configurations, which can be paired, that is, if
    /// it is not derived from another campaign.
    pub fn is_paired(&self) -> bool {
        self.subject.derived.is_none()
    }

    /// Returns the sections on what a derived campaign found; none for any other campaign.
    pub(crate) fn derived<'a>(&'a self, link: Option<Link<'a>>) -> Vec<Section<'a>> {
        let findings = self.findings.iter().flat_map(|findings| findings.sections(link));
        let thresholds = self.thresholds.iter().map(ThresholdReport::section);
        findings.chain(thresholds).collect()
    }

    /// Returns the records from which the figures are computed.
    pub(crate) fn counted(&self) -> &[Record] {
        self.counted.as_deref().unwrap_or(&self.subject.records)
    }

    /// Returns the progress of a configuration's rollout under a condition; `None` if unknown.
    pub(crate) fn progress(&self, matched: &Matched, condition: Condition) -> Option<&Progress> {
        let id = match condition {
            Condition::Nominal => RolloutId::nominal(matched.task, matched.init_id),
            _ => {
                let Matched { task, level, config, .. } = *matched;
                RolloutId::perturbed(task, condition, level, config).ok()?
            }
        };
        self.progress.get(&(matched.replicate, id))
    }

    /// Returns the cell of a level.
    pub fn cell(&self, level: Level) -> Option<&Cell> {
        self.report.cells.iter().find(|cell| cell.level == level)
    }
}
