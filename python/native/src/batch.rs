//! Batches of environments that step in parallel on threads.

use std::sync::Mutex;

use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PySlice};
use sim::{ActionFrame, RobotState};

use crate::action::{self, Numbers, WIDTH};
use crate::error::invalid;
use crate::guarded::{Guarded, closed};
use crate::simulation::{Simulation, action_frame};
use crate::start::Start;
use crate::state::{Snapshot, State, picture_size, robot_readings, shaped};

type Foreseen<'py> = (Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<bool>>);

/// Numbers of all [`robot_readings`] together.
const READING_WIDTH: usize = 28;

/// Selection of the control steps of a chunk to render. Readings of the robot are taken after the
/// rendered steps, or after the last step if none is rendered.
#[derive(Clone, Copy, PartialEq)]
enum Render {
    None,
    Last,
    All,
}

#[pyclass(frozen, module = "rollout_libero._native")]
pub(crate) struct Batch {
    states: Vec<Guarded<State>>,
    threads: usize,
}

struct Camera {
    name: String,
    size: [u32; 2],
}

/// Settings for pictures of rendered steps. Rows run from top to bottom.
#[derive(Clone, Copy)]
struct View<'a> {
    cameras: &'a [Camera],
    render: Render,
    /// Columns run from right to left.
    mirrored: bool,
}

/// Work of one environment: starts a rollout, or executes at most `limit` actions.
struct Task<'a> {
    state: &'a Guarded<State>,
    start: Option<Start>,
    actions: &'a [[f64; WIDTH]],
    limit: usize,
    /// Per step: true if the expert's action plus the arm's action in `actions` is executed; false
    /// if the action in `actions` is executed alone. `None` if the expert is not queried.
    expert: Option<&'a [bool]>,
    outputs: Outputs<'a>,
}

struct Outputs<'a> {
    steps: &'a mut u32,
    success: &'a mut bool,
    /// Per step: true if the goal holds after it. Empty if steps end at the first success.
    successes: &'a mut [bool],
    /// Per step: action of the expert, if it is queried.
    expert_actions: &'a mut [[f64; WIDTH]],
    /// Readings, one row per rendered step; one row if no step is rendered.
    readings: &'a mut [[f64; READING_WIDTH]],
    /// Per camera: pictures of each rendered step.
    frames: Vec<&'a mut [u8]>,
}

#[pymethods]
impl Batch {
    /// Uses one thread if any environment renders through OpenGL.
    #[new]
    fn new(simulations: Vec<Py<Simulation>>, threads: usize) -> PyResult<Self> {
        if simulations.is_empty() || threads == 0 {
            return Err(invalid(
                "make a batch: at least one environment and one thread are needed",
            ));
        }
        let uses_opengl =
            simulations.iter().any(|simulation| simulation.get().draws_through_opengl());
        let threads = if uses_opengl { 1 } else { threads.min(simulations.len()) };
        let states = simulations.iter().map(|simulation| simulation.get().state.clone());
        Ok(Self { states: states.collect(), threads })
    }

    fn restore(&self, py: Python<'_>, snapshots: Vec<Py<Snapshot>>) -> PyResult<()> {
        if snapshots.len() != self.states.len() {
            return Err(invalid(format_args!(
                "restore {} environments: {} snapshots were given",
                self.states.len(),
                snapshots.len()
            )));
        }
        let snapshots: Vec<&Snapshot> = snapshots.iter().map(Py::get).collect();
        py.detach(|| {
            let guards = self.states.iter().map(Guarded::hold);
            let mut guards = guards.collect::<PyResult<Vec<_>>>()?;
            let states = guards
                .iter_mut()
                .map(|guard| Option::as_mut(guard).ok_or_else(|| closed("close was called")));
            let states = states.collect::<PyResult<Vec<_>>>()?;
            for (state, snapshot) in states.iter().zip(&snapshots) {
                state.check_scene(snapshot)?;
            }
            for (state, snapshot) in states.into_iter().zip(snapshots) {
                state.restore(snapshot);
            }
            Ok(())
        })
    }

    fn foresee<'py>(&self, py: Python<'py>, steps: usize) -> PyResult<Foreseen<'py>> {
        let count = self.states.len();
        let mut actions = vec![[f64::NAN; WIDTH]; count * steps];
        let mut progress = vec![false; count];
        let rows = actions.chunks_exact_mut(steps.max(1)).zip(&mut progress);
        let tasks: Vec<_> = self.states.iter().zip(rows).collect();
        let errors = py.detach(|| {
            run(tasks, self.threads, |(state, (actions, progress))| {
                let mut guard = state.hold()?;
                let state = guard.as_mut().ok_or_else(|| closed("close was called"))?;
                *progress = state.foresee(actions)?;
                Ok(())
            })
        });
        if let Some(error) = errors.into_iter().flatten().next() {
            return Err(error);
        }
        let actions = shaped(py, actions.into_flattened(), &[count, steps, WIDTH])?;
        Ok((actions, shaped(py, progress, &[count])?))
    }

    #[expect(clippy::too_many_arguments, reason = "keyword arguments in Python")]
    #[pyo3(signature = (
        actions, limits, starts, cameras, *,
        render = "last", absolute = false, mirrored = false, expert = None,
        past_success = false
    ))]
    fn advance<'py>(
        &self,
        py: Python<'py>,
        actions: Numbers<'py>,
        limits: Vec<usize>,
        starts: Vec<Option<String>>,
        cameras: Vec<(String, u32, u32)>,
        render: &str,
        absolute: bool,
        mirrored: bool,
        expert: Option<PyReadonlyArrayDyn<'py, bool>>,
        past_success: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let count = self.states.len();
        let chunk = actions_per_chunk(&actions, count)?;
        let all_actions = action::actions(&actions, &[count, chunk, WIDTH])?;
        let expert =
            expert.map(|drives| expert_drives(&drives, [count, chunk], absolute)).transpose()?;
        if limits.len() != count || starts.len() != count {
            return Err(invalid(format_args!(
                "advance {count} environments: {} limits and {} starts were given",
                limits.len(),
                starts.len()
            )));
        }
        let render = match render {
            "none" => Render::None,
            "last" => Render::Last,
            "all" => Render::All,
            other => {
                return Err(invalid(format_args!(
                    "draw `{other}` steps of a chunk: choose `last`, `all` or `none`"
                )));
            }
        };
        let cameras = cameras
            .into_iter()
            .map(|(name, width, height)| {
                picture_size(width, height).map(|size| Camera { name, size })
            })
            .collect::<PyResult<Vec<_>>>()?;
        let starts = starts.iter().map(|row| row.as_deref().map(Start::read).transpose());
        let starts = starts.collect::<PyResult<Vec<_>>>()?;
        let observed_steps = match render {
            Render::All => chunk.max(1),
            Render::Last | Render::None => 1,
        };
        let mut steps = vec![0_u32; count];
        let mut success = vec![false; count];
        let success_steps = if past_success { chunk } else { 0 };
        let mut successes = vec![false; count * success_steps];
        let expert_steps = if expert.is_some() { chunk } else { 0 };
        let mut expert_actions = vec![[f64::NAN; WIDTH]; count * expert_steps];
        let mut readings = vec![[0.0; READING_WIDTH]; count * observed_steps];
        let rendered: &[Camera] = match render {
            Render::None => &[],
            Render::Last | Render::All => &cameras,
        };
        let mut frames: Vec<Vec<u8>> = rendered
            .iter()
            .map(|camera| vec![0; count * observed_steps * picture_bytes(camera.size)])
            .collect();

        let mut frame_rows: Vec<_> = frames
            .iter_mut()
            .zip(rendered)
            .map(|(frames, camera)| {
                frames.chunks_exact_mut(observed_steps * picture_bytes(camera.size))
            })
            .collect();
        let mut tasks = Vec::with_capacity(count);
        let mut success_rows = successes.chunks_exact_mut(success_steps.max(1));
        let mut expert_rows = expert_actions.chunks_exact_mut(expert_steps.max(1));
        let outputs =
            steps.iter_mut().zip(&mut success).zip(readings.chunks_exact_mut(observed_steps));
        for (((state, start), ((steps, success), readings)), (at, limit)) in
            self.states.iter().zip(starts).zip(outputs).zip(limits.into_iter().enumerate())
        {
            tasks.push(Task {
                state,
                start,
                actions: &all_actions[at * chunk..][..chunk],
                limit,
                expert: expert.as_ref().map(|drives| &drives[at * chunk..][..chunk]),
                outputs: Outputs {
                    steps,
                    success,
                    successes: success_rows.next().unwrap_or_default(),
                    expert_actions: expert_rows.next().unwrap_or_default(),
                    readings,
                    frames: frame_rows
                        .iter_mut()
                        .map(|rows| rows.next().expect("frames of each environment"))
                        .collect(),
                },
            });
        }
        let frame = action_frame(absolute);
        let threads = self.threads;
        let view = View { cameras: rendered, render, mirrored };
        let errors = py.detach(|| run(tasks, threads, |task| task.run(view, frame)));

        let result = PyDict::new(py);
        let errors = errors.into_iter();
        let errors: Vec<_> = errors.map(|error| error.map(|error| error.into_value(py))).collect();
        result.set_item("errors", errors)?;
        result.set_item("steps", shaped(py, steps, &[count])?)?;
        result.set_item("success", shaped(py, success, &[count])?)?;
        if past_success {
            let successes = shaped(py, successes, &[count, success_steps])?;
            result.set_item("successes", successes)?;
        }
        if expert.is_some() {
            let labels = expert_actions.into_flattened();
            result.set_item("expert_action", shaped(py, labels, &[count, chunk, WIDTH])?)?;
        }
        let leading_axes = match render {
            Render::All => vec![count, observed_steps],
            Render::Last | Render::None => vec![count],
        };
        let shape = |trailing_axes: &[usize]| [&leading_axes[..], trailing_axes].concat();
        let packed = readings.into_iter().flatten().collect();
        let packed = shaped(py, packed, &shape(&[READING_WIDTH]))?;
        let mut start = 0;
        for (name, values) in robot_readings(&RobotState::default()) {
            let end = start + values.len() as isize;
            let columns = PySlice::new(py, start, end, 1);
            result.set_item(name, packed.get_item((py.Ellipsis(), columns))?)?;
            start = end;
        }
        for (camera, frames) in rendered.iter().zip(frames) {
            let [width, height] = camera.size.map(|side| side as usize);
            let frames = shaped(py, frames, &shape(&[height, width, 3]))?;
            result.set_item(&camera.name, frames)?;
        }
        Ok(result)
    }
}

impl Task<'_> {
    fn run(self, view: View<'_>, frame: ActionFrame) -> PyResult<()> {
        let Self { state, start, actions, limit, expert, mut outputs } = self;
        let mut guard = state.hold()?;
        let state = guard.as_mut().ok_or_else(|| closed("close was called"))?;
        if let Some(start) = start {
            state.begin(&start)?;
            return outputs.observe(state, 0, view);
        }
        for (step, action) in actions.iter().take(limit).enumerate() {
            let mut action = *action;
            if let Some(drives) = expert {
                let expert_action = state.expert_action()?;
                outputs.expert_actions[step] = expert_action;
                if !drives[step] || exceeds_expert(&action) {
                    state.interrupt_expert();
                }
                if drives[step] {
                    action = add_to_expert(expert_action, action);
                }
            }
            *outputs.success = state.step(&action, frame)?;
            *outputs.steps += 1;
            let continues = match outputs.successes.get_mut(step) {
                Some(success) => {
                    *success = *outputs.success;
                    true
                }
                None => !*outputs.success,
            };
            if view.render == Render::All {
                outputs.observe(state, step, view)?;
            }
            if !continues {
                break;
            }
        }
        match view.render {
            Render::All => Ok(()),
            Render::Last | Render::None => outputs.observe(state, 0, view),
        }
    }
}

impl Outputs<'_> {
    /// Writes the readings and frames of the current state, as those of the rendered step `step`.
    fn observe(&mut self, state: &mut State, step: usize, view: View<'_>) -> PyResult<()> {
        let robot = state.environment.robot_state();
        let mut numbers = robot_readings(&robot).into_iter().flat_map(|(_, values)| values);
        self.readings[step] =
            std::array::from_fn(|_| *numbers.next().expect("READING_WIDTH numbers"));
        for (camera, pictures) in view.cameras.iter().zip(&mut self.frames) {
            let frame = state.frame(&camera.name, camera.size)?;
            let size = picture_bytes(camera.size);
            let picture = &mut pictures[step * size..][..size];
            let row_bytes = camera.size[0] as usize * 3;
            for (to, from) in
                picture.chunks_exact_mut(row_bytes).zip(frame.rgb.chunks_exact(row_bytes).rev())
            {
                if view.mirrored { mirror(from, to) } else { to.copy_from_slice(from) }
            }
        }
        Ok(())
    }
}

fn mirror(from: &[u8], to: &mut [u8]) {
    const PIXEL_BYTES: usize = 3;
    let (pixels, _) = from.as_chunks::<PIXEL_BYTES>();
    let (targets, _) = to.as_chunks_mut::<PIXEL_BYTES>();
    for (target, pixel) in targets.iter_mut().zip(pixels.iter().rev()) {
        *target = *pixel;
    }
}

/// Adds `added` to the arm components of the expert's action, and clamps the sums to -1..1.
fn add_to_expert(expert: [f64; WIDTH], added: [f64; WIDTH]) -> [f64; WIDTH] {
    const GRIPPER: usize = WIDTH - 1;
    std::array::from_fn(|at| match at {
        GRIPPER => expert[at],
        _ => (expert[at] + added[at]).clamp(-1.0, 1.0),
    })
}

/// A component of the added translation is larger than any that the expert can command.
fn exceeds_expert(added: &[f64; WIDTH]) -> bool {
    added[..3].iter().any(|value| value.abs() > 1.0)
}

/// Returns, environment by environment, true for each step at which the given action is added to
/// the expert's.
///
/// # Errors
/// If the shape differs from `shape`, or actions are absolute.
fn expert_drives(
    drives: &PyReadonlyArrayDyn<'_, bool>,
    shape: [usize; 2],
    absolute: bool,
) -> PyResult<Vec<bool>> {
    if absolute {
        return Err(invalid(
            "query the expert: its actions are displacements; use control=\"relative\"",
        ));
    }
    if drives.shape() != shape {
        return Err(invalid(format_args!(
            "query the expert: `expert` has shape {:?}; expected [environments, steps], {shape:?}",
            drives.shape()
        )));
    }
    Ok(drives.as_array().iter().copied().collect())
}

fn picture_bytes([width, height]: [u32; 2]) -> usize {
    width as usize * height as usize * 3
}

/// Returns the number of actions of one environment in a chunk.
///
/// # Errors
/// If the shape is not [environments, steps, [`WIDTH`]].
fn actions_per_chunk(actions: &Numbers<'_>, environments: usize) -> PyResult<usize> {
    match *actions.shape() {
        [rows, chunk, WIDTH] if rows == environments => Ok(chunk),
        ref shape => Err(invalid(format_args!(
            "read actions of shape {shape:?}: expected [{environments}, steps, {WIDTH}]; the last \
             axis holds three numbers of translation, three of rotation and the gripper, each in \
             -1..1"
        ))),
    }
}

/// Each thread, the calling one included, takes the next pending task. Returns the error of each
/// task, in their order.
fn run<T: Send>(
    tasks: Vec<T>,
    threads: usize,
    execute: impl Fn(T) -> PyResult<()> + Sync,
) -> Vec<Option<PyErr>> {
    let errors = Mutex::new(Vec::from_iter(tasks.iter().map(|_| None)));
    let pending = Mutex::new(tasks.into_iter().enumerate());
    let work = || {
        loop {
            let next = pending.lock().expect("no panic under the lock").next();
            let Some((at, task)) = next else { break };
            if let Err(error) = execute(task) {
                errors.lock().expect("no panic under the lock")[at] = Some(error);
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads {
            scope.spawn(work);
        }
        work();
    });
    errors.into_inner().expect("no panic under the lock")
}
