//! The protocol's tasks that a pack can show.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use benchmark::TaskRef;
use benchmark::presets::ENV_SEED;
use scene::arena::arena;
use scene::assets::{FileFacts, size_in_words};
use scene::catalog::category;
use scene::{AssetPack, Problem, SceneError, Sources, TaskFiles, compose, needed_files};
use terminal::counted;

/// Part of the protocol's 40 tasks that a pack has the files for.
#[derive(Debug)]
pub struct Coverage {
    categories: Models,
    arenas: Models,
    shown: Vec<TaskRef>,
    /// Tasks by the reason why they cannot be shown, or not before a fetch.
    not_shown: BTreeMap<String, Vec<TaskRef>>,
    /// Files still to be fetched; `None` for a pack that is not fetched on demand.
    to_fetch: Option<BTreeMap<&'static str, &'static FileFacts>>,
}

#[derive(Debug, Default)]
struct Models {
    present: BTreeSet<String>,
    missing: BTreeSet<String>,
}

impl Coverage {
    /// Checks all tasks. A file of LIBERO's counts as present if its size is right: its content is
    /// verified at use.
    pub fn check(pack: &AssetPack, sources: &Sources) -> Result<Self, SceneError> {
        let mut coverage = Self {
            categories: Models::default(),
            arenas: Models::default(),
            shown: Vec::new(),
            not_shown: BTreeMap::new(),
            to_fetch: pack.is_managed().then(BTreeMap::new),
        };
        for task in TaskRef::all() {
            let problem = TaskFiles::of_task(sources, task).problem()?;
            coverage.add_models(&problem, pack);
            match coverage.reason_not_shown(&problem, pack, sources)? {
                None => coverage.shown.push(task),
                Some(reason) => coverage.not_shown.entry(reason).or_default().push(task),
            }
        }
        Ok(coverage)
    }

    fn add_models(&mut self, problem: &Problem, pack: &AssetPack) {
        let has = |file: &str| pack.dir().join(file).is_file();
        let arena = arena(&problem.name);
        if let Some(arena) = &arena {
            self.arenas.add(arena.problem, has(&arena.file));
        }
        for declaration in problem.objects.iter().chain(&problem.fixtures) {
            let workspace = arena.as_ref().map(|arena| arena.workspace_category);
            let model = category(&declaration.category);
            if workspace != Some(&*declaration.category) {
                let is_present = model.is_some_and(|model| has(model.file));
                self.categories.add(&declaration.category, is_present);
            }
        }
    }

    /// Returns the reason why a task cannot be shown now; the text follows the words "failed to".
    /// Adds the task's missing files to those that are still to be fetched.
    fn reason_not_shown(
        &mut self,
        problem: &Problem,
        pack: &AssetPack,
        sources: &Sources,
    ) -> Result<Option<String>, SceneError> {
        let Some(folder) = pack.verified() else {
            let composed = compose(problem, pack, sources, ENV_SEED);
            return Ok(composed.err().map(|error| error.to_string()));
        };
        let mut files = needed_files(problem)?;
        files.retain(|file| !folder.seems_present(file));
        if let Some(to_fetch) = &mut self.to_fetch {
            to_fetch.extend(files.iter().map(|file| (file.path, *file)));
        }
        Ok(files.first().map(|first| match files.len() {
            1 => format!("find {}", first.path),
            files => {
                let others = counted(files as u64 - 1, "more file");
                format!("find {} and {others}", first.path)
            }
        }))
    }

    /// Returns the tasks that cannot be shown, by reason; empty for a pack that is fetched on
    /// demand.
    pub fn not_shown(&self) -> Vec<(&str, &[TaskRef])> {
        if self.to_fetch.is_some() {
            return Vec::new();
        }
        let not_shown = self.not_shown.iter();
        not_shown.map(|(reason, tasks)| (reason.as_str(), tasks.as_slice())).collect()
    }

    /// Returns true if every task can be shown, possibly after a fetch.
    pub fn is_complete(&self) -> bool {
        self.not_shown().is_empty()
    }

    /// Describes in one line how many tasks can be shown.
    pub fn summary(&self) -> String {
        let not_shown: usize = self.not_shown.values().map(Vec::len).sum();
        let all = self.shown.len() + not_shown;
        let shown = self.shown.len();
        match &self.to_fetch {
            Some(files) if !files.is_empty() => {
                let bytes = files.values().map(|file| file.transfer_bytes()).sum();
                format!(
                    "{shown} of {all} are present; the others' files ({} over the network) are \
                     fetched at first use",
                    size_in_words(bytes)
                )
            }
            _ => format!("{shown} of {all} can be shown"),
        }
    }
}

impl Models {
    fn add(&mut self, name: &str, is_present: bool) {
        let names = if is_present { &mut self.present } else { &mut self.missing };
        names.insert(name.to_owned());
    }
}

impl fmt::Display for Models {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all = self.present.len() + self.missing.len();
        write!(f, "{} of {all}", self.present.len())?;
        if !self.missing.is_empty() {
            let missing: Vec<&str> = self.missing.iter().map(String::as_str).collect();
            write!(f, "; missing: {}", missing.join(", "))?;
        }
        Ok(())
    }
}

impl fmt::Display for Coverage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.to_fetch.is_none() {
            writeln!(f, "  categories  {}", self.categories)?;
            writeln!(f, "  arenas      {}", self.arenas)?;
        }
        writeln!(f, "  tasks       {}", self.summary())?;
        if self.to_fetch.is_some() {
            if !self.shown.is_empty() && !self.not_shown.is_empty() {
                let shown: Vec<String> = self.shown.iter().map(ToString::to_string).collect();
                writeln!(f, "    present: {}", shown.join(", "))?;
            }
            return Ok(());
        }
        for (problem, tasks) in &self.not_shown {
            let tasks: Vec<String> = tasks.iter().map(ToString::to_string).collect();
            writeln!(f, "    not {}: failed to {problem}", tasks.join(", "))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn the_built_in_pack_shows_every_task_and_a_partial_copy_names_missing_files() {
        let sources = Sources::open(&Sources::default_dir());
        let sources = sources.expect("the sources; run `cargo xtask setup`");
        let built_in = AssetPack::open("primitives", &sources).expect("built in");
        let coverage = Coverage::check(&built_in, &sources).expect("reads");
        assert!(coverage.is_complete());
        let description = coverage.to_string();
        assert!(description.contains("40 of 40 can be shown"), "{description}");
        assert!(!description.contains("missing"), "{description}");

        let folder = tempfile::tempdir().expect("a folder");
        fs::create_dir(folder.path().join("scenes")).expect("makes");
        let arena = "scenes/libero_floor_base_style.xml";
        fs::copy(built_in.dir().join(arena), folder.path().join(arena)).expect("copies");
        let path = folder.path().to_string_lossy();
        let part = AssetPack::open(&path, &sources).expect("a pack");
        let description = Coverage::check(&part, &sources).expect("reads").to_string();
        assert!(description.contains("0 of 40 can be shown"), "{description}");
        assert!(description.contains("akita_black_bowl, "), "{description}");
        assert!(description.contains("arenas      1 of 5; missing: "), "{description}");
    }
}
