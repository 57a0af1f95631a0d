//! Tests of `worker rollout` by id, with a user's own task, and from a recording; on the built-in
//! assets.

use crate::video::PANE_SIDE;
use benchmark::attempt::GoalProgress;
use benchmark::{Axis, ManifestRow, Query, Realisation, row_of};
use proto::checks::CAMERAS;
use proto::policy as wire;
use scene::{AssetPack, Sources};
use sim::{Renderer, SimulatorConfig};

use super::*;
use crate::actor::{Description, PolicyError, PolicySession};
use crate::filming::{Replay, render_again};
use crate::message::{VideoOf, VideoRequest};

#[test]
fn a_rollout_id_determines_the_simulation() {
    let row = |id: &str| row_of(id.parse().expect("an id"));
    let nominal = row("spatial/t0/nominal/i07").expect("a row");
    assert_eq!((nominal.init_id, nominal.perturbation.axes().len()), (7, 0));
    let single = row("spatial/t0/camera/L2/c00").expect("a row");
    assert_eq!((single.init_id, single.perturbation.axes()), (43, vec![Axis::Camera]));
    let all = row("spatial/t0/simultaneous/L2/c00").expect("a row");
    assert_eq!(all.perturbation.axes(), Axis::METRIC);
    let paraphrased = row("spatial/t0/language/L2/c00").expect("a row");
    assert_eq!(all.instruction, paraphrased.instruction);
    assert_ne!(all.instruction, nominal.instruction);
    let at_radius = row("spatial/t0/simultaneous/r2.5/c10").expect("a row");
    assert_eq!(at_radius.perturbation.axes(), Axis::METRIC);
    let error = row("spatial/t0/camera/L2/c1000").expect_err("too many");
    assert!(error.to_string().contains("c1000"), "{error}");
}

/// Returns a task outside the protocol: a task of libero_90 stands in for a user's own files.
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

fn sources() -> Sources {
    Sources::open(&Sources::default_dir()).expect("the sources; run `cargo xtask setup`")
}

pub(crate) fn simulator() -> Simulator {
    let sources = sources();
    Simulator::new(SimulatorConfig {
        pack: AssetPack::open("primitives", &sources).expect("built in"),
        sources,
        renderer: Renderer::default(),
        cached_scenes: 1,
    })
}

pub(crate) fn assignment(row: ManifestRow, video: Option<&Path>) -> Assignment {
    let video = video.map(|file| VideoRequest { file: file.to_owned(), of: VideoOf::Everything });
    Assignment { video, ..Assignment::standalone(row, 0, Realisation::Matched) }
}

/// Returns the shape and the values of an array in a trace.
fn array<T: npyz::Deserialize>(trace: &Path, name: &str) -> (Vec<u64>, Vec<T>) {
    let file = fs::File::open(trace).expect("a trace");
    let mut archive = zip::ZipArchive::new(file).expect("an NPZ file");
    let member = archive.by_name(&format!("{name}.npy"));
    let array = npyz::NpyFile::new(member.expect("a member of the archive")).expect("an array");
    (array.shape().to_vec(), array.into_vec().expect("values of this type"))
}

#[test]
fn a_users_task_is_run_from_a_recording_and_again_from_its_trace() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = folder.path().join("actions.jsonl");
    let lines = "[0.5, 0, -0.5, 0, 0, 0, -1]\n\n[2.0, 0, 0, 0, 0, 0.1, 1]\n".repeat(4);
    fs::write(&recording, lines).expect("writes");
    let task = drawer_task(&sources());
    let mut simulator = simulator();
    let mut replay = |recording: &Path, output: &Path| {
        let mut recorded = RecordedActions::read(recording).expect("actions");
        let row = task.row().expect("a row");
        assert_eq!(row.instruction, "open the bottom drawer of the cabinet");
        let assignment = assignment(row, None);
        let request = Request {
            assignment: &assignment,
            files: Some(task.files()),
            variant: None,
            renders_ends: false,
            output,
        };
        run(&mut simulator, &mut recorded, &request).expect("an outcome")
    };
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    let finished = replay(&recording, &first);
    assert_eq!(finished.result.steps, 6, "the step budget ends the rollout");
    assert_eq!(finished.result.clipped_actions, 3);
    let expected = GoalProgress { predicates: 1, at_end: 0, at_most: 0 };
    assert_eq!(finished.result.goal, expected);
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

/// The released code distorts the policy's answers before clipping: with a gain below 1, an answer
/// of 2 and an answer of 1 give different commands.
#[test]
fn answers_are_distorted_before_clipping_as_in_the_released_code() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut simulator = simulator();
    let mut path_of = |id: &str, realisation: Realisation, size: f64| {
        let recording = folder.path().join("actions.jsonl");
        let line = format!("[{size}, 0, -{size}, 0, 0, 0, -1]\n");
        fs::write(&recording, line.repeat(6)).expect("writes");
        let mut recorded = RecordedActions::read(&recording).expect("actions");
        let mut row = row_of(id.parse().expect("an id")).expect("a row");
        row.max_steps = recorded.count();
        if let Some(distortion) = &mut row.perturbation.actuation {
            distortion.gain_log2 = -1.0;
        }
        let assignment = Assignment { realisation, ..assignment(row, None) };
        let request = Request {
            assignment: &assignment,
            files: None,
            variant: None,
            renders_ends: false,
            output: folder.path(),
        };
        let finished = run(&mut simulator, &mut recorded, &request).expect("an outcome");
        let clipped = if size > 1.0 { 6 } else { 0 };
        assert_eq!(finished.result.clipped_actions, clipped);
        array::<f64>(&folder.path().join("trace.npz"), "qpos").1
    };
    let (distorted, nominal) = ("object/t0/actuation/L1/c00", "object/t0/nominal/i00");
    let (matched, reference) = (Realisation::Matched, Realisation::Reference);
    for (id, realisation, is_equal) in [
        (distorted, matched, true),
        (distorted, reference, false),
        (nominal, matched, true),
        (nominal, reference, true),
    ] {
        let same = path_of(id, realisation, 2.0) == path_of(id, realisation, 1.0);
        assert_eq!(same, is_equal, "{id} in {realisation} realisation");
    }
}

#[test]
fn first_and_last_frames_are_written_for_a_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = folder.path().join("actions.jsonl");
    fs::write(&recording, "[1, 0, -1, 0, 0, 0, -1]\n".repeat(4)).expect("writes");
    let mut recorded = RecordedActions::read(&recording).expect("actions");
    let mut row = row_of("object/t0/nominal/i03".parse().expect("an id")).expect("a row");
    row.max_steps = recorded.count();
    let video = folder.path().join("video.mp4");
    let assignment = assignment(row, Some(&video));
    let request = Request {
        assignment: &assignment,
        files: None,
        variant: None,
        renders_ends: true,
        output: folder.path(),
    };
    run(&mut simulator(), &mut recorded, &request).expect("an outcome");
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

/// Policy that requests both cameras for every action and records its observations.
pub(crate) struct ObservingActor {
    pub(crate) side: u32,
    pub(crate) observations: Vec<wire::Observation>,
    /// Instructions received, one per reset.
    pub(crate) instructions: Vec<String>,
}

impl Actor for ObservingActor {
    fn describe(&mut self, _session: PolicySession<'_>) -> Result<Description, PolicyError> {
        let camera = |name: &str| wire::CameraRequest {
            name: name.to_owned(),
            width: self.side,
            height: self.side,
        };
        Ok(Description {
            about: wire::DescribeResponse {
                cameras: CAMERAS.map(camera).to_vec(),
                ..wire::DescribeResponse::default()
            },
            state: Vec::new(),
            horizon: 1,
            execute: 1,
        })
    }

    fn reset(
        &mut self,
        _session: PolicySession<'_>,
        instruction: &str,
        _seed: u64,
    ) -> Result<(), PolicyError> {
        self.instructions.push(instruction.to_owned());
        Ok(())
    }

    fn infer(
        &mut self,
        _session: PolicySession<'_>,
        _query_index: u32,
        observation: wire::Observation,
        _horizon: usize,
        _: Option<&Query>,
    ) -> Result<Vec<Action>, PolicyError> {
        self.observations.push(observation);
        Ok(vec![[0.5, 0.0, -0.5, 0.0, 0.0, 0.0, -1.0]])
    }
}

/// Frames and video of one rollout.
struct FramesAndFilm {
    /// Frames of both cameras at every query of the policy.
    by_policy: Vec<[Vec<u8>; 2]>,
    /// Frames of both cameras from which the video is made.
    in_film: Vec<[Vec<u8>; 2]>,
    film: Vec<u8>,
    /// First frame of each camera in `frames/`, with the simulator's order of rows.
    first_pictures: [Vec<u8>; 2],
}

fn run_and_film(
    simulator: &mut Simulator,
    row: &ManifestRow,
    realisation: Realisation,
    side: u32,
) -> FramesAndFilm {
    let folder = tempfile::tempdir().expect("a folder");
    let video = folder.path().join("video.mp4");
    let mut assignment = assignment(row.clone(), Some(&video));
    assignment.realisation = realisation;
    let mut actor = ObservingActor { side, observations: Vec::new(), instructions: Vec::new() };
    let request = Request {
        assignment: &assignment,
        files: None,
        variant: None,
        renders_ends: true,
        output: folder.path(),
    };
    let finished = run(simulator, &mut actor, &request).expect("an outcome");
    let observations = actor.observations.into_iter();
    let by_policy: Vec<[Vec<u8>; 2]> = observations
        .map(|observation| [0, 1].map(|camera| observation.images[camera].rgb.to_vec()))
        .collect();
    let actions = vec![[0.5, 0.0, -0.5, 0.0, 0.0, 0.0, -1.0]; by_policy.len()];
    let replay = Replay {
        row,
        realisation,
        actions: &actions,
        lifted_after: None,
        success: finished.result.success,
    };
    let mut in_film = Vec::new();
    let mut stage = Stage::of_the_protocol(simulator);
    render_again(&mut stage, replay, &mut |pictures| {
        in_film.push(pictures.map(|picture| picture.rgb));
        Ok(())
    })
    .expect("simulates");
    let first_pictures = CAMERAS.map(|camera| {
        let file = folder.path().join(format!("frames/first-{camera}.png"));
        let mut picture = image::open(file).expect("a picture").into_rgb8();
        image::imageops::flip_vertical_in_place(&mut picture);
        picture.into_raw()
    });
    FramesAndFilm { by_policy, in_film, film: fs::read(&video).expect("a film"), first_pictures }
}

#[test]
fn films_and_pictures_show_what_the_policy_saw_with_the_sensors_corruption() {
    let mut simulator = simulator();
    let mut sensor = row_of("object/t0/sensor/L3/c03".parse().expect("an id")).expect("a row");
    sensor.max_steps = 4;
    let nominal =
        ManifestRow { perturbation: benchmark::Perturbation::default(), ..sensor.clone() };
    let side = PANE_SIDE as u32;
    let unperturbed = run_and_film(&mut simulator, &nominal, Realisation::Matched, side);
    for realisation in [Realisation::Matched, Realisation::Reference] {
        let corrupted = run_and_film(&mut simulator, &sensor, realisation, side);
        for captured in [&unperturbed, &corrupted] {
            // The video also has the frame after the last action.
            assert_eq!((captured.by_policy.len(), captured.in_film.len()), (4, 5));
            assert!(captured.in_film[..4] == captured.by_policy, "{realisation}");
            assert!(captured.first_pictures == captured.by_policy[0], "{realisation}");
        }
        for (corrupted, nominal) in corrupted.in_film.iter().zip(&unperturbed.in_film) {
            assert!(corrupted[0] != nominal[0] && corrupted[1] != nominal[1]);
        }
        assert!(corrupted.film != unperturbed.film);
        // The size of the policy's frames does not change the film, and a repetition of the rollout
        // does not change the policy's frames.
        let small = run_and_film(&mut simulator, &sensor, realisation, 128);
        assert!(small.in_film == corrupted.in_film, "{realisation}");
        let again = run_and_film(&mut simulator, &sensor, realisation, 128);
        assert!(small.by_policy == again.by_policy, "{realisation}");
    }
}

#[test]
fn invalid_recordings_are_refused_with_the_reason() {
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
}
