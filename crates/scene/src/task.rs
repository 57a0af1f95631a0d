//! Files of a task: its BDDL problem and its initial states.

use std::path::PathBuf;
use std::time::SystemTime;

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

    pub fn of_own(sources: &Sources, task: &OwnTask) -> Self {
        let folder = |name: &str| Sources::suite_folder(sources.dir(), name);
        let states = task.states_folder.as_ref().unwrap_or(&task.folder);
        Self {
            bddl: folder(&task.folder).join(&task.bddl),
            init: folder(states).join(&task.states),
        }
    }

    /// As [`of_own`](Self::of_own), with the BDDL file that has the prompt, if that is another one.
    pub fn with_prompt(sources: &Sources, task: &OwnTask) -> Self {
        let mut files = Self::of_own(sources, task);
        if let Some((folder, path)) = task.sentence.as_ref().and_then(|path| path.split_once('/')) {
            files.bddl = Sources::suite_folder(sources.dir(), folder).join(path);
        }
        files
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
