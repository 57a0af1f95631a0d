//! Compares LIBERO-Plus, LIBERO-PRO and LIBERO-Para with what their own code did, as recorded by the
//! scripts in `family`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use benchmark::family::corruption::Corruption;
use benchmark::family::plus::{Assets, Entry, Variant, entry, inventory, start_posture};
use benchmark::family::pro::ProSuite;
use benchmark::family::protocol::{Benchmark, Protocol};
use benchmark::family::{Case, Subject};
use benchmark::numpy::LegacyRng;
use benchmark::{Look, RolloutId, TaskRef, row_of};
use scene::{AssetPack, Sources, TaskFiles};
use sim::{Conditions, Environment, ObjectKind, ReadyScene, Reset, Start, VariantStart};
use tests::family::{
    Comparison, MODEL_LOADS, RECORDED as FOLDER, Recording, TOLERANCE, recordings,
};
use tests::files::{folder_with_links, libero, primitives, sources};
use tests::programs::program;

const RECORDED: &str = include_str!("family/states.txt");
const SEED: u32 = 7;

fn files_of(sources: &Sources, subject: Subject, task: TaskRef) -> TaskFiles {
    let case = Case { subject, task, trial: 0 };
    let row = case.row(&Protocol::official(case.benchmark().unwrap()));
    TaskFiles::of_own(sources, &row.own.unwrap())
}

/// The recordings have variants that the benchmark's list lacks.
fn files_of_variant(sources: &Sources, variant: &Variant) -> TaskFiles {
    let entry = entry(variant).unwrap_or_else(|| {
        let (variant, id, difficulty, class) = (*variant, 0, None, None);
        Box::leak(Box::new(Entry { variant, id, difficulty, class }))
    });
    files_of(sources, Subject::Plus(entry), variant.task)
}

/// Returns the recorded numbers of each variant, by kind.
fn recorded() -> BTreeMap<Variant, BTreeMap<&'static str, Vec<f64>>> {
    let mut recorded: BTreeMap<_, BTreeMap<_, _>> = BTreeMap::new();
    for line in RECORDED.lines() {
        let mut fields = line.split(' ');
        let (_, name) = fields.next().unwrap().split_once('/').unwrap();
        let kind = fields.next().unwrap();
        if kind == "noise" {
            continue;
        }
        let numbers = fields.map(|field| field.parse().unwrap()).collect();
        let variant = name.parse().unwrap();
        recorded.entry(variant).or_default().insert(kind, numbers);
    }
    recorded
}

fn difference(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let pairs = found.iter().zip(expected);
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn states_and_cameras_after_resets_and_waits_equal_the_originals() {
    let test = "states_and_cameras_after_resets_and_waits_equal_the_originals";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    let mut largest = BTreeMap::new();
    for (variant, recorded) in recorded() {
        let files = files_of_variant(&sources, &variant);
        if !(files.bddl.is_file() && files.init.is_file()) {
            let folder = Sources::family(sources.dir(), Benchmark::Plus);
            println!("skipped {test}: {variant}: no task files at {}", folder.display());
            continue;
        }
        pack.provide_with_bar(std::slice::from_ref(&files)).unwrap();
        let ready = ReadyScene::compile(files, &pack, &sources).unwrap();
        let mut environment = Environment::from_compiled(Arc::clone(ready.compiled())).unwrap();
        let begin = |environment: &mut Environment, start, waits| {
            let mut row = row_of(RolloutId::nominal(variant.task, 0)).unwrap();
            row.settle_steps = waits;
            let start = VariantStart {
                view: Some(variant.view()),
                posture: variant.robot().and_then(start_posture),
                seed: SEED,
                earlier_resets: 0,
                start,
                corruption: None,
            };
            let conditions = Conditions::begin_variant(&ready, environment, &row, &start).unwrap();
            conditions.settle(environment).unwrap();
        };
        begin(&mut environment, Start::Reset, 0);
        let mut check = |kind: &'static str, found: &[f64]| {
            let difference = difference(found, &recorded[kind]);
            println!("{variant} {kind}: {difference:e}");
            let largest = largest.entry(kind).or_insert((0.0, variant));
            if difference >= largest.0 {
                *largest = (difference, variant);
            }
        };
        check("reset", &environment.state());
        let model = environment.model();
        let camera = model.id(ObjectKind::Camera, "agentview").unwrap();
        let pose = [&model.cam_pos()[camera * 3..][..3], &model.cam_quat()[camera * 4..][..4]];
        check("camera", &pose.concat());
        let mut rng = LegacyRng::seed(SEED);
        environment.reset(&mut rng, Reset::Hard, MODEL_LOADS).unwrap();
        check("draw", &[rng.random_sample()]);
        begin(&mut environment, Start::Reset, 15);
        check("reset-only", &environment.state());
        begin(&mut environment, Start::InitialState, 10);
        check("official", &environment.state());
    }
    for (kind, (difference, variant)) in largest {
        assert!(difference <= TOLERANCE, "{kind} of {variant} differs by {difference:e}");
    }
}

/// Random numbers are drawn for the picture of the reset and for every later picture, even for one
/// that is not rendered.
#[test]
fn corruption_draws_as_many_random_numbers_as_the_original() {
    let test = "corruption_draws_as_many_random_numbers_as_the_original";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    let mut checked = 0;
    for line in RECORDED.lines().filter(|line| line.contains(" noise ")) {
        let fields: Vec<&str> = line.split(' ').collect();
        let (_, name) = fields[0].split_once('/').unwrap();
        let variant: Variant = name.parse().unwrap();
        let corruption = Corruption::new(variant.corruption().unwrap()).unwrap();
        let files = files_of_variant(&sources, &variant);
        let ready = ReadyScene::compile(files, &pack, &sources).unwrap();
        let mut environment = Environment::from_compiled(Arc::clone(ready.compiled())).unwrap();
        let mut rng = LegacyRng::seed(SEED);
        environment.reset(&mut rng, Reset::Hard, MODEL_LOADS).unwrap();
        // One picture of the reset, and one of each of the ten waits.
        for _ in 0..11 {
            corruption.skip(256, 256, &mut rng);
        }
        let expected: f64 = fields[2].parse().unwrap();
        assert_eq!(rng.random_sample(), expected, "{variant}");
        checked += 1;
    }
    assert_eq!(checked, 5);
}

/// Compares states of LIBERO-PRO in trials 0 and 1, as recorded by `family/record_pro.py`.
#[test]
fn states_of_libero_pro_after_resets_and_waits_equal_the_originals() {
    let test = "states_of_libero_pro_after_resets_and_waits_equal_the_originals";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    // The object suites need models that are not LIBERO's.
    let pro_pack = std::env::var("ROLLOUT_PRO_ASSETS").ok();
    let pro_pack = pro_pack.map(|dir| AssetPack::open_whole(dir.as_ref()).unwrap());
    let mut largest = 0.0_f64;
    for line in include_str!("family/pro.txt").lines() {
        let mut fields = line.split(' ');
        let suite: ProSuite = fields.next().unwrap().parse().unwrap();
        let name = fields.next().unwrap();
        let trial: u16 = fields.next().unwrap().parse().unwrap();
        let expected: Vec<f64> = fields.map(|field| field.parse().unwrap()).collect();
        let task = suite.suite.tasks().find(|task| task.name() == name).unwrap();
        let files = files_of(&sources, Subject::Pro(suite), task);
        if !(files.bddl.is_file() && files.init.is_file()) {
            let folder = Sources::family(sources.dir(), Benchmark::Pro);
            println!("skipped {test}: no task files at {}", folder.display());
            return;
        }
        let pack = match (AssetPack::files_of_tasks(std::slice::from_ref(&files)), &pro_pack) {
            (Ok(_), _) => {
                pack.provide_with_bar(std::slice::from_ref(&files)).unwrap();
                &pack
            }
            (Err(_), Some(pro_pack)) => pro_pack,
            (Err(_), None) => {
                println!("skipped {test}: {suite}: ROLLOUT_PRO_ASSETS names no folder of assets");
                continue;
            }
        };
        let ready = ReadyScene::compile(files, pack, &sources).unwrap();
        let mut environment = Environment::from_compiled(Arc::clone(ready.compiled())).unwrap();
        let row = row_of(RolloutId::nominal(task, trial)).unwrap();
        let start = VariantStart {
            view: None,
            posture: None,
            seed: SEED,
            earlier_resets: u32::from(trial),
            start: Start::InitialState,
            corruption: None,
        };
        let conditions = Conditions::begin_variant(&ready, &mut environment, &row, &start).unwrap();
        conditions.settle(&mut environment).unwrap();
        let difference = difference(&environment.state(), &expected);
        println!("{suite} {name} {trial}: {difference:e}");
        largest = largest.max(difference);
    }
    assert!(largest <= TOLERANCE, "states differ by {largest:e}");
}

/// Compares the cases that `family/record_chosen.py` recorded and `is_chosen` selects.
fn compare_chosen(benchmark: Benchmark, test: &str, is_chosen: impl Fn(&Recording) -> bool) {
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    let mut violations = Vec::new();
    let mut chosen = recordings(benchmark).unwrap();
    chosen.retain(|recording| recording.number.is_some() && is_chosen(recording));
    assert!(!chosen.is_empty());
    for look in Look::ALL {
        let pack = pack.clone().with_look(look);
        let mut comparison = Comparison::new(sources.clone(), pack, Path::new(FOLDER)).unwrap();
        assert!(chosen.iter().any(|recording| comparison.has_pictures(benchmark, recording)));
        for recording in &chosen {
            // Nothing but pictures depends on the look.
            if look != Look::default() && !comparison.has_pictures(benchmark, recording) {
                continue;
            }
            let name = format!("{look}/{}", recording.name);
            match comparison.compare(benchmark, recording).unwrap() {
                Ok(findings) => {
                    println!("{name}: {findings:?}");
                    if benchmark == Benchmark::Para && findings.prompt.is_none() {
                        println!(
                            "skipped {test}: {name}: its sentence: ROLLOUT_PARA names no checkout"
                        );
                    }
                    let found = findings.violations();
                    violations.extend(found.into_iter().map(|found| format!("{name}: {found}")));
                }
                Err(skipped) => println!("skipped {test}: {name}: {}", skipped.0),
            }
        }
    }
    assert!(violations.is_empty(), "{violations:#?}");
}

#[test]
fn chosen_variants_of_libero_plus_equal_the_originals() {
    let test = "chosen_variants_of_libero_plus_equal_the_originals";
    compare_chosen(Benchmark::Plus, test, |recording| !recording.is_held_out);
}

/// No code was changed after these variants were first compared.
#[test]
fn held_out_variants_of_libero_plus_equal_the_originals() {
    let test = "held_out_variants_of_libero_plus_equal_the_originals";
    let chosen = recordings(Benchmark::Plus).unwrap();
    let held_out = chosen.iter().filter(|recording| recording.is_held_out);
    assert_eq!(held_out.count(), 10);
    compare_chosen(Benchmark::Plus, test, |recording| recording.is_held_out);
}

#[test]
fn tasks_of_every_suite_of_libero_pro_equal_the_originals() {
    let test = "tasks_of_every_suite_of_libero_pro_equal_the_originals";
    let suite = |recording: &Recording| recording.name.split_once('/').unwrap().0.to_owned();
    let all: BTreeSet<_> = recordings(Benchmark::Pro).unwrap().iter().map(suite).collect();
    assert!(ProSuite::all().all(|suite| all.contains(&suite.to_string())));
    compare_chosen(Benchmark::Pro, test, |_| true);
}

/// LIBERO-Para changes the sentence alone, so libero_goal's files serve without its checkout.
#[test]
fn rollouts_of_libero_para_start_as_the_originals() {
    let test = "rollouts_of_libero_para_start_as_the_originals";
    assert_eq!(recordings(Benchmark::Para).unwrap().len(), 20);
    compare_chosen(Benchmark::Para, test, |_| true);
}

/// A model in the form of LIBERO-Plus' archive, as its code reads it: without an outer body. The
/// archive's own models were not available.
const ADDED_MODEL: &str = r#"<mujoco model="added">
  <asset><mesh name="shape" file="meshes/shape.obj"/></asset>
  <worldbody><body name="object">
    <geom type="mesh" mesh="shape" group="1" contype="0" conaffinity="0" mass="0"/>
    <geom type="box" size="0.02 0.02 0.05" group="0" density="100"/>
    <site name="bottom_site" pos="0 0 -0.05" size="0.005" rgba="0 0 0 0"/>
    <site name="top_site" pos="0 0 0.05" size="0.005" rgba="0 0 0 0"/>
    <site name="horizontal_radius_site" pos="0.02 0.02 0" size="0.005" rgba="0 0 0 0"/>
  </body></worldbody>
</mujoco>"#;
const ADDED_SHAPE: &str = "v 0 0 0\nv 0.04 0 0\nv 0 0.04 0\nv 0 0 0.1\n\
    f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";

/// Checks a task's layout with the fewest added objects and the one with the most. Added objects
/// turn by −90° about x, −180° about y and 180° about z. MuJoCo reads the quaternion x y z w of
/// these turns as w x y z, which is a turn by 90° about z.
#[test]
fn added_objects_are_placed_from_models_in_the_archives_form() {
    let test = "added_objects_are_placed_from_models_in_the_archives_form";
    let sources = sources();
    if !scene::has_task_files(Benchmark::Plus, &sources) {
        println!("skipped {test}: no task files of LIBERO-Plus");
        return;
    }
    let folder = folder_with_links(primitives(&sources).dir(), &[]);
    let pack = AssetPack::open_known(folder.path().to_str().unwrap(), &sources, "added").unwrap();
    let task = "libero_goal/8".parse().unwrap();
    let of_task = inventory()
        .iter()
        .filter(|entry| entry.variant.task == task && entry.assets() == Assets::NewObjects);
    let mut variants: Vec<Variant> = of_task.map(|entry| entry.variant).collect();
    variants.sort_by_key(|variant| {
        files_of_variant(&sources, variant).problem().unwrap().objects.len()
    });
    let list = |variant: &Variant| {
        let mut command = Command::new(program("worker"));
        command.args(["variants", "--list", "--variant", &variant.to_string(), "--assets"]);
        let run = command.arg(folder.path()).output().unwrap();
        String::from_utf8(run.stdout).unwrap()
    };
    let lacks = "lacks objects of LIBERO-Plus' archive (new_objects/), which no package index has";
    let mut counts = Vec::new();
    for variant in [variants[0], *variants.last().unwrap()] {
        let files = files_of_variant(&sources, &variant);
        let problem = files.problem().unwrap();
        let file = |category: &str| scene::catalog::category(category).unwrap().file;
        let added: Vec<_> = problem
            .objects
            .iter()
            .filter(|object| file(&object.category).starts_with("new_objects/"))
            .collect();
        assert!(list(&variant).contains(lacks), "{}", list(&variant));
        for object in &added {
            let path = folder.path().join(file(&object.category));
            let meshes = path.with_file_name("meshes");
            std::fs::create_dir_all(&meshes).unwrap();
            std::fs::write(path, ADDED_MODEL).unwrap();
            std::fs::write(meshes.join("shape.obj"), ADDED_SHAPE).unwrap();
        }
        assert!(list(&variant).trim_end().ends_with("\truns"), "{}", list(&variant));
        // Compiling compares the width of the variant's initial state with the model's.
        let ready = ReadyScene::compile(files, &pack, &sources).unwrap();
        let mut environment = Environment::from_compiled(Arc::clone(ready.compiled())).unwrap();
        let mut rng = LegacyRng::seed(SEED);
        environment.reset(&mut rng, Reset::Hard, MODEL_LOADS).unwrap();
        let state = environment.state();
        for object in &added {
            let model = environment.model();
            let joint = format!("{}_joint0", object.name);
            let joint = model.id(ObjectKind::Joint, &joint).unwrap();
            let at = 1 + model.jnt_qposadr()[joint] as usize + 3;
            let turned = [0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()];
            let difference = difference(&state[at..at + 4], &turned);
            assert!(difference < 1e-6, "{variant} {}: {difference:e}", object.name);
        }
        counts.push(added.len());
    }
    assert_eq!(counts, [1, 5]);
}
