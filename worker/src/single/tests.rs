//! One rollout by id, of somebody's own task, and from a recording; on the
//! built-in assets where `cargo xtask setup` has been run.

use std::time::Duration;

use npyz::npz::NpzArchive;
use protocol::{Axis, ManifestRow, Realisation};
use scene::{AssetPack, Sources};
use sim::{Renderer, SimulatorConfig};

use super::*;
use crate::ids::random_id;
use crate::message::{Session, VideoOf, VideoRequest};

#[test]
fn an_id_alone_says_what_is_simulated() {
    let row = |id: &str| row_of(id.parse().expect("an id"));
    let clean = row("spatial/t0/clean/i07").expect("a row");
    assert_eq!((clean.init_id, clean.perturbation.axes().len()), (7, 0));
    let single = row("spatial/t0/camera/L2/c00").expect("a row");
    assert_eq!(
        (single.init_id, single.perturbation.axes()),
        (43, vec![Axis::Camera])
    );
    let all = row("spatial/t0/combination/L2/c00").expect("a row");
    assert_eq!(all.perturbation.axes(), Axis::METRIC);
    let paraphrased = row("spatial/t0/language/L2/c00").expect("a row");
    assert_eq!(all.instruction, paraphrased.instruction);
    assert_ne!(all.instruction, clean.instruction);
    let other = row("spatial/t0/combination/r2.5/c10").expect("a row");
    assert_eq!(other.perturbation.axes(), Axis::METRIC);
    let error = row("spatial/t0/camera/L2/c1000").expect_err("too many");
    assert!(error.to_string().contains("c1000"), "{error}");
}

/// Nothing of the protocol: the sources' libero_90 stands in for somebody's
/// own files.
fn drawer_task(sources: &Sources) -> OwnTask {
    let stem = "KITCHEN_SCENE1_open_the_bottom_drawer_of_the_cabinet";
    OwnTask {
        bddl: sources.bddl_file("libero_90", stem),
        init: sources.init_file("libero_90", stem),
        init_id: 3,
        instruction: None,
        max_steps: Some(6),
        id: None,
    }
}

fn sources(test: &str) -> Option<Sources> {
    let opened = Sources::open(&Sources::default_dir());
    if let Err(error) = &opened {
        println!("skipped {test}: failed to {error}");
    }
    opened.ok()
}

fn simulator(sources: Sources) -> Simulator {
    Simulator::new(SimulatorConfig {
        pack: AssetPack::open("primitives", &sources).expect("built in"),
        sources,
        renderer: Renderer::default(),
        cached_scenes: 1,
    })
}

fn assignment(row: ManifestRow, video: Option<&Path>) -> Assignment {
    let attempt = random_id();
    Assignment {
        attempt,
        session: Session::new(&row.id, 0, attempt),
        row,
        realisation: Realisation::Matched,
        policy: String::new(),
        policy_endpoint: String::new(),
        policy_seed: 0,
        policy_deadline: Duration::from_secs(1),
        video: video.map(|file| VideoRequest {
            file: file.to_owned(),
            of: VideoOf::Everything,
        }),
        keep_actions: false,
    }
}

fn array<T: npyz::Deserialize>(trace: &Path, name: &str) -> (Vec<u64>, Vec<T>) {
    let mut archive = NpzArchive::open(trace).expect("an NPZ file");
    let array = archive.by_name(name).expect("reads").expect("is there");
    (
        array.shape().to_vec(),
        array.into_vec().expect("of this type"),
    )
}

#[test]
fn a_task_of_ones_own_is_replayed_and_its_trace_replays_again() {
    let test = "a_task_of_ones_own_is_replayed_and_its_trace_replays_again";
    let Some(sources) = sources(test) else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let recording = folder.path().join("actions.jsonl");
    let lines = "[0.5, 0, -0.5, 0, 0, 0, -1]\n\n[2.0, 0, 0, 0, 0, 0.1, 1]\n".repeat(4);
    fs::write(&recording, lines).expect("writes");
    let task = drawer_task(&sources);
    let mut simulator = simulator(sources);
    let mut replay = |recording: &Path, output: &Path| {
        let mut recorded = RecordedActions::read(recording).expect("actions");
        let row = task.row().expect("a row");
        assert_eq!(row.instruction, "open the bottom drawer of the cabinet");
        let assignment = assignment(row, None);
        let request = Request {
            assignment: &assignment,
            files: Some(task.files()),
            draw: false,
            output,
        };
        run(&mut simulator, &mut recorded, &request).expect("an outcome")
    };
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    let finished = replay(&recording, &first);
    assert_eq!(finished.result.steps, 6, "the budget, not the recording");
    assert_eq!(finished.result.clipped_actions, 3);
    assert!(!first.join("frames").exists(), "nothing was drawn");
    let trace = first.join("trace.npz");
    let (shape, actions) = array::<f64>(&trace, "actions");
    assert_eq!((shape, actions[7]), (vec![6, 7], 2.0));
    let (_, executed) = array::<f64>(&trace, "executed");
    assert_eq!(executed[7], 1.0);
    let (shape, truths) = array::<bool>(&trace, "goal_truths");
    assert_eq!((shape, truths), (vec![7, 1], vec![false; 7]));
    assert_eq!(array::<f64>(&trace, "eef_pos").0, [7, 3]);

    replay(&trace, &second);
    let again = array::<f64>(&second.join("trace.npz"), "qpos");
    assert_eq!(array::<f64>(&trace, "qpos"), again);
    let result = fs::read_to_string(first.join("result.json")).expect("written");
    assert!(result.contains("KITCHEN_SCENE1_open_the_bottom_drawer"));
}

#[test]
fn both_cameras_first_and_last_pictures_are_kept_though_nobody_looked() {
    let test = "both_cameras_first_and_last_pictures_are_kept_though_nobody_looked";
    let Some(sources) = sources(test) else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let recording = folder.path().join("actions.jsonl");
    fs::write(&recording, "[1, 0, -1, 0, 0, 0, -1]\n".repeat(4)).expect("writes");
    let mut recorded = RecordedActions::read(&recording).expect("actions");
    let mut row = row_of("object/t0/clean/i03".parse().expect("an id")).expect("a row");
    row.max_steps = recorded.count();
    let video = folder.path().join("video.mp4");
    let assignment = assignment(row, Some(&video));
    let request = Request {
        assignment: &assignment,
        files: None,
        draw: true,
        output: folder.path(),
    };
    let mut simulator = simulator(sources);
    if let Err(error) = simulator.renderer_name() {
        println!("skipped {test}: failed to {error}");
        return;
    }
    run(&mut simulator, &mut recorded, &request).expect("an outcome");
    let picture = |name: &str| {
        let file = folder.path().join("frames").join(name);
        image::open(file).expect("a picture").into_rgb8()
    };
    for camera in ["agentview", "robot0_eye_in_hand"] {
        let first = picture(&format!("first-{camera}.png"));
        let last = picture(&format!("last-{camera}.png"));
        assert_eq!(first.dimensions(), (256, 256));
        assert_ne!(first, last, "the arm has moved");
    }
    assert!(video.is_file());
}

#[test]
fn recordings_that_no_robot_can_replay_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let check = |name: &str, content: &str, expected: &str| {
        let path = folder.path().join(name);
        fs::write(&path, content).expect("writes");
        let error = RecordedActions::read(&path).expect_err(expected);
        let error = error.to_string();
        assert!(error.contains(expected) && error.contains(name), "{error}");
    };
    check("a.jsonl", "[0, 0, 0, 0, 0, 0]\n", "line 1");
    check("b.jsonl", "\n\n", "no action");
    check("c.txt", "", ".jsonl");
    check("d.npz", "not a zip", "read recorded actions");
    check("e.npy", "not an array", "read recorded actions");
    // A parser that tries every way to read this never comes back.
    let brackets = format!("\u{1}NUMPY\u{1}\0v\0{}", "{".repeat(75));
    check("f.npy", &brackets, "too many brackets");
}
