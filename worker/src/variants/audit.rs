//! Checks which of the chosen variants have all their files.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::{fmt, fs};

use benchmark::family::plus::{Assets, Entry};
use benchmark::family::protocol::Benchmark;
use benchmark::family::{Case, Further, Lack, Lacking, Subject};
use benchmark::presets::ENV_SEED;
use benchmark::{ManifestRow, OwnTask, Suite};
use scene::assets::Table;
use scene::catalog::category;
use scene::{
    AssetPack, InitialStates, SceneError, Sources, TaskFiles, check_goal, compose, needed_files,
};
use sha2::{Digest, Sha256};

use super::error::VariantsError;

/// Chosen rollouts, each with its row and the reason why it cannot run, if any.
pub struct Audit(Vec<(Case, ManifestRow, Option<Lack>)>);

impl Audit {
    /// Checks which rollouts have all their files.
    ///
    /// # Errors
    /// If an existing file cannot be read.
    pub fn new(
        rollouts: Vec<(Case, ManifestRow)>,
        pack: &AssetPack,
        sources: &Sources,
    ) -> Result<Self, VariantsError> {
        let mut audited = Vec::with_capacity(rollouts.len());
        // All trials of a task need the same files.
        let mut last: Option<(Case, Checked)> = None;
        for (case, row) in rollouts {
            let known = last.take().filter(|(known, _)| have_the_same_files(known, &case));
            let checked = match known {
                Some((_, checked)) => checked,
                None => Checked::new(&row, pack, sources)?,
            };
            audited.push((case, row, checked.lack(case.trial)));
            last = Some((case, checked));
        }
        Ok(Self(audited))
    }

    fn lacking(&self) -> Lacking {
        let mut lacking = Lacking::default();
        for (case, _, lack) in &self.0 {
            if let Some(lack) = lack {
                lacking.add(lack.clone(), *case);
            }
        }
        lacking
    }

    /// Formats a table of the rollouts by [`Case::group`], followed by the missing files.
    pub fn report(&self) -> String {
        let mut counts: BTreeMap<String, [usize; 2]> = BTreeMap::new();
        for (case, _, lack) in &self.0 {
            let counts = counts.entry(case.group().unwrap_or_default()).or_default();
            counts[0] += 1;
            counts[1] += usize::from(lack.is_none());
        }
        let mut text = format!("{:<32}{:>9}{:>9}\n", "", "rollouts", "can run");
        let total = (
            "all".to_owned(),
            [self.0.len(), self.0.iter().filter(|(.., lack)| lack.is_none()).count()],
        );
        for (name, [all, runnable]) in counts.into_iter().chain([total]) {
            let _ = writeln!(text, "{name:<32}{all:>9}{runnable:>9}");
        }
        let lacking = self.lacking();
        if lacking.count() > 0 {
            let _ = write!(text, "Missing:\n{lacking}\n");
        }
        text
    }

    /// Formats a line per rollout, separated by tabs: suite, name, group, difficulty, files needed
    /// beyond LIBERO's assets, and whether the rollout can run.
    pub fn list(&self) -> String {
        let mut text = String::new();
        for (case, row, lack) in &self.0 {
            let difficulty = case.difficulty().map(|difficulty| difficulty.to_string());
            let state = lack.as_ref().map_or("runs".to_owned(), |lack| format!("lacks {lack}"));
            let _ = writeln!(
                text,
                "{}\t{}\t{}\t{}\t{}\t{state}",
                row.id.suite_name(),
                case.name(),
                case.group().unwrap_or_default(),
                difficulty.as_deref().unwrap_or("-"),
                needs(case, row),
            );
        }
        text
    }
}

/// Lists the files of LIBERO-Plus' archive that a variant needs, or the task files of a suite file.
fn needs(case: &Case, row: &ManifestRow) -> String {
    if let (Subject::Own(_), Some(own)) = (case.subject, &row.own) {
        let OwnTask { folder, bddl, states, .. } = &**own;
        return format!("{folder}/{bddl} {folder}/{states}");
    }
    let Subject::Plus(Entry { class: Some(class), .. }) = case.subject else {
        return "-".to_owned();
    };
    let styles = [&class.floor, &class.wall].into_iter().flatten();
    let textures = styles.map(|style| format!("textures/{}", style.file));
    let files = class.scene.iter().cloned().chain(textures);
    files.collect::<Vec<_>>().join(" ")
}

/// Returns true if two cases are of the same task of LIBERO-PRO or of a suite file, and so have the
/// same files.
fn have_the_same_files(first: &Case, second: &Case) -> bool {
    let has_trials = matches!(first.subject, Subject::Pro(_) | Subject::Own(_));
    has_trials && first.task == second.task && first.subject == second.subject
}

/// Returns the reason why a rollout cannot run; `None` if all its files exist.
///
/// # Errors
/// If the row names no case of a benchmark, or an existing file cannot be read.
pub fn lack(
    row: &ManifestRow,
    pack: &AssetPack,
    sources: &Sources,
) -> Result<Option<Lack>, VariantsError> {
    Ok(Checked::new(row, pack, sources)?.lack(row.init_id))
}

/// Outcome of the check of a task's files, valid for all its trials.
#[derive(Clone, Debug)]
struct Checked {
    /// Reason why no trial can run; `None` if all the task's files exist.
    lack: Option<Lack>,
    /// Initial states of a suite file's task.
    states: Option<States>,
}

impl Checked {
    fn new(row: &ManifestRow, pack: &AssetPack, sources: &Sources) -> Result<Self, VariantsError> {
        let own = row.own.as_deref().filter(|_| row.id.task().suite() == Suite::Own);
        let (lack, states) = match own {
            None => (lack_in_benchmark(row, pack, sources)?, None),
            Some(own) => match check_own(own, row.instruction.is_empty(), pack, sources) {
                Ok(states) => (None, Some(states)),
                Err(lack) => match (&lack, row.files) {
                    (Lack::Folder(_) | Lack::File(_), Some(benchmark)) => {
                        (Some(Lack::TaskFiles(benchmark)), None)
                    }
                    _ => (Some(lack), None),
                },
            },
        };
        Ok(Self { lack, states })
    }

    /// Returns the reason why a rollout from an initial state cannot run; `None` if it can.
    fn lack(&self, init_id: u16) -> Option<Lack> {
        let states = self.states.as_ref();
        let lack = self.lack.clone();
        lack.or_else(|| states.and_then(|states| states.lack(init_id)))
    }
}

fn lack_in_benchmark(
    row: &ManifestRow,
    pack: &AssetPack,
    sources: &Sources,
) -> Result<Option<Lack>, VariantsError> {
    let (case, _) = Case::of_row(row)?;
    let lack = match case.subject {
        Subject::Plus(entry) => assets_lack(entry, pack),
        Subject::Pro(_) | Subject::Para(_) | Subject::Unperturbed | Subject::Own(_) => None,
    };
    if lack.is_some() {
        return Ok(lack);
    }
    let Some(own) = &row.own else { return Ok(None) };
    let files = TaskFiles::with_prompt(sources, own);
    match case.benchmark() {
        Some(benchmark) if !(files.bddl.is_file() && files.init.is_file()) => {
            Ok(Some(Lack::TaskFiles(benchmark)))
        }
        Some(Benchmark::Pro) => models_lack(&files, pack, Further::Models),
        Some(Benchmark::Plus) => match case.further_assets() {
            Some(further @ Further::Assets(Assets::NewObjects)) => {
                models_lack(&files, pack, further)
            }
            _ => Ok(None),
        },
        Some(Benchmark::Para) | None => Ok(None),
    }
}

/// Returns `Lack::Further(further)` if the pack lacks the model of an object or fixture of the
/// task; `None` if it has all models.
fn models_lack(
    files: &TaskFiles,
    pack: &AssetPack,
    further: Further,
) -> Result<Option<Lack>, VariantsError> {
    let problem = files.problem()?;
    let declared = problem.objects.iter().chain(&problem.fixtures);
    let mut models = declared.filter_map(|model| category(&model.category));
    let is_present = |file: &str| {
        (pack.is_managed() && Table::libero().get(file).is_some())
            || pack.dir().join(file).is_file()
    };
    Ok((!models.all(|model| is_present(model.file))).then_some(Lack::Further(further)))
}

/// Returns the lack of assets, apart from the task files, of a LIBERO-Plus variant; `None` if the
/// pack has them all.
fn assets_lack(entry: &Entry, pack: &AssetPack) -> Option<Lack> {
    let is_composable = match entry.assets() {
        // `models_lack` checks the files, which the BDDL file names.
        Assets::NewObjects => pack.dir().join("new_objects").is_dir(),
        _ => entry.is_composable(|file| pack.dir().join(file).is_file()),
    };
    (!is_composable).then(|| Lack::Further(Further::Assets(entry.assets())))
}

#[derive(Clone, Debug)]
struct States {
    path: String,
    count: usize,
}

impl States {
    /// Returns the lack of an initial state; `None` if the state exists.
    fn lack(&self, init_id: u16) -> Option<Lack> {
        (usize::from(init_id) >= self.count)
            .then(|| Lack::States { path: self.path.clone(), count: self.count })
    }
}

/// Largest task file, bytes: a hundred times the largest of LIBERO.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// Checks that the files of a suite file's task exist, have the digest that the suite file gives, if any, and make a
/// scene with a goal that can be evaluated and, if it is the prompt, an instruction. Returns the
/// task's initial states, or the lack that prevents its rollouts.
fn check_own(
    own: &OwnTask,
    prompts_by_file: bool,
    pack: &AssetPack,
    sources: &Sources,
) -> Result<States, Lack> {
    let folder = Sources::suite_folder(sources.dir(), &own.folder);
    let text = |path: &Path| path.display().to_string();
    if !folder.is_dir() {
        return Err(Lack::Folder(text(&folder)));
    }
    let files = TaskFiles::of_own(sources, own);
    let with_prompt = TaskFiles::with_prompt(sources, own);
    let mut missing = [&with_prompt.bddl, &files.bddl, &files.init].into_iter();
    if let Some(path) = missing.find(|path| !path.is_file()) {
        return Err(Lack::File(text(path)));
    }
    if let Some(expected) = &own.changes.sha256 {
        let found = digest([&files.bddl, &files.init]).map_err(Lack::Scene)?;
        if found != *expected {
            return Err(Lack::OtherFiles {
                bddl: text(&files.bddl),
                expected: expected.clone(),
                found,
            });
        }
    }
    let instruction = if prompts_by_file { with_prompt.instruction().map(drop) } else { Ok(()) };
    let states = instruction.and_then(|()| try_scene(&files, pack, sources));
    states.map_err(|error| Lack::Scene(transport::chain(&error)))
}

fn try_scene(files: &TaskFiles, pack: &AssetPack, sources: &Sources) -> Result<States, SceneError> {
    let problem = files.problem()?;
    match pack.is_managed() {
        // The pack's files are fetched only when the rollout starts.
        true => {
            check_goal(&problem)?;
            needed_files(&problem)?;
        }
        false => {
            compose(&problem, pack, sources, ENV_SEED)?;
        }
    }
    let states = InitialStates::read(&files.init)?;
    Ok(States { path: files.init.display().to_string(), count: states.count() })
}

/// Returns the SHA-256 of files in sequence, hex, or the reason why a file cannot be read.
fn digest(paths: [&Path; 2]) -> Result<String, String> {
    let mut digest = Sha256::new();
    for path in paths {
        let problem = |problem: &dyn fmt::Display| format!("read {}: {problem}", path.display());
        let bytes = path.metadata().map_err(|error| problem(&error))?.len();
        if bytes > MAX_FILE_BYTES {
            let size = format!("it has {bytes} bytes, more than {MAX_FILE_BYTES}");
            return Err(problem(&size));
        }
        digest.update(fs::read(path).map_err(|error| problem(&error))?);
    }
    Ok(hex::encode(digest.finalize()))
}
