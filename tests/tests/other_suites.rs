//! The 90 tasks of LIBERO-90. LIBERO-CTRL evaluates no policy on them, but their BDDL files
//! resemble those that users write.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use benchmark::TaskRef;
use benchmark::presets::ENV_SEED;
use scene::{AssetPack, InitialStates, Problem, Scene, SceneError, Sources, TaskFiles, compose};
use sim::Environment;
use sim::episode::NO_OP;
use sim::predicates::Goal;
use tests::files::{libero, primitives, sources};

const SUITE: &str = "libero_90";
const TASKS: usize = 90;
/// Number of initial states released for each task.
const STATES: usize = 50;

struct Task {
    name: String,
    problem: Problem,
    states: InitialStates,
}

fn tasks(sources: &Sources) -> Vec<Task> {
    let folder = sources.bddl_file(SUITE, "any").with_file_name("");
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "bddl"))
        .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    names.sort();
    names
        .into_iter()
        .map(|name| {
            let files = TaskFiles {
                bddl: sources.bddl_file(SUITE, &name),
                init: sources.init_file(SUITE, &name),
            };
            Task {
                problem: files.problem().unwrap_or_else(|e| panic!("{name}: {e}")),
                states: InitialStates::read(&files.init).unwrap_or_else(|e| panic!("{name}: {e}")),
                name,
            }
        })
        .collect()
}

/// Tasks and their composed scenes, grouped by the scene's digest.
type Scenes<'a> = BTreeMap<String, Vec<(&'a Task, Scene)>>;

/// Composes every task, so that each scene is compiled once. Also returns the categories that the
/// pack lacks.
fn compose_all<'a>(
    tasks: &'a [Task],
    pack: &AssetPack,
    sources: &Sources,
) -> (Scenes<'a>, BTreeSet<String>) {
    let mut scenes = Scenes::new();
    let mut missing = BTreeSet::new();
    for task in tasks {
        match compose(&task.problem, pack, sources, ENV_SEED) {
            Ok(scene) => scenes.entry(scene.digest()).or_default().push((task, scene)),
            Err(error) => {
                missing.insert(missing_category(task, &error, pack.dir()));
            }
        }
    }
    (scenes, missing)
}

/// Returns the category that an error names as missing, after checking that the task uses it and
/// that the named file does not exist.
fn missing_category(task: &Task, error: &SceneError, pack: &Path) -> String {
    let name = &task.name;
    let SceneError::Read { path, .. } = error else {
        panic!("{name}: {error}");
    };
    assert!(path.starts_with(pack) && !path.exists(), "{name}: {error}");
    let message = error.to_string();
    assert!(message.contains(path.to_str().unwrap()), "{name}: {message}");
    let problem = &task.problem;
    let categories = problem.objects.iter().chain(&problem.fixtures);
    let named = categories
        .map(|declaration| &declaration.category)
        .find(|category| message.contains(&format!("category `{category}`")));
    named.unwrap_or_else(|| panic!("{name}: no category named in: {message}")).clone()
}

/// Compiles each scene once. For every task in it, resolves the goal, loads a released initial
/// state and steps. Returns the number of tasks.
fn run_all(scenes: Scenes<'_>, pack: &AssetPack, sources: &Sources) -> usize {
    let mut ran = 0;
    for group in scenes.into_values() {
        let mut environment = Environment::new(group[0].1.clone(), pack, sources).unwrap();
        for (index, (task, scene)) in group.iter().enumerate() {
            let name = &task.name;
            let model = environment.model();
            assert_eq!(task.states.width(), 1 + model.nq() + model.nv(), "{name}");
            let goal =
                Goal::resolve(&scene.goal, scene, model).unwrap_or_else(|e| panic!("{name}: {e}"));
            // Each task of a scene gets another of the 50 states.
            environment.load(task.states.get(index * 7 % STATES).unwrap());
            for _ in 0..10 {
                let step = environment.step(&NO_OP);
                step.unwrap_or_else(|e| panic!("{name}: {e}"));
            }
            let succeeded = goal.holds(environment.model(), environment.data());
            assert!(!succeeded, "{name} succeeds by itself");
            ran += 1;
        }
    }
    ran
}

#[test]
fn all_tasks_of_libero_90_are_read_with_their_initial_states() {
    let tasks = tasks(&sources());
    assert_eq!(tasks.len(), TASKS);
    for task in tasks {
        assert_eq!(task.states.count(), STATES, "{}", task.name);
    }
}

#[test]
fn tasks_of_libero_90_run_on_liberos_assets_or_name_the_missing_category() {
    let test = "tasks_of_libero_90_run_on_liberos_assets_or_name_the_missing_category";
    let sources = sources();
    if let Some(pack) = libero(&sources, test) {
        check_pack(&pack, &sources);
    }
}

#[test]
fn tasks_of_libero_90_run_on_the_built_in_pack_or_name_the_missing_category() {
    let sources = sources();
    check_pack(&primitives(&sources), &sources);
}

fn check_pack(pack: &AssetPack, sources: &Sources) {
    let tasks = tasks(sources);
    let (scenes, missing) = compose_all(&tasks, pack, sources);
    for task in TaskRef::all() {
        let problem = TaskFiles::of_task(sources, task).problem().unwrap();
        for declaration in problem.objects.iter().chain(&problem.fixtures) {
            let category = &declaration.category;
            assert!(!missing.contains(category), "{task} needs `{category}`");
        }
    }
    let count = scenes.len();
    let ran = run_all(scenes, pack, sources);
    eprintln!(
        "{SUITE} on {}: {ran} of {} tasks ran, in {count} scenes; the pack lacks {missing:?}",
        pack.name(),
        tasks.len()
    );
    assert!(ran > 0, "the pack {} runs none of {SUITE}", pack.name());
}
