//! Which of the protocol's 40 tasks a pack can show: the categories and arenas
//! they need, and whether their scenes compose, which needs every mesh and
//! texture too.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use protocol::TaskRef;
use protocol::presets::ENV_SEED;
use scene::arena::arena;
use scene::catalog::category;
use scene::{AssetPack, SceneError, Sources, TaskFiles, compose};

/// What a pack has of what the 40 tasks need.
#[derive(Debug)]
pub(super) struct Coverage {
    categories: Shelf,
    arenas: Shelf,
    tasks: usize,
    /// Why scenes do not compose, and which.
    broken: BTreeMap<String, Vec<TaskRef>>,
}

/// Things of one kind.
#[derive(Debug, Default)]
struct Shelf {
    present: BTreeSet<String>,
    missing: BTreeSet<String>,
}

impl Coverage {
    /// Goes through all tasks.
    pub(super) fn of(pack: &AssetPack, sources: &Sources) -> Result<Self, SceneError> {
        let mut coverage = Self {
            categories: Shelf::default(),
            arenas: Shelf::default(),
            tasks: 0,
            broken: BTreeMap::new(),
        };
        let has = |file: &str| pack.dir().join(file).is_file();
        for task in TaskRef::all() {
            let problem = TaskFiles::of_task(sources, task).problem()?;
            let arena = arena(&problem.name);
            if let Some(arena) = arena {
                coverage.arenas.add(arena.problem, has(arena.file));
            }
            for declaration in problem.objects.iter().chain(&problem.fixtures) {
                let workspace = arena.map(|arena| arena.workspace_category);
                let model = category(&declaration.category);
                if workspace != Some(&*declaration.category) {
                    let is_there = model.is_some_and(|model| has(model.file));
                    coverage.categories.add(&declaration.category, is_there);
                }
            }
            coverage.tasks += 1;
            if let Err(error) = compose(&problem, pack, sources, ENV_SEED) {
                let tasks = coverage.broken.entry(error.to_string()).or_default();
                tasks.push(task);
            }
        }
        Ok(coverage)
    }

    /// Whether every task can be shown.
    pub(super) fn is_whole(&self) -> bool {
        self.broken.is_empty()
    }
}

impl Shelf {
    fn add(&mut self, name: &str, is_there: bool) {
        let shelf = if is_there {
            &mut self.present
        } else {
            &mut self.missing
        };
        shelf.insert(name.to_owned());
    }
}

impl fmt::Display for Shelf {
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
        let broken: usize = self.broken.values().map(Vec::len).sum();
        writeln!(f, "  categories  {}", self.categories)?;
        writeln!(f, "  arenas      {}", self.arenas)?;
        writeln!(
            f,
            "  tasks       {} of {} compose",
            self.tasks - broken,
            self.tasks
        )?;
        for (problem, tasks) in &self.broken {
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
    fn the_built_in_pack_shows_every_task_and_half_of_it_names_what_is_missing() {
        let sources = match Sources::open(&Sources::default_dir()) {
            Ok(sources) => sources,
            Err(error) => {
                println!("skipped: failed to {error}");
                return;
            }
        };
        let whole = AssetPack::open("primitives", &sources).expect("built in");
        let said = Coverage::of(&whole, &sources).expect("reads").to_string();
        assert!(said.contains("40 of 40 compose"), "{said}");
        assert!(!said.contains("missing"), "{said}");

        let folder = tempfile::tempdir().expect("a folder");
        fs::create_dir(folder.path().join("scenes")).expect("makes");
        let arena = "scenes/libero_floor_base_style.xml";
        fs::copy(whole.dir().join(arena), folder.path().join(arena)).expect("copies");
        let path = folder.path().to_string_lossy();
        let part = AssetPack::open(&path, &sources).expect("a pack");
        let said = Coverage::of(&part, &sources).expect("reads").to_string();
        assert!(said.contains("0 of 40 compose"), "{said}");
        assert!(said.contains("akita_black_bowl, "), "{said}");
        assert!(said.contains("arenas      1 of 5; missing: "), "{said}");
    }
}
