//! A case as the simulator runs it: its files, its initial conditions, and its manifest row with
//! the prompt. `worker rollout` and the slots of a campaign both prepare their cases here.

use std::fs;
use std::path::Path;

use benchmark::family::corruption::Corruption;
use benchmark::family::plus::{View, start_posture};
use benchmark::family::protocol::{Beginning, Benchmark, Protocol};
use benchmark::family::{Case, SelectionError, Subject};
use benchmark::{ManifestRow, OwnTask, RolloutId, SuiteFile};
use scene::{Sources, TaskFiles};
use sim::{Start, VariantStart};

use super::error::VariantsError;

/// A rollout of LIBERO's family or of a suite file, ready to run.
pub struct Prepared {
    /// The task's files.
    pub files: TaskFiles,
    /// Initial conditions.
    pub start: VariantStart,
    /// Manifest row, with the prompt as its instruction.
    pub row: ManifestRow,
}

impl Prepared {
    /// Prepares the rollout of a row of LIBERO's family or of a suite file.
    ///
    /// # Errors
    /// If the row names no case of a benchmark, or its BDDL file cannot be read.
    pub fn new(row: &ManifestRow, sources: &Sources) -> Result<Self, VariantsError> {
        let (files, sentence) = files_and_sentence(row, sources)?;
        let (prompt, start) = match &row.own {
            Some(own) => {
                let prompt = Some(row.instruction.clone()).filter(|prompt| !prompt.is_empty());
                (prompt, start_of_own(own, row.init_id))
            }
            None => {
                let (case, protocol) = Case::of_row(row)?;
                let prompt = case.prompt(&protocol, Some(&sentence));
                (prompt, start(&case, &protocol))
            }
        };
        let instruction = prompt.unwrap_or(sentence);
        // No policy is ever sent an empty instruction.
        let instruction = match instruction.is_empty() {
            true => files.instruction()?,
            false => instruction,
        };
        let row = ManifestRow { instruction, ..row.clone() };
        Ok(Self { files, start, row })
    }
}

/// Returns the files that are simulated, and the sentence of the row's BDDL file. The rollouts of
/// LIBERO-Para are simulated from LIBERO's own files, which differ in the sentence only, so that all
/// sentences of a task share a compiled scene.
fn files_and_sentence(
    row: &ManifestRow,
    sources: &Sources,
) -> Result<(TaskFiles, String), VariantsError> {
    let files = files(row, sources)?;
    match row.id.variant().and_then(|name| name.benchmark()) {
        Some(Benchmark::Para) => {
            let sentence = files.sentence()?;
            Ok((TaskFiles::of_task(sources, row.id.task()), sentence))
        }
        _ => {
            let sentence = files.problem()?.language;
            Ok((files, sentence))
        }
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

/// Returns the rows of a suite file, with `trials` in place of its own number of trials if given.
///
/// # Errors
/// If the file cannot be read or is invalid.
pub fn rows_of_file(path: &Path, trials: Option<u16>) -> Result<Vec<ManifestRow>, VariantsError> {
    let path = || path.to_owned();
    let text = fs::read_to_string(path());
    let text = text.map_err(|source| VariantsError::File { path: path(), source })?;
    let file = SuiteFile::from_json(&text);
    let mut file = file.map_err(|source| VariantsError::SuiteFile { path: path(), source })?;
    file.trials = trials.unwrap_or(file.trials);
    Ok(file.rows())
}

/// Returns the files of a row's task.
///
/// # Errors
/// If the row names no case of a benchmark.
pub fn files(row: &ManifestRow, sources: &Sources) -> Result<TaskFiles, SelectionError> {
    if let Some(own) = &row.own {
        return Ok(TaskFiles::of_suite_file(sources, own));
    }
    let (case, _) = Case::of_row(row)?;
    Ok(match case.subject {
        Subject::Unperturbed | Subject::Own(_) => TaskFiles::of_task(sources, case.task),
        Subject::Plus(entry) => TaskFiles::of_variant(sources, &entry.variant),
        Subject::Pro(suite) => TaskFiles::of_pro_task(sources, suite, case.task),
        Subject::Para(paraphrase) => TaskFiles::of_paraphrase(sources, paraphrase),
    })
}

/// Returns the initial conditions of a suite file's task. As in the harnesses of LIBERO, the
/// generator is seeded once and the environment reset for every trial.
fn start_of_own(own: &OwnTask, trial: u16) -> VariantStart {
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
        start: reset_or_state(own.start),
        corruption: changes.noise.and_then(Corruption::new),
    }
}

fn reset_or_state(beginning: Beginning) -> Start {
    match beginning {
        Beginning::InitialState => Start::InitialState,
        Beginning::Reset => Start::Reset,
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
        posture: variant.and_then(|variant| variant.robot()).and_then(start_posture),
        seed: protocol.seed,
        earlier_resets: u32::from(case.trial),
        start: reset_or_state(protocol.beginning),
        corruption: variant.and_then(|variant| variant.corruption()).and_then(Corruption::new),
    }
}
