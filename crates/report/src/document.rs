//! A report on one or several policies, and its forms for a terminal and for
//! programs.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

use benchmark::{Execution, JsonError, Level};
use paired::{DuplicateRecord, Measures, Report, SuiteRow};
use serde::Serialize;

use crate::analysis::Analysis;
use crate::block::{self, Block, push_wrapped};
use crate::comparison::{Comparison, Unpairable};
use crate::comparison_tables;
use crate::explanation::Findings;
use crate::family::{Family, FamilyError};
use crate::interactions::AxisInteractions;
use crate::page;
use crate::paper;
use crate::sequential::Sequential;
use crate::subject::{Origin, Quarantined, Subject, agree, pluralise};
use crate::tables;
use crate::threshold_report::ThresholdReport;
use crate::warnings;

/// Largest number of quarantined rollouts that are named; further ones are only counted.
const MAX_NAMED: usize = 6;

/// A report: the analyses of one or several policies.
#[derive(Clone, Debug)]
pub struct Document {
    /// Warnings about comparing the policies, to be read first.
    pub warnings: Vec<String>,
    /// Analyses, one per subject, in the given order.
    pub analyses: Vec<Analysis>,
    /// Results of a campaign of LIBERO's family or of a suite file, by dimension, suite, or type of
    /// paraphrase.
    /// Reports show them instead of the measures of LIBERO-CTRL.
    pub family: Option<Family>,
    /// Comparisons of all pairs, computed when first read.
    comparisons: OnceLock<Vec<Result<Comparison, Unpairable>>>,
}

/// Failure to build or write a report.
#[derive(Debug, thiserror::Error)]
pub enum DocumentError {
    #[error("measure policy `{policy}`")]
    Duplicate { policy: String, source: DuplicateRecord },
    /// A campaign of LIBERO's family or of a suite file has a variant or protocol that this program
    /// does not know.
    #[error(transparent)]
    Family(#[from] FamilyError),
    /// Rollouts of LIBERO's family or of a suite file are reported together with other subjects, or
    /// lack their protocol.
    #[error(
        "report on policy `{policy}`: its rollouts are of LIBERO's family or of a suite file, and \
         such rollouts are never pooled with others; report on one campaign alone, or on one file \
         of its exported rows with their `protocol`"
    )]
    Pooled { policy: String },
    #[error("write the report as JSON")]
    Json(#[from] JsonError),
}

/// The JSON form: warnings, then the measures by policy and level, then the whole reports.
#[derive(Serialize)]
struct JsonForm<'a> {
    warnings: &'a [String],
    /// Measures of all replicates; null if no configuration is complete.
    paired: BTreeMap<&'a str, BTreeMap<Level, Option<&'a Measures>>>,
    reports: Vec<JsonReport<'a>>,
}

#[derive(Serialize)]
struct JsonReport<'a> {
    label: &'a str,
    policy: &'a str,
    origin: &'a Origin,
    realisation: Option<&'a str>,
    placebo_radius: Option<f64>,
    execution: &'a Execution,
    errors: &'a [Quarantined],
    #[serde(skip_serializing_if = "Option::is_none")]
    sequential: Option<&'a Sequential>,
    #[serde(flatten)]
    report: &'a Report,
    /// Success by suite and in all, under every condition at every level.
    success: Vec<SuiteRow>,
    /// In the form of `explain --json`.
    explanation: Option<&'a Findings>,
    /// In the form of `thresholds --json`.
    thresholds: Option<&'a ThresholdReport>,
    /// In the form of `interactions --json`.
    interactions: Option<&'a AxisInteractions>,
}

/// The JSON form of a campaign of LIBERO's family or of a suite file.
#[derive(Serialize)]
struct FamilyForm<'a> {
    warnings: Vec<&'a String>,
    origin: &'a Origin,
    errors: &'a [Quarantined],
    family: &'a Family,
}

impl Document {
    /// Analyses the subjects.
    pub fn new(subjects: Vec<Subject>) -> Result<Self, DocumentError> {
        let is_pooled = |subject: &&Subject| {
            let mut records = subject.records.iter();
            let is_of_family = records.any(|record| record.id.variant().is_some());
            is_of_family && (subjects.len() > 1 || subject.protocol.is_none())
        };
        if let Some(subject) = subjects.iter().find(is_pooled) {
            let policy = subject.policy.clone();
            return Err(DocumentError::Pooled { policy });
        }
        let family = match subjects.first() {
            Some(subject) => Family::of(subject)?,
            None => None,
        };
        let warnings = warnings::comparison_warnings(&subjects);
        let labels = labels(&subjects);
        let analyses = labels.into_iter().zip(subjects);
        let analyses = analyses.map(|(label, subject)| {
            let duplicate = |source| DocumentError::Duplicate { policy: label.clone(), source };
            Analysis::new(label.clone(), subject).map_err(duplicate)
        });
        let analyses = analyses.collect::<Result<_, _>>()?;
        Ok(Self { warnings, analyses, family, comparisons: OnceLock::new() })
    }

    /// Compares every policy with every later one.
    pub fn comparisons(&self) -> &[Result<Comparison, Unpairable>] {
        self.comparisons.get_or_init(|| {
            let pairs = self.analyses.iter().enumerate().flat_map(|(index, a)| {
                let later = self.analyses[index + 1..].iter();
                later.map(move |b| Comparison::of([a, b], [&a.subject.setups, &b.subject.setups]))
            });
            pairs.collect()
        })
    }

    /// Writes the comparisons of all pairs for a terminal of 80 columns.
    pub fn pairs(&self) -> String {
        let mut text = String::new();
        push_warnings(&mut text, &self.all_warnings());
        block::push_text(&mut text, &comparison_tables::pairs(self.comparisons()));
        text
    }

    /// Writes success, paired measures and differences between policies as LaTeX.
    pub fn latex(&self) -> String {
        let mut blocks = Vec::new();
        for section in self.analyses.iter().flat_map(|analysis| analysis.derived(None)) {
            blocks.extend(section.blocks);
        }
        if self.analyses.iter().any(Analysis::is_paired) {
            blocks.extend(page::overview(self, true));
            blocks.push(Block::Table(tables::complete(&self.analyses)));
            blocks.push(Block::Table(paper::table(self)));
            blocks.extend(comparison_tables::pairs(self.comparisons()));
        }
        block::latex(&blocks)
    }

    /// Returns the label and the measures of each policy with complete configurations at a
    /// level.
    pub(crate) fn paired(&self, level: Level) -> Vec<(&str, &Measures)> {
        let policies = self.analyses.iter().filter_map(|analysis| {
            let measures = analysis.cell(level)?.paired.as_ref()?;
            Some((analysis.label.as_str(), measures))
        });
        policies.collect()
    }

    /// Writes the report as JSON, several lines.
    pub fn json(&self) -> Result<String, DocumentError> {
        if let (Some(family), [analysis]) = (&self.family, self.analyses.as_slice()) {
            let text = serde_json::to_string_pretty(&FamilyForm {
                warnings: self.notes().collect(),
                origin: &analysis.subject.origin,
                errors: &analysis.subject.errors,
                family,
            });
            return Ok(text.map_err(JsonError::from)?);
        }
        let paired = self.analyses.iter().map(|analysis| {
            let levels =
                analysis.report.cells.iter().map(|cell| (cell.level, cell.paired.as_ref()));
            (analysis.label.as_str(), levels.collect())
        });
        let reports = self.analyses.iter().map(|analysis| JsonReport {
            label: &analysis.label,
            policy: &analysis.subject.policy,
            origin: &analysis.subject.origin,
            realisation: analysis.subject.realisation.map(|r| r.name()),
            placebo_radius: analysis.subject.placebo_radius,
            execution: &analysis.subject.execution,
            errors: &analysis.subject.errors,
            sequential: analysis.sequential.as_ref(),
            report: &analysis.report,
            success: analysis.report.suite_rows(),
            explanation: analysis.findings.as_ref(),
            thresholds: analysis.thresholds.as_ref(),
            interactions: analysis.interactions.as_ref(),
        });
        let text = serde_json::to_string_pretty(&JsonForm {
            warnings: &self.warnings,
            paired: paired.collect(),
            reports: reports.collect(),
        });
        Ok(text.map_err(JsonError::from)?)
    }

    /// Returns the warnings about the outcomes of each policy.
    fn notes(&self) -> impl Iterator<Item = &String> {
        let analyses = self.analyses.iter();
        analyses.flat_map(|analysis| &analysis.report.notes)
    }

    /// Returns all warnings, to be read first.
    pub(crate) fn all_warnings(&self) -> Vec<String> {
        let several = self.analyses.len() > 1;
        let of_policies = self.analyses.iter().flat_map(|analysis| {
            let prefix = if several { format!("`{}`: ", analysis.label) } else { String::new() };
            self.warnings_of(analysis).map(move |note| format!("{prefix}{note}"))
        });
        self.warnings.iter().cloned().chain(of_policies).collect()
    }

    /// Returns the warnings about the outcomes of a policy, and about its quarantined rollouts.
    fn warnings_of(&self, analysis: &Analysis) -> impl Iterator<Item = String> + use<> {
        let quarantined = quarantined(&analysis.report.quarantined);
        let quarantined = quarantined.filter(|_| self.family.is_none());
        analysis.report.notes.clone().into_iter().chain(quarantined)
    }

    /// Writes a short report for a terminal of 80 columns: success by condition, and
    /// findings as sentences.
    pub fn brief(&self) -> String {
        let mut text = String::new();
        if let Some(family) = &self.family {
            push_warnings(&mut text, &self.all_warnings());
            text.push_str(&family.brief());
            return text;
        }
        push_warnings(&mut text, &self.warnings);
        for analysis in &self.analyses {
            text.push_str(&title(&analysis.subject));
            push_warnings(&mut text, &self.warnings_of(analysis).collect::<Vec<_>>());
            let derived = analysis.derived(None);
            if !derived.is_empty() {
                block::push_text(&mut text, derived.iter().flat_map(|section| &section.blocks));
            }
        }
        if self.analyses.iter().any(Analysis::is_paired) {
            block::push_text(&mut text, &page::overview(self, false));
            text.push('\n');
            push_wrapped(
                &mut text,
                "",
                "`--full` prints the paired measures with their intervals, and the meaning of each \
                 symbol; `--html FILE` writes a page with figures, `--table FILE.csv` the outcomes.",
            );
        }
        text
    }

    /// Writes the whole report for a terminal of 80 columns.
    pub fn text(&self) -> String {
        let mut text = String::new();
        push_warnings(&mut text, &self.warnings);
        for analysis in &self.analyses {
            text.push_str(&title(&analysis.subject));
        }
        text.push('\n');
        push_warnings(&mut text, &self.all_warnings()[self.warnings.len()..]);
        let title = self.family.as_ref().map(|family| Block::Heading(family.heading()));
        let sections = page::of_document(self, None);
        let sections = sections.open.iter().chain(&sections.folded);
        let blocks = sections.flat_map(|section| &section.blocks);
        block::push_text(&mut text, title.iter().chain(blocks));
        text
    }
}

/// Names some of the quarantined rollouts; `None` if there are none.
fn quarantined(names: &[String]) -> Option<String> {
    let named = names[..names.len().min(MAX_NAMED)].join(", ");
    let more = match names.len().saturating_sub(MAX_NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let count = names.len() as u64;
    (count > 0).then(|| {
        format!(
            "{} {} in quarantine (failed too often, or skipped) and in no rate: {named}{more}",
            pluralise(count, "rollout"),
            agree(count, "is", "are")
        )
    })
}

/// Appends warnings, and an empty line below them.
pub(crate) fn push_warnings<'a>(text: &mut String, warnings: impl IntoIterator<Item = &'a String>) {
    let length = text.len();
    for warning in warnings {
        push_wrapped(text, "! ", warning);
    }
    if text.len() > length {
        text.push('\n');
    }
}

/// Returns a unique label per policy: its name, with its origin if two names are equal,
/// and with a number if the origins are equal too.
fn labels(subjects: &[Subject]) -> Vec<String> {
    let mut labels: Vec<String> = Vec::new();
    let mut used = BTreeSet::new();
    for subject in subjects {
        let namesakes = subjects.iter().filter(|other| other.policy == subject.policy);
        let mut label = match namesakes.count() {
            1 => subject.policy.clone(),
            _ => format!("{} ({})", subject.policy, subject.origin_name()),
        };
        let base = label.clone();
        for number in 2.. {
            if used.insert(label.clone()) {
                break;
            }
            label = format!("{base} {number}");
        }
        labels.push(label);
    }
    labels
}

/// Returns a heading with the campaign or file and the policy.
fn title(subject: &Subject) -> String {
    let mut text = String::new();
    let line = match &subject.origin {
        Origin::Campaign { name, endpoint, .. } => {
            format!("campaign {name}, policy {} at {endpoint}", subject.policy)
        }
        Origin::File { name, .. } => format!("policy {}, results of {name}", subject.policy),
    };
    push_wrapped(&mut text, "", &line);
    text
}
