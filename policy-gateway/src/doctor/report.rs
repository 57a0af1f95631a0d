//! Findings and differences in lines of 80 columns, and in JSON as documented in docs/JSON.md.

use policy_backends::description::DescriptionDifference;
use proto::policy::DescribeResponse;
use serde::Serialize;
use terminal::wrapped;

use crate::doctor::check::Point;
use crate::doctor::compare::Comparison;
use crate::doctor::difference::{Difference, Kind};
use crate::doctor::verdict::Finding;

/// Indentation of a finding's continuation lines, columns.
const INDENT: usize = 6;

#[derive(Clone, Debug, Serialize)]
pub struct DescribedServer {
    url: String,
    name: String,
    checkpoint: String,
}

impl DescribedServer {
    pub fn new(url: &str, described: &DescribeResponse) -> Self {
        Self {
            url: url.to_owned(),
            name: described.name.clone(),
            checkpoint: described.checkpoint.clone(),
        }
    }

    pub fn line(&self, letter: &str) -> String {
        let checkpoint = match self.checkpoint.is_empty() {
            true => String::new(),
            false => format!(", checkpoint {}", self.checkpoint),
        };
        let Self { url, name, .. } = self;
        wrapped("", INDENT, &format!("{letter} {url} ({name}{checkpoint})"))
    }
}

pub fn comparison(comparison: &Comparison) -> Vec<String> {
    let Comparison { descriptions, differences, note } = comparison;
    let mut lines: Vec<String> = descriptions.iter().map(description).collect();
    lines.extend(differences.iter().map(difference));
    if differences.is_empty() {
        let text = format!("the same observations get the same actions: {note}");
        lines.push(wrapped("pass  ", INDENT, &text));
        lines.push("the same".to_owned());
    } else {
        lines.push(wrapped("      ", INDENT, &format!("{note}.")));
        lines.push("not the same".to_owned());
    }
    lines
}

fn description(difference: &DescriptionDifference) -> String {
    let DescriptionDifference { what, a, b } = difference;
    wrapped("note  ", INDENT, &format!("{what}: A {a}; B {b}"))
}

fn difference(difference: &Difference) -> String {
    let Difference { kind, text } = difference;
    let words = format!("{}: {text} {}", kind.name(), kind.meaning());
    wrapped("FAIL  ", INDENT, &words)
}

pub fn finding(finding: &Finding) -> String {
    let text = finding.to_string();
    let (prefix, words) = text.split_at(INDENT);
    wrapped(prefix, INDENT, words)
}

#[derive(Debug, Serialize)]
pub struct ComparisonJson<'a> {
    a: DescribedServer,
    b: DescribedServer,
    is_same: bool,
    descriptions: &'a [DescriptionDifference],
    differences: Vec<DifferenceJson<'a>>,
    note: &'a str,
}

#[derive(Debug, Serialize)]
struct DifferenceJson<'a> {
    kind: Kind,
    text: &'a str,
    meaning: &'static str,
}

impl<'a> ComparisonJson<'a> {
    pub fn new(a: DescribedServer, b: DescribedServer, comparison: &'a Comparison) -> Self {
        let differences = comparison.differences.iter();
        Self {
            a,
            b,
            is_same: comparison.differences.is_empty(),
            descriptions: &comparison.descriptions,
            differences: differences
                .map(|difference| DifferenceJson {
                    kind: difference.kind,
                    text: &difference.text,
                    meaning: difference.kind.meaning(),
                })
                .collect(),
            note: &comparison.note,
        }
    }
}

#[derive(Debug, Serialize)]
pub struct CheckJson<'a> {
    url: &'a str,
    conforms: bool,
    findings: Vec<FindingJson<'a>>,
}

#[derive(Debug, Serialize)]
struct FindingJson<'a> {
    point: Point,
    verdict: &'static str,
    text: &'a str,
}

impl<'a> CheckJson<'a> {
    pub fn new(url: &'a str, findings: &'a [Finding]) -> Self {
        let finding = |finding: &'a Finding| {
            let (verdict, text) = finding.verdict.parts();
            FindingJson { point: finding.point, verdict, text }
        };
        let findings: Vec<FindingJson<'a>> = findings.iter().map(finding).collect();
        Self { url, conforms: findings.iter().all(|finding| finding.verdict != "fail"), findings }
    }
}
