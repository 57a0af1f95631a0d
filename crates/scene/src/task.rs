//! Files of a task: its BDDL problem and its initial states.

use std::path::PathBuf;
use std::time::SystemTime;

use benchmark::family::para::Paraphrase;
use benchmark::family::plus::Variant;
use benchmark::family::pro::ProSuite;
use benchmark::family::protocol::Benchmark;
use benchmark::{OwnTask, TaskRef};

use crate::bddl::Problem;
use crate::error::SceneError;
use crate::sources::{REMEDY, Sources};

const BDDL: &str = "BDDL file";

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct TaskFiles {
    pub bddl: PathBuf,
    pub init: PathBuf,
}

/// Stamps of the BDDL file and of the file of initial states: length in bytes, and time of
/// modification. The stamp of a missing file is `None`. Different stamps show that a file changed.
pub type FileStamps = [Option<(u64, SystemTime)>; 2];

impl TaskFiles {
    pub fn stamps(&self) -> FileStamps {
        [&self.bddl, &self.init].map(|path| {
            let metadata = path.metadata().ok()?;
            Some((metadata.len(), metadata.modified().ok()?))
        })
    }

    pub fn of_task(sources: &Sources, task: TaskRef) -> Self {
        let (suite, stem) = (task.suite().name(), task.name());
        Self { bddl: sources.bddl_file(suite, stem), init: sources.init_file(suite, stem) }
    }

    /// LIBERO's own files or, where the variant differs, fetched ones.
    pub fn of_variant(sources: &Sources, variant: &Variant) -> Self {
        let libero_files = Self::of_task(sources, variant.task);
        let (suite, stem) = (variant.task.suite(), variant.bddl_stem());
        let fetched = Sources::family(sources.dir(), Benchmark::Plus);
        let bddl = match stem == variant.task.name() {
            true => libero_files.bddl,
            false => fetched.join(format!("bddl_files/{suite}/{stem}.bddl")),
        };
        let init = match variant.has_one_state() {
            true => fetched.join("init_files").join(variant.states_file()),
            false => libero_files.init,
        };
        Self { bddl, init }
    }

    pub fn of_pro_task(sources: &Sources, suite: ProSuite, task: TaskRef) -> Self {
        let (folder, name) = (Sources::family(sources.dir(), Benchmark::Pro), task.name());
        Self {
            bddl: folder.join(format!("bddl_files/{suite}/{name}.bddl")),
            init: folder.join(format!("init_files/{suite}/{name}.pruned_init.npz")),
        }
    }

    pub fn of_paraphrase(sources: &Sources, paraphrase: &Paraphrase) -> Self {
        let folder = Sources::family(sources.dir(), Benchmark::Para);
        Self {
            bddl: folder.join(paraphrase.bddl_file()),
            ..Self::of_task(sources, paraphrase.task)
        }
    }

    pub fn of_suite_file(sources: &Sources, task: &OwnTask) -> Self {
        let folder = Sources::suite_folder(sources.dir(), &task.folder);
        Self { bddl: folder.join(&task.bddl), init: folder.join(&task.states) }
    }

    pub fn problem(&self) -> Result<Problem, SceneError> {
        Problem::parse(&self.text()?).map_err(|error| self.malformed(error.to_string()))
    }

    /// Returns the instruction of the BDDL file, in lower case as in the original.
    pub fn instruction(&self) -> Result<String, SceneError> {
        let instruction = self.problem()?.language;
        if instruction.is_empty() {
            return Err(self.malformed("it has no instruction: add `(:language WORDS)`".to_owned()));
        }
        Ok(instruction)
    }

    /// Sentence of the BDDL file with its capital letters, as LIBERO-Para's scripts read it.
    pub fn sentence(&self) -> Result<String, SceneError> {
        let text = self.text()?;
        let mut lines = text.lines().map(str::trim);
        let sentence = lines
            .find_map(|line| line.strip_prefix("(:language"))
            .map(|rest| rest.trim_end_matches(')').trim())
            .filter(|sentence| !sentence.is_empty());
        let sentence = sentence.map(str::to_owned);
        sentence.ok_or_else(|| self.malformed("no line `(:language SENTENCE)`".to_owned()))
    }

    fn text(&self) -> Result<String, SceneError> {
        let bytes = std::fs::read(&self.bddl).map_err(|source| SceneError::Read {
            what: BDDL.to_owned(),
            path: self.bddl.clone(),
            remedy: format!("correct the file's name, or {REMEDY}"),
            source,
        })?;
        let text = String::from_utf8(bytes);
        let text = text.map_err(|_| self.malformed("save it in UTF-8".to_owned()))?;
        // Editors on Windows begin a file with a byte order mark.
        Ok(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text))
    }

    fn malformed(&self, problem: String) -> SceneError {
        SceneError::Malformed { what: BDDL.to_owned(), path: self.bddl.clone(), problem }
    }
}
