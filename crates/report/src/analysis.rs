//! One policy, measured: its subject, its records matched, its statistics.

use paired::{Cell, DuplicateRecord, Options, Records, Report};
use protocol::Level;

use crate::subject::Subject;
use crate::warnings;

/// One policy, measured.
#[derive(Clone, Debug)]
pub struct Analysis {
    /// What it is called in this document, unlike all others.
    pub label: String,
    /// What it is of.
    pub subject: Subject,
    /// Its outcomes, matched.
    pub records: Records,
    /// The statistics.
    pub report: Report,
}

impl Analysis {
    /// Measures a subject.
    pub(crate) fn new(label: String, subject: Subject) -> Result<Self, DuplicateRecord> {
        let records = Records::new(&subject.records)?;
        let report = paired::report_of(
            &records,
            &Options {
                notes: warnings::of_subject(&subject),
                published_nominal: subject.published_nominal,
                reported_nominal: subject.reported_nominal,
                ..Options::default()
            },
        );
        Ok(Self {
            label,
            subject,
            records,
            report,
        })
    }

    /// The cells of replicate 0, by level.
    pub fn cells(&self) -> impl Iterator<Item = &Cell> {
        self.report.cells.iter().filter(|cell| cell.replicate == 0)
    }

    /// The cell of a level in replicate 0.
    pub fn cell(&self, level: Level) -> Option<&Cell> {
        self.cells().find(|cell| cell.level == level)
    }
}
