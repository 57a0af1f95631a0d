//! LIBERO's scenes with changed lights, which cast shadows as in LIBERO-Plus' light variants:
//! pictures compared with those that the original LIBERO draws, recorded by `shadows/record.py`.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use benchmark::family::plus::{Dimension, Entry, inventory};
use benchmark::presets::ENV_SEED;
use benchmark::{Benchmark, Look, TaskRef};
use scene::{AssetPack, InitialStates, Sources, TaskFiles, compose};
use serde::Deserialize;
use sim::{Drawer, Environment, Renderer};
use tests::fidelity::{FrameFindings, SAME_ARITHMETIC, read_upright};
use tests::files::{folder_with_links, libero, sources};
use tests::outcome::alone;
use tests::programs::{Campaigns, program};

#[derive(Deserialize)]
struct Case {
    name: String,
    /// Kind of scene, as in the names of LIBERO-Plus' files.
    scene: String,
    task: TaskRef,
    /// Changed attributes and their values, by the light's name.
    lights: BTreeMap<String, BTreeMap<String, String>>,
}

const CASES: &str = include_str!("shadows/cases.json");
/// Folder of the recorded pictures, with a folder for each look.
const RECORDED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/shadows");
/// Number of cases, at the beginning of `cases.json`, by which the renderer was developed; the
/// remaining cases were held out.
const DEVELOPMENT_CASES: usize = 5;
const CAMERAS: [&str; 2] = ["agentview", "robot0_eye_in_hand"];
/// Side of the recorded pictures, pixels.
const SIDE: u32 = 128;

fn cases() -> Vec<Case> {
    serde_json::from_str(CASES).unwrap()
}

fn base_scene(kind: &str) -> String {
    let kind = match kind {
        "kitchen" => "kitchen_tabletop",
        "liv" => "living_room_tabletop",
        other => other,
    };
    format!("libero_{kind}_base_style.xml")
}

/// Makes a folder of assets with links to a pack's files and an empty folder `scenes/lights`.
fn folder_with_scenes(pack: &Path) -> tempfile::TempDir {
    let folder = folder_with_links(pack, &["scenes"]);
    std::fs::create_dir(folder.path().join("scenes/lights")).unwrap();
    folder
}

/// Returns the text of a scene file with the case's attributes of lights, for a file that lies one
/// folder deeper: its relative paths begin with `../`.
fn changed(text: &str, case: &Case) -> String {
    let mut text = text.replace("file=\"", "file=\"../");
    for (name, attributes) in &case.lights {
        let lights: Vec<&str> = text
            .split_inclusive('>')
            .filter_map(|part| part.find("<light ").map(|at| &part[at..]))
            .filter(|light| light.contains(&format!("name=\"{name}\"")))
            .collect();
        let [light] = lights[..] else {
            panic!("{}: {} lights are called {name}", case.name, lights.len());
        };
        let mut replacement = light.to_owned();
        for (attribute, value) in attributes {
            let name_start = replacement.find(&format!(" {attribute}=\"")).unwrap();
            let start = name_start + attribute.len() + 3;
            let end = start + replacement[start..].find('"').unwrap();
            replacement.replace_range(start..end, value);
        }
        text = text.replace(light, &replacement);
    }
    text
}

/// Composes a case's scene in a look, at the task's first initial state.
fn environment(
    (number, case): (usize, &Case),
    look: Look,
    folder: &Path,
    sources: &Sources,
) -> Environment {
    let scenes = folder.join("scenes");
    let base = std::fs::read_to_string(scenes.join(base_scene(&case.scene))).unwrap();
    let file = format!("lights/{}_light_sync_modified_{number}.xml", case.scene);
    std::fs::write(scenes.join(file), changed(&base, case)).unwrap();
    let files = TaskFiles::of_task(sources, case.task);
    let mut problem = files.problem().unwrap();
    problem.name = format!("{}_{}_light_sync_modified_{number}", problem.name, case.scene);
    // `lights` is given as the pack's digest, which only appears in results; this test stores none.
    let pack = AssetPack::open_known(folder.to_str().unwrap(), sources, "lights").unwrap();
    let pack = pack.with_look(look);
    let scene = compose(&problem, &pack, sources, ENV_SEED).unwrap();
    let mut environment = Environment::new(scene, &pack, sources).unwrap();
    let states = InitialStates::read(&files.init).unwrap();
    environment.load(states.get(0).unwrap());
    environment
}

/// Compares both cameras' pictures with the recorded ones, in both looks.
fn check(cases: &[Case], test: &str) {
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    let folder = folder_with_scenes(pack.dir());
    let drawer = Drawer::open(Renderer::Software).unwrap();
    for look in Look::ALL {
        let recorded = Path::new(RECORDED).join(look.name());
        for case in cases.iter().enumerate() {
            let mut environment = environment(case, look, folder.path(), &sources);
            for camera in CAMERAS {
                let picture = format!("{}_{camera}.png", case.1.name);
                let place = format!("{look}/{picture}");
                let recorded = read_upright(&recorded.join(picture)).unwrap();
                assert_eq!(recorded.dimensions(), (SIDE, SIDE));
                let drawn = environment.draw(&drawer, camera, SIDE, SIDE).unwrap();
                let mut findings = FrameFindings::default();
                findings.add(&drawn.rgb, &recorded, &place);
                println!("{place}: {findings}");
                assert_eq!(findings.violations(&SAME_ARITHMETIC), [""; 0]);
            }
        }
    }
}

#[test]
fn pictures_with_shadows_equal_the_originals() {
    let cases = cases();
    let (development, _) = cases.split_at(DEVELOPMENT_CASES);
    check(development, "pictures_with_shadows_equal_the_originals");
}

/// No rule of the renderer was changed after these cases were first compared.
#[test]
fn held_out_pictures_with_shadows_equal_the_originals() {
    let cases = cases();
    let (_, held_out) = cases.split_at(DEVELOPMENT_CASES);
    assert!(held_out.len() >= DEVELOPMENT_CASES);
    check(held_out, "held_out_pictures_with_shadows_equal_the_originals");
}

fn listed(name: &str, assets: &Path) -> String {
    let mut command = Command::new(program("worker"));
    command.args(["variants", "--variant", name, "--list", "--assets"]);
    let run = command.arg(assets).output().unwrap();
    String::from_utf8(run.stdout).unwrap()
}

#[test]
fn light_variants_run_from_a_folder_with_their_scene_files() {
    let test = "light_variants_run_from_a_folder_with_their_scene_files";
    let sources = sources();
    let Some(pack) = libero(&sources, test) else {
        return;
    };
    if !scene::has_task_files(Benchmark::Plus, &sources) {
        println!("skipped {test}: no task files of LIBERO-Plus");
        return;
    }
    let case = &cases()[0];
    let is_of_task =
        |entry: &&Entry| entry.variant.task == case.task && entry.dimension() == Dimension::Light;
    let entry = inventory().iter().find(is_of_task).unwrap();
    let name = entry.variant.to_string();
    let folder = folder_with_scenes(pack.dir());
    let line = listed(&name, folder.path());
    let lacks = "lacks scenes of LIBERO-Plus' archive (scenes/lights/), which no package index has";
    assert!(line.contains(lacks), "{line}");

    let scenes = folder.path().join("scenes");
    let base = std::fs::read_to_string(scenes.join(base_scene(&case.scene))).unwrap();
    let file = entry.class.as_ref().unwrap().scene.as_ref().unwrap();
    assert!(file.starts_with("scenes/lights/tabletop_"), "{file}");
    let data = tempfile::tempdir().unwrap();
    let campaigns = Campaigns::start(data.path());
    let id = format!("goal/t{}/plus:{}/i00", case.task.index(), entry.variant.change.label());
    let same_lights = Case { lights: BTreeMap::new(), ..cases().remove(0) };
    let [unaltered_lights, altered_lights] = [&same_lights, case].map(|case| {
        std::fs::write(folder.path().join(file), changed(&base, case)).unwrap();
        let listed = listed(&name, folder.path());
        assert!(listed.trim_end().ends_with("\truns"), "{listed}");
        let assets = folder.path().to_str().unwrap();
        let [_, state, frame] = alone(&campaigns.gateway.url, &id, &["--assets", assets]).digests;
        (state, frame)
    });
    // The lights move nothing, but the policy sees them.
    assert_eq!(unaltered_lights.0, altered_lights.0);
    assert_ne!(unaltered_lights.1, altered_lights.1);
}
