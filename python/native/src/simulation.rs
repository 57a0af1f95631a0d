//! Python class of one environment. `python/rollout_libero/_native.pyi` states units and frames.

use std::sync::Arc;

use expert::Expert;
use libero_ctrl::Predicate;
use numpy::{PyArray1, PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sim::mujoco::{Model, OwnArray, Values};
use sim::{ActionFrame, Environment, ObjectKind, Renderer, Reset};

use crate::action::{Numbers, WIDTH, actions};
use crate::captured::CapturedView;
use crate::error::{invalid, simulation};
use crate::generator::{self, Generator};
use crate::guarded::Guarded;
use crate::plus::PlusPath;
use crate::scene::Scene;
use crate::start::{Start, check_width};
use crate::state::{Snapshot, State, pairs, picture_size, shaped, with_drawer};

/// One environment of a scene.
#[pyclass(frozen, module = "rollout_libero._native")]
pub(crate) struct Simulation {
    #[pyo3(get)]
    scene: Py<Scene>,
    renderer: Renderer,
    pub(crate) state: Guarded<State>,
}

#[pymethods]
impl Simulation {
    /// Creates an environment. `change` sets the arm's posture and the view of `agentview` at
    /// resets.
    #[new]
    #[pyo3(signature = (scene, *, renderer = "software", change = None))]
    fn new(
        py: Python<'_>,
        scene: Py<Scene>,
        renderer: &str,
        change: Option<&PlusPath>,
    ) -> PyResult<Self> {
        let renderer: Renderer = renderer
            .parse()
            .map_err(|remedy| invalid(format_args!("choose renderer `{renderer}`: {remedy}")))?;
        let compiled = Arc::clone(&scene.get().compiled);
        let ready = scene.get().ready.clone();
        let mut environment =
            py.detach(|| Environment::before_load(compiled).map_err(simulation))?;
        if let Some(posture) = change.and_then(PlusPath::posture) {
            environment.set_reset_joints(posture).map_err(simulation)?;
        }
        let state = State {
            camera: change.and_then(|change| change.camera(scene.get())),
            environment,
            conditions: None,
            expert: Expert::default(),
            ready,
            renderer,
        };
        Ok(Self { scene, renderer, state: Guarded::new(state) })
    }

    /// Renderer of the frames: `software`, `gl` or `gl:N`.
    #[getter]
    fn renderer(&self) -> String {
        self.renderer.to_string()
    }

    /// Frees the environment; later calls raise `ClosedError`.
    fn close(&self) -> PyResult<()> {
        self.state.close()
    }

    /// Resets like robosuite: places all objects with LIBERO's samplers, which draw from
    /// NumPy's legacy generator, and observes once. `joint_sampler_rounds` is the number of
    /// times that the original has loaded its model at the end of this reset: once in the
    /// constructor, and once per hard reset. Returns the generator's state after the reset and the
    /// number of rounds, which is larger than the given number if placements were drawn again for
    /// lack of room.
    #[pyo3(signature = (generator, joint_sampler_rounds, *, hard = true))]
    fn reset<'py>(
        &self,
        py: Python<'py>,
        generator: Generator<'py>,
        joint_sampler_rounds: u32,
        hard: bool,
    ) -> PyResult<(Generator<'py>, u32)> {
        let mut rng = generator::read(&generator)?;
        let kind = match hard {
            true => Reset::Hard,
            false => Reset::Soft,
        };
        let (rng, rounds) = self.state.with(py, move |state| {
            state.end_rollout();
            let reset = state.environment.reset(&mut rng, kind, joint_sampler_rounds);
            let rounds = reset.map_err(simulation)?;
            if let (Reset::Hard, Some(pose)) = (kind, state.camera) {
                state.environment.place_camera(pose).map_err(simulation)?;
            }
            Ok((rng, rounds))
        })?;
        Ok((generator::write(py, &rng), rounds))
    }

    /// Loads a state (time, qpos, qvel) as the start of an episode, as a campaign does.
    fn load(&self, py: Python<'_>, state: Numbers<'_>) -> PyResult<()> {
        let numbers = numbers(&state);
        self.state.with(py, |state| {
            check_width(&state.environment, &numbers)?;
            state.end_rollout();
            state.environment.load(&numbers);
            Ok(())
        })
    }

    /// Starts the rollout of a manifest row, JSON, up to the policy's first action.
    fn begin(&self, py: Python<'_>, row: &str) -> PyResult<()> {
        let start = Start::read(row)?;
        self.state.with(py, |state| state.begin(&start))
    }

    /// Returns the state: time, qpos, qvel.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let state = self.state.with(py, |state| Ok(state.environment.state()))?;
        Ok(PyArray1::from_vec(py, state))
    }

    /// Sets the state without computing derived quantities.
    fn set_state(&self, py: Python<'_>, state: Numbers<'_>) -> PyResult<()> {
        let numbers = numbers(&state);
        self.state.with(py, |state| {
            check_width(&state.environment, &numbers)?;
            state.environment.set_state(&numbers);
            Ok(())
        })
    }

    /// Takes a snapshot of everything that the next step depends on.
    fn snapshot(&self, py: Python<'_>) -> PyResult<Snapshot> {
        self.state.with(py, State::snapshot)
    }

    /// Restores a snapshot of an environment of the same scene.
    fn restore(&self, py: Python<'_>, snapshot: &Snapshot) -> PyResult<()> {
        self.state.with(py, |state| {
            state.check_scene(snapshot)?;
            state.restore(snapshot);
            Ok(())
        })
    }

    /// Computes the quantities derived from the state (`mj_forward`).
    fn forward(&self, py: Python<'_>) -> PyResult<()> {
        self.state.with(py, |state| {
            state.environment.forward();
            Ok(())
        })
    }

    /// Updates the glow of stoves.
    fn post_process(&self, py: Python<'_>) -> PyResult<()> {
        self.state.with(py, |state| {
            state.environment.post_process();
            Ok(())
        })
    }

    /// Updates the observation to the current state.
    fn observe_now(&self, py: Python<'_>) -> PyResult<()> {
        self.state.with(py, |state| {
            state.environment.observe_now();
            Ok(())
        })
    }

    /// Executes one control step. Returns true if the goal holds after it.
    #[pyo3(signature = (action, *, absolute = false))]
    fn step(&self, py: Python<'_>, action: Numbers<'_>, absolute: bool) -> PyResult<bool> {
        let action = actions(&action, &[WIDTH])?[0];
        let frame = action_frame(absolute);
        self.state.with(py, |state| state.step(&action, frame))
    }

    /// Returns true if the goal holds.
    fn success(&self, py: Python<'_>) -> PyResult<bool> {
        self.state.with(py, |state| Ok(state.environment.succeeded()))
    }

    /// Returns true if a predicate holds, given by its name and arguments.
    fn predicate(&self, py: Python<'_>, state: Vec<String>) -> PyResult<bool> {
        let [name, arguments @ ..] = &state[..] else {
            return Err(invalid("a predicate has a name and arguments"));
        };
        let predicate = Predicate { name: name.clone(), arguments: arguments.to_vec() };
        self.state.with(py, |state| state.environment.holds(predicate).map_err(invalid))
    }

    /// Returns the robot's readings at the last observation.
    fn readings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let robot = self.state.with(py, |state| Ok(state.environment.robot_state()))?;
        let readings = PyDict::new(py);
        for (name, values) in [
            ("eef_pos", robot.eef_pos.as_slice()),
            ("eef_quat", &robot.eef_quat_xyzw),
            ("eef_axis_angle", &robot.eef_axis_angle),
            ("joint_pos", &robot.joint_pos),
            ("joint_vel", &robot.joint_vel),
            ("gripper_qpos", &robot.gripper_pos),
            ("gripper_qvel", &robot.gripper_vel),
        ] {
            readings.set_item(name, PyArray1::from_slice(py, values))?;
        }
        Ok(readings)
    }

    /// Returns position and quaternion (x y z w) of a body at the last observation.
    fn body_pose<'py>(&self, py: Python<'py>, body: &str) -> PyResult<Pose<'py>> {
        let (pos, quat) = self.state.with(py, |state| {
            let environment = &mut state.environment;
            let id = environment.model().id(ObjectKind::Body, body);
            Ok(environment.observed_body(id.map_err(simulation)?))
        })?;
        Ok((
            PyArray1::from_slice(py, &pos).to_dyn().clone(),
            PyArray1::from_slice(py, &quat).to_dyn().clone(),
        ))
    }

    /// Renders a frame, [height, width, 3]; row 0 is the bottom.
    fn frame<'py>(
        &self,
        py: Python<'py>,
        camera: &str,
        width: u32,
        height: u32,
    ) -> PyResult<Bound<'py, PyArrayDyn<u8>>> {
        let size = picture_size(width, height)?;
        let frame = self.state.with(py, |state| state.frame(camera, size))?;
        shaped(py, frame.rgb, &[height as usize, width as usize, 3])
    }

    /// Renders OpenGL depth values, [height, width]: 0 at the near plane, 1 at the far plane; row 0
    /// is the bottom.
    fn depth<'py>(
        &self,
        py: Python<'py>,
        camera: &str,
        width: u32,
        height: u32,
    ) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let size = picture_size(width, height)?;
        let depths = self.state.with(py, |state| {
            let environment = &mut state.environment;
            with_drawer(state.renderer, |drawer| environment.depth(drawer, camera, size))
        })?;
        shaped(py, depths, &[height as usize, width as usize])
    }

    /// Renders the kind (mjtObj) and id of the object at each pixel, [height, width, 2]; -1
    /// for the background; row 0 is the bottom.
    fn segmentation<'py>(
        &self,
        py: Python<'py>,
        camera: &str,
        width: u32,
        height: u32,
    ) -> PyResult<Bound<'py, PyArrayDyn<i32>>> {
        let size = picture_size(width, height)?;
        let segments = self.state.with(py, |state| {
            let environment = &mut state.environment;
            with_drawer(state.renderer, |drawer| environment.segmentation(drawer, camera, size))
        })?;
        shaped(py, pairs(segments), &[height as usize, width as usize, 2])
    }

    /// Captures the current camera views for deferred rendering.
    fn capture(&self, py: Python<'_>) -> PyResult<CapturedView> {
        self.state.with(py, |state| {
            Ok(CapturedView {
                captured: state.environment.capture(),
                compiled: Arc::clone(state.environment.compiled()),
                renderer: self.renderer,
                state: self.state.clone(),
            })
        })
    }

    /// Returns the model's extent, m, and the distances of the cameras' near and far planes, as
    /// multiples of the extent.
    fn planes(&self, py: Python<'_>) -> PyResult<[f64; 3]> {
        self.state.with(py, |state| Ok(state.environment.model().planes()))
    }

    /// Returns position and rotation matrix of the end-effector at the controller's last
    /// update.
    fn controller_pose<'py>(&self, py: Python<'py>) -> PyResult<Pose<'py>> {
        let pose = self.state.with(py, |state| Ok(state.environment.controller_pose()))?;
        Ok((shaped(py, pose.0.to_vec(), &[3])?, shaped(py, pose.1.to_vec(), &[3, 3])?))
    }

    /// Returns an array of the model, by MuJoCo's name.
    fn model_array<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let array = self.state.with(py, |state| {
            state.environment.model().array(name).ok_or_else(|| {
                invalid(format_args!(
                    "read array `{name}` of the model: it has no array of this name; names are \
                     those of mjModel, without meshes and textures"
                ))
            })
        })?;
        let rows = array.rows;
        Ok(match array.values {
            Values::Double(values) => by_rows(py, values, rows)?.into_any(),
            Values::Single(values) => by_rows(py, values, rows)?.into_any(),
            Values::Integer(values) => by_rows(py, values, rows)?.into_any(),
        })
    }

    /// Sets an array of the model, for this simulation only.
    fn set_model_array(&self, py: Python<'_>, name: &str, values: Numbers<'_>) -> PyResult<()> {
        let numbers = numbers(&values);
        self.state.with(py, |state| {
            let array = state.environment.model_mut().own_array_mut(name);
            let array = array.ok_or_else(|| {
                invalid(format_args!(
                    "write array `{name}` of the model: writable arrays are {}",
                    Model::OWN_ARRAYS.join(", ")
                ))
            })?;
            let needed = match &array {
                OwnArray::Double(values) => values.len(),
                OwnArray::Single(values) => values.len(),
            };
            if numbers.len() != needed {
                return Err(invalid(format_args!(
                    "write array `{name}` of the model: {} numbers were given, {needed} are needed",
                    numbers.len()
                )));
            }
            match array {
                OwnArray::Double(values) => values.copy_from_slice(&numbers),
                OwnArray::Single(values) => {
                    for (value, number) in values.iter_mut().zip(numbers) {
                        *value = number as f32;
                    }
                }
            }
            Ok(())
        })
    }

    /// Returns an array of the current `mjData`, by MuJoCo's name.
    fn data_array<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let (values, rows) = self.state.with(py, |state| data_array(state, name))?;
        Ok(by_rows(py, values, rows)?.into_any())
    }

    /// Returns the names of all objects of a kind, in order of ids; `None` for one without a name.
    fn names(&self, py: Python<'_>, kind: &str) -> PyResult<Vec<Option<String>>> {
        let kind = object_kind(kind)?;
        self.state.with(py, |state| {
            let model = state.environment.model();
            Ok((0..model.count(kind)).map(|id| model.name(kind, id)).collect())
        })
    }

    /// Returns the pairs of geoms in contact, [contacts, 2].
    fn contacts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<i32>>> {
        let geoms: Vec<i32> = self.state.with(py, |state| {
            let contacts = state.environment.data().contacts();
            Ok(contacts.flat_map(|contact| contact.geoms).collect())
        })?;
        let pairs = geoms.len() / 2;
        shaped(py, geoms, &[pairs, 2])
    }
}

impl Simulation {
    pub(crate) fn draws_through_opengl(&self) -> bool {
        self.renderer != Renderer::Software
    }
}

/// A position, and an orientation as a quaternion or a rotation matrix.
type Pose<'py> = (Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>);

fn numbers(given: &Numbers<'_>) -> Vec<f64> {
    given.as_array().iter().copied().collect()
}

/// Returns the action frame selected by a flag.
pub(crate) fn action_frame(absolute: bool) -> ActionFrame {
    match absolute {
        true => ActionFrame::Absolute,
        false => ActionFrame::Relative,
    }
}

fn object_kind(name: &str) -> PyResult<ObjectKind> {
    const KINDS: [(&str, ObjectKind); 8] = [
        ("body", ObjectKind::Body),
        ("joint", ObjectKind::Joint),
        ("geom", ObjectKind::Geom),
        ("site", ObjectKind::Site),
        ("camera", ObjectKind::Camera),
        ("light", ObjectKind::Light),
        ("actuator", ObjectKind::Actuator),
        ("sensor", ObjectKind::Sensor),
    ];
    let found = KINDS.iter().find(|(kind, _)| *kind == name);
    found.map(|(_, kind)| *kind).ok_or_else(|| {
        invalid(format_args!(
            "list names of kind `{name}`: kinds are {}",
            KINDS.map(|(kind, _)| kind).join(", ")
        ))
    })
}

/// Returns an array of `mjData` and its length along the first axis.
fn data_array(state: &State, name: &str) -> PyResult<(Vec<f64>, usize)> {
    let (model, data) = (state.environment.model(), state.environment.data());
    let [bodies, geoms, sites, cameras] =
        [ObjectKind::Body, ObjectKind::Geom, ObjectKind::Site, ObjectKind::Camera]
            .map(|kind| model.count(kind));
    let time = [data.time_secs()];
    let (values, rows): (&[f64], usize) = match name {
        "time" => (&time, 1),
        "qpos" => (data.qpos(model), model.nq()),
        "qvel" => (data.qvel(model), model.nv()),
        "qacc" => (data.qacc(model), model.nv()),
        "ctrl" => (data.ctrl(model), model.nu()),
        "qfrc_bias" => (data.qfrc_bias(model), model.nv()),
        "sensordata" => (data.sensordata(model), data.sensordata(model).len()),
        "xpos" => (data.xpos(model), bodies),
        "xquat" => (data.xquat(model), bodies),
        "xmat" => (data.xmat(model), bodies),
        "xipos" => (data.xipos(model), bodies),
        "geom_xpos" => (data.geom_xpos(model), geoms),
        "geom_xmat" => (data.geom_xmat(model), geoms),
        "site_xpos" => (data.site_xpos(model), sites),
        "site_xmat" => (data.site_xmat(model), sites),
        "cam_xpos" => (data.cam_xpos(model), cameras),
        "cam_xmat" => (data.cam_xmat(model), cameras),
        _ => {
            return Err(invalid(format_args!(
                "read array `{name}` of the state: it has time, qpos, qvel, qacc, ctrl, qfrc_bias, \
                 sensordata, xpos, xquat, xmat, xipos, geom_xpos, geom_xmat, site_xpos, site_xmat, \
                 cam_xpos, cam_xmat"
            )));
        }
    };
    Ok((values.to_vec(), rows))
}

/// Creates an array with `rows` rows. The array is read-only, because it is a copy: a write to it
/// would have no effect on the simulation.
fn by_rows<'py, T: numpy::Element>(
    py: Python<'py>,
    values: Vec<T>,
    rows: usize,
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let columns = values.len().checked_div(rows).unwrap_or(1);
    let shape = match columns {
        1 => vec![rows],
        _ => vec![rows, columns],
    };
    let array = shaped(py, values, &shape)?;
    let flags = PyDict::new(py);
    flags.set_item("write", false)?;
    array.call_method("setflags", (), Some(&flags))?;
    Ok(array)
}
