use std::collections::BTreeMap;

use benchmark::Axis;
use serde_json::json;

use super::*;

const DEADLINE: Duration = Duration::from_secs(30);

/// Starts the simulator of `simulator.py` with a fault.
fn start(fault: &str) -> Result<Pipe, PipeError> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/pipe/simulator.py");
    let command = format!("python3 '{}' {fault}", script.display());
    Pipe::start(&SimulatorCommand { name: "test".to_owned(), command }, DEADLINE)
}

fn request(name: &str, width: u32, height: u32) -> CameraRequest {
    CameraRequest { name: name.to_owned(), width, height }
}

fn reset(pipe: &mut Pipe, seed: u16) -> Result<Reset, PipeError> {
    let cameras = vec![request("agentview", 6, 4), request("robot0_eye_in_hand", 2, 2)];
    pipe.reset(("reach", seed), cameras, &Parameters::new(), DEADLINE)
}

fn step(pipe: &mut Pipe, deadline: Duration) -> Result<Step, PipeError> {
    pipe.step(&[0.4, 0.2, 9.0, 9.0, 9.0, 9.0, -1.0], true, deadline)
}

#[test]
fn a_simulator_is_described_reset_stepped_and_ended() {
    let mut pipe = start("none").expect("starts");
    assert_eq!(pipe.about.tasks[0].instruction, "reach it");
    assert_eq!(pipe.about.state, BTreeMap::from([("eef_pos".to_owned(), 3)]));
    let first = reset(&mut pipe, 7).expect("resets");
    assert_eq!(reset(&mut pipe, 7).expect("resets").digest, first.digest);
    assert_ne!(reset(&mut pipe, 8).expect("resets").digest, first.digest);
    let camera = json!({"yaw": 0.1}).as_object().cloned().expect("an object");
    let perturb = Parameters::from([(Axis::Camera, camera)]);
    let perturbed = pipe.reset(("reach", 7), Vec::new(), &perturb, DEADLINE).expect("resets");
    assert_ne!(perturbed.digest, first.digest);
    reset(&mut pipe, 7).expect("resets");
    let frames = pipe.frames().expect("read");
    assert_eq!((&*frames[0].rgb, &*frames[1].rgb), (&[1; 72][..], &[2; 12][..]));
    let mut last = step(&mut pipe, DEADLINE).expect("steps");
    // The numbers are matched by name: x, y and gripper.
    assert_eq!(last.state["eef_pos"], [0.4, 0.2, 0.007]);
    for _ in 0..2 {
        assert!(!last.success);
        last = step(&mut pipe, DEADLINE).expect("steps");
    }
    assert!(last.success);
    let id = pipe.process.id();
    drop(pipe);
    assert!(!Path::new(&format!("/proc/{id}")).exists(), "the process is left");
}

#[test]
fn an_unusable_simulator_is_named_with_the_remedy() {
    let check = |fault: &str, expected: &str| {
        let error = start(fault).expect_err(fault);
        assert!(matches!(error, PipeError::Unusable { .. }), "{error:?}");
        let error = error.to_string();
        assert!(error.contains("`test`") && error.contains(expected), "{error}");
    };
    check("missing", "cannot be used: No module named 'metaworld': pip install metaworld");
    check("version", "speaks version 2 of the pipe, this worker version 1: install");
    check("nameless", "number 1 of its actions means ``");
    let absent =
        SimulatorCommand { name: "test".to_owned(), command: "no-such-program".to_owned() };
    let error = Pipe::start(&absent, DEADLINE).expect_err("no program").to_string();
    assert!(error.contains("did not answer describe: its process exited with code 127"), "{error}");
    assert!(usable(vec![absent], DEADLINE).is_empty());
}

#[test]
fn faults_of_a_rollout_name_request_and_cause() {
    let check = |fault: &str, deadline: Duration, expected: &str| {
        let mut pipe = start(fault).expect("starts");
        reset(&mut pipe, 0).expect("resets");
        let error = step(&mut pipe, deadline).expect_err(fault);
        assert!(error.to_string().contains(expected), "{error}");
        (pipe, error)
    };
    let (_, error) = check("crash", DEADLINE, "did not answer step: its process died of signal 11");
    assert!(matches!(error, PipeError::Ended { .. }), "{error:?}");
    let (pipe, error) = check("hang", DEADLINE / 60, "did not answer step within 0.5 s");
    assert!(matches!(error, PipeError::Late { .. }), "{error:?}");
    drop(pipe);
    let shape = "failed at step: reading `eef_pos` has 2 numbers and is described with 3";
    check("shape", DEADLINE, shape);
    // A simulator that answers with an error goes on.
    let (mut pipe, error) = check("raise", DEADLINE, "step raised ValueError('the arm fell off')");
    assert!(matches!(error, PipeError::Failed { .. }), "{error:?}");
    reset(&mut pipe, 0).expect("resets");
    let error = start("text").expect_err("no JSON").to_string();
    assert!(error.contains("answered describe wrongly: the answer is no line of JSON"), "{error}");
}

#[test]
fn a_command_is_read_from_its_option() {
    let read = |text: &str| text.parse::<SimulatorCommand>();
    let command = read("metaworld=a/rollout-env serve 'gym:M=1'").expect("a command");
    assert_eq!((&*command.name, &*command.command), ("metaworld", "a/rollout-env serve 'gym:M=1'"));
    for text in ["metaworld", "metaworld=", "=serve"] {
        assert!(read(text).is_err(), "{text}");
    }
    let error = read("Meta-World=serve").expect_err("no name");
    assert!(error.contains("lower-case"), "{error}");
}
