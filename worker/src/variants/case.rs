//! A case as the simulator runs it: its files, its initial conditions, and its manifest row with
//! the prompt. `worker rollout` and the slots of a campaign both prepare their cases here.

use std::fs;
use std::path::Path;

use benchmark::family::corruption::Corruption;
use benchmark::family::plus::View;
use benchmark::family::protocol::{Beginning, Benchmark, Protocol};
use benchmark::family::{Case, SelectionError};
use benchmark::{ManifestRow, OwnTask, RolloutId, SuiteFile};
use scene::{SceneError, Sources, TaskFiles};
use sim::{Start, VariantStart};

use super::error::VariantsError;

/// A rollout of LIBERO's family or of a suite file, ready to run.
pub struct Prepared {
    pub files: TaskFiles,
    pub start: VariantStart,
    /// Manifest row, with the prompt as its instruction.
    pub row: ManifestRow,
}

impl Prepared {
    /// Prepares the rollout of a row of LIBERO's family or of a suite file.
    ///
    /// # Errors
    /// If the BDDL file has the prompt and cannot be read.
    pub fn new(row: &ManifestRow, own: &OwnTask, sources: &Sources) -> Result<Self, SceneError> {
        let with_prompt = TaskFiles::with_prompt(sources, own);
        let instruction = match (row.instruction.is_empty(), &own.sentence) {
            (false, _) => row.instruction.clone(),
            (true, Some(_)) => with_prompt.sentence()?,
            // No policy is ever sent an empty instruction.
            (true, None) => with_prompt.instruction()?,
        };
        let row = ManifestRow { instruction, ..row.clone() };
        let (files, start) = (TaskFiles::of_own(sources, own), start(own, row.init_id));
        Ok(Self { files, start, row })
    }
}

/// Returns the row of a rollout of LIBERO-Plus, LIBERO-PRO or LIBERO-Para under a protocol, by
/// default the benchmark's official one.
///
/// # Errors
/// If no benchmark has the rollout, or the protocol is another benchmark's.
pub fn row(
    id: RolloutId,
    benchmark: Benchmark,
    protocol: Option<Protocol>,
) -> Result<ManifestRow, SelectionError> {
    let case = Case::of_id(id)?;
    let protocol = protocol.unwrap_or(Protocol::official(benchmark));
    protocol.check(benchmark)?;
    Ok(case.row(&protocol))
}

/// Reads a suite file.
///
/// # Errors
/// If the file cannot be read or is invalid.
pub fn read_suite_file(path: &Path) -> Result<SuiteFile, VariantsError> {
    let path = || path.to_owned();
    let text = fs::read_to_string(path());
    let text = text.map_err(|source| VariantsError::File { path: path(), source })?;
    let file = SuiteFile::from_json(&text);
    file.map_err(|source| VariantsError::SuiteFile { path: path(), source })
}

/// Returns the initial conditions of a task. As in the harnesses of LIBERO, the
/// generator is seeded once and the environment reset for every trial.
fn start(own: &OwnTask, trial: u16) -> VariantStart {
    let changes = &own.changes;
    let view = |[horizontal, vertical, scale, pan, tilt]: [u16; 5]| View {
        horizontal,
        vertical,
        scale,
        pan,
        tilt,
    };
    VariantStart {
        view: changes.view.map(view),
        posture: changes.posture,
        seed: own.seed,
        earlier_resets: u32::from(trial),
        start: match own.start {
            Beginning::InitialState => Start::InitialState,
            Beginning::Reset => Start::Reset,
        },
        corruption: changes.noise.and_then(Corruption::new),
    }
}
