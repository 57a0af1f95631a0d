//! Tests of the scene layer with everything that LIBERO ships.

use std::collections::HashSet;
use std::path::PathBuf;

use benchmark::TaskRef;
use benchmark::presets::ENV_SEED;
use scene::{
    AssetPack, InitialStates, Problem, SceneError, Sources, TaskFiles, compose, needed_files,
};
use sim::Environment;
use sim::mujoco::ObjectKind;
use tempfile::TempDir;
use tests::files::{libero, primitives, sources};

/// Number of BDDL files in the hf-libero wheel: 40 evaluation tasks and the 90 of LIBERO-90.
const BDDL_FILES: usize = 130;

fn bddl_files(sources: &Sources) -> Vec<PathBuf> {
    let root = sources.dir().join("libero/bddl_files");
    let mut files = Vec::new();
    for suite in std::fs::read_dir(root).unwrap() {
        for file in std::fs::read_dir(suite.unwrap().path()).unwrap() {
            files.push(file.unwrap().path());
        }
    }
    files.retain(|file| file.extension().is_some_and(|ending| ending == "bddl"));
    files.sort();
    files
}

#[test]
fn every_bddl_file_is_parsed_and_survives_a_round_trip() {
    let files = bddl_files(&sources());
    assert_eq!(files.len(), BDDL_FILES);
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let problem = Problem::parse(&text).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let reparsed = Problem::parse(&problem.to_string()).unwrap();
        assert_eq!(reparsed, problem, "{}", file.display());
        let names: Vec<_> = problem.objects.iter().chain(&problem.fixtures).collect();
        let unique: HashSet<_> = names.iter().map(|declaration| &declaration.name).collect();
        assert_eq!(unique.len(), names.len(), "{}", file.display());
    }
}

#[test]
fn every_released_initial_state_is_read() {
    let sources = sources();
    for task in TaskRef::all() {
        let files = TaskFiles::of_task(&sources, task);
        let states = InitialStates::read(&files.init).unwrap();
        assert_eq!(states.count(), 50, "{task}");
    }
}

#[test]
fn every_evaluation_task_composes_from_the_built_in_pack() {
    let sources = sources();
    let pack = primitives(&sources);
    for task in TaskRef::all() {
        check_task(task, &sources, &pack);
    }
}

#[test]
fn every_evaluation_task_composes_from_the_real_assets() {
    let test = "every_evaluation_task_composes_from_the_real_assets";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    for task in TaskRef::all() {
        check_task(task, &sources, &pack);
    }
}

/// Returns a folder with only those files of a pack that a task's scene needs.
fn only_needed_files(task: &TaskFiles, pack: &AssetPack) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for file in needed_files(&task.problem().unwrap()).unwrap() {
        let path = folder.path().join(file.path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::os::unix::fs::symlink(pack.dir().join(file.path), path).unwrap();
    }
    folder
}

#[test]
fn every_evaluation_task_composes_from_the_files_that_are_fetched_for_it() {
    let test = "every_evaluation_task_composes_from_the_files_that_are_fetched_for_it";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    for task in TaskRef::all() {
        let files = TaskFiles::of_task(&sources, task);
        let folder = only_needed_files(&files, &pack);
        let part = AssetPack::open(&folder.path().to_string_lossy(), &sources).unwrap();
        assert_eq!((part.name(), part.digest()), ("libero", pack.digest()));
        let problem = files.problem().unwrap();
        let compose = |pack| compose(&problem, pack, &sources, ENV_SEED);
        let scene = compose(&part).unwrap_or_else(|error| panic!("{task}: {error}"));
        assert_eq!(scene.digest(), compose(&pack).unwrap().digest(), "{task}");
    }
}

#[test]
fn altered_files_of_libero_are_refused_in_scenes() {
    let test = "altered_files_of_libero_are_refused_in_scenes";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    let files = TaskFiles::of_task(&sources, "libero_goal/0".parse().unwrap());
    let problem = files.problem().unwrap();
    let folder = only_needed_files(&files, &pack);
    let path = folder.path().to_string_lossy();
    let open = || AssetPack::open(&path, &sources).unwrap();
    let before = open();
    let scene = compose(&problem, &before, &sources, ENV_SEED).unwrap();
    scene.verify_files(&before).unwrap();
    for file in [
        "turbosquid_objects/wine_bottle/wine_bottle.xml",
        "stable_scanned_objects/akita_black_bowl/texture.png",
    ] {
        let altered = folder.path().join(file);
        let mut bytes = std::fs::read(&altered).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::remove_file(&altered).unwrap();
        std::fs::write(&altered, bytes).unwrap();
        // A pack opened after the alteration has another name, and a digest of its own.
        let after = open();
        assert_eq!(after.name(), "custom");
        assert_ne!(after.digest(), pack.digest());
        assert!(after.differences()[0].starts_with(file), "{after:?}");
        // A pack opened before the alteration, as by a slot, is refused when the altered file is
        // used.
        let known = AssetPack::open_known(&path, &sources, pack.digest()).unwrap();
        for pack in [&before, &known] {
            let composed = compose(&problem, pack, &sources, ENV_SEED);
            let error = composed.and_then(|scene| scene.verify_files(pack)).unwrap_err();
            assert!(matches!(error, SceneError::NotLiberos { .. }), "{error}");
            let error = error.to_string();
            assert!(error.contains(file) && error.contains("worker assets"), "{error}");
        }
        std::fs::remove_file(&altered).unwrap();
        std::os::unix::fs::symlink(pack.dir().join(file), altered).unwrap();
    }
}

/// Compiles the task's scene, and loads and settles its first state.
fn check_task(task: TaskRef, sources: &Sources, pack: &AssetPack) {
    let files = TaskFiles::of_task(sources, task);
    let scene = compose(&files.problem().unwrap(), pack, sources, ENV_SEED)
        .unwrap_or_else(|error| panic!("{task}: {error}"));
    let states = InitialStates::read(&files.init).unwrap();
    let mut environment = Environment::new(scene, pack, sources).unwrap();
    let model = environment.model();
    assert_eq!(states.width(), 1 + model.nq() + model.nv(), "{task}");
    let geoms = model.count(ObjectKind::Geom);
    let named: Vec<_> = (0..geoms).filter_map(|id| model.name(ObjectKind::Geom, id)).collect();
    let names: HashSet<_> = named.iter().collect();
    assert_eq!(names.len(), named.len(), "{task}: geoms share names");
    environment.load(states.get(0).unwrap());
    for _ in 0..10 {
        let succeeded = environment.step(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]).unwrap();
        assert!(!succeeded, "{task} succeeds by itself");
    }
}

#[test]
fn a_missing_category_is_named_with_its_file() {
    let sources = sources();
    let pack = primitives(&sources);
    let task: TaskRef = "libero_object/0".parse().unwrap();
    let mut problem = TaskFiles::of_task(&sources, task).problem().unwrap();
    problem.objects[0].category = "corn".to_owned();
    let error = compose(&problem, &pack, &sources, ENV_SEED).unwrap_err().to_string();
    assert!(error.contains("category `corn`"), "{error}");
    assert!(error.contains("stable_hope_objects/corn/corn.xml"), "{error}");
    problem.objects[0].category = "unicorn".to_owned();
    let error = compose(&problem, &pack, &sources, ENV_SEED).unwrap_err();
    assert!(matches!(error, SceneError::UnknownCategory { .. }), "{error}");
}

#[test]
fn truncated_files_are_refused_by_name() {
    let sources = sources();
    let task: TaskRef = "libero_goal/0".parse().unwrap();
    let files = TaskFiles::of_task(&sources, task);
    let dir = tempfile::tempdir().unwrap();
    let truncate = |from: &PathBuf, name: &str| {
        let bytes = std::fs::read(from).unwrap();
        let to = dir.path().join(name);
        std::fs::write(&to, &bytes[..bytes.len() / 2]).unwrap();
        to
    };
    let init = truncate(&files.init, "cut.pruned_init");
    let error = InitialStates::read(&init).unwrap_err().to_string();
    assert!(error.contains("cut.pruned_init"), "{error}");
    let bddl = truncate(&files.bddl, "cut.bddl");
    let error = TaskFiles { bddl, init }.problem().unwrap_err().to_string();
    assert!(error.contains("cut.bddl") && error.contains("line "), "{error}");
}
