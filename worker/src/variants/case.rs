//! A case as the simulator runs it: its files, its initial conditions, and its manifest row with
//! the prompt. `worker variants` and a campaign's slots use the same function.

use libero_ctrl::ManifestRow;
use libero_family::corruption::Corruption;
use libero_family::plus::start_posture;
use libero_family::protocol::{Beginning, Protocol};
use libero_family::{Case, Subject};
use scene::{Sources, TaskFiles};
use sim::{Start, VariantStart};

use super::error::VariantsError;

/// A rollout of LIBERO's family, ready to run.
pub struct Prepared {
    /// The task's files.
    pub files: TaskFiles,
    /// Initial conditions.
    pub start: VariantStart,
    /// Manifest row, with the prompt as its instruction.
    pub row: ManifestRow,
}

impl Prepared {
    /// Prepares the rollout of a row of LIBERO's family.
    ///
    /// # Errors
    /// If the row names no case of a benchmark, or its BDDL file cannot be read.
    pub fn new(row: &ManifestRow, sources: &Sources) -> Result<Self, VariantsError> {
        let (case, protocol) = Case::of_row(row)?;
        let files = files(&case, sources);
        let sentence = files.problem()?.language;
        let prompt = case.prompt(&protocol, Some(&sentence));
        let row = ManifestRow {
            instruction: prompt.unwrap_or(sentence),
            ..row.clone()
        };
        Ok(Self {
            files,
            start: start(&case, &protocol),
            row,
        })
    }
}

/// Returns the files of a case's task.
pub fn files(case: &Case, sources: &Sources) -> TaskFiles {
    match case.subject {
        Subject::Unperturbed => TaskFiles::of_task(sources, case.task),
        Subject::Plus(entry) => TaskFiles::of_variant(sources, &entry.variant),
        Subject::Pro(suite) => TaskFiles::of_pro_task(sources, suite, case.task),
    }
}

/// Returns the initial conditions of a case.
fn start(case: &Case, protocol: &Protocol) -> VariantStart {
    let variant = match case.subject {
        Subject::Plus(entry) => Some(entry.variant),
        _ => None,
    };
    VariantStart {
        view: variant.map(|variant| variant.view()),
        posture: variant
            .and_then(|variant| variant.robot())
            .and_then(start_posture),
        seed: protocol.seed,
        earlier_resets: u32::from(case.trial),
        start: match protocol.beginning {
            Beginning::InitialState => Start::InitialState,
            Beginning::Reset => Start::Reset,
        },
        corruption: variant
            .and_then(|variant| variant.corruption())
            .and_then(Corruption::new),
    }
}
