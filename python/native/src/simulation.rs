//! Python class of one environment. `python/rollout_libero/_native.pyi` states units and frames.

use std::sync::Arc;

use benchmark::Predicate;
use builtin_policies::expert::Expert;
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
use crate::state::{Snapshot, State, pairs, picture_size, robot_readings, shaped, with_drawer};

#[pyclass(frozen, module = "rollout_libero._native")]
pub(crate) struct Simulation {
    #[pyo3(get)]
    scene: Py<Scene>,
    renderer: Renderer,
    pub(crate) state: Guarded<State>,
}

#[pymethods]
impl Simulation {
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

    #[getter]
    fn renderer(&self) -> String {
        self.renderer.to_string()
    }

    fn close(&self) -> PyResult<()> {
        self.state.close()
    }

    #[pyo3(signature = (generator, joint_sampler_rounds, *, hard = true))]
    fn reset<'py>(
        &self,
        py: Python<'py>,
        generator: Generator<'py>,
        joint_sampler_rounds: u32,
        hard: bool,
    ) -> PyResult<(Generator<'py>, u32)> {
        let mut rng = generator::read(&generator)?;
        let kind = if hard { Reset::Hard } else { Reset::Soft };
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

    fn load(&self, py: Python<'_>, state: Numbers<'_>) -> PyResult<()> {
        let numbers = numbers(&state);
        self.state.with(py, |state| {
            check_width(&state.environment, &numbers)?;
            state.end_rollout();
            state.environment.load(&numbers);
            Ok(())
        })
    }

    fn begin(&self, py: Python<'_>, row: &str) -> PyResult<()> {
        let start = Start::read(row)?;
        self.state.with(py, |state| state.begin(&start))
    }

    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let state = self.state.with(py, |state| Ok(state.environment.state()))?;
        Ok(PyArray1::from_vec(py, state))
    }

    fn set_state(&self, py: Python<'_>, state: Numbers<'_>) -> PyResult<()> {
        let numbers = numbers(&state);
        self.state.with(py, |state| {
            check_width(&state.environment, &numbers)?;
            state.environment.set_state(&numbers);
            Ok(())
        })
    }

    fn snapshot(&self, py: Python<'_>) -> PyResult<Snapshot> {
        self.state.with(py, State::snapshot)
    }

    fn restore(&self, py: Python<'_>, snapshot: &Snapshot) -> PyResult<()> {
        self.state.with(py, |state| {
            state.check_scene(snapshot)?;
            state.restore(snapshot);
            Ok(())
        })
    }

    fn forward(&self, py: Python<'_>) -> PyResult<()> {
        self.state.with(py, |state| {
            state.environment.forward();
            Ok(())
        })
    }

    fn post_process(&self, py: Python<'_>) -> PyResult<()> {
        self.state.with(py, |state| {
            state.environment.post_process();
            Ok(())
        })
    }

    fn observe_now(&self, py: Python<'_>) -> PyResult<()> {
        self.state.with(py, |state| {
            state.environment.observe_now();
            Ok(())
        })
    }

    #[pyo3(signature = (action, *, absolute = false))]
    fn step(&self, py: Python<'_>, action: Numbers<'_>, absolute: bool) -> PyResult<bool> {
        let action = actions(&action, &[WIDTH])?[0];
        let frame = action_frame(absolute);
        self.state.with(py, |state| state.step(&action, frame))
    }

    fn success(&self, py: Python<'_>) -> PyResult<bool> {
        self.state.with(py, |state| Ok(state.environment.succeeded()))
    }

    fn predicate(&self, py: Python<'_>, state: Vec<String>) -> PyResult<bool> {
        let [name, arguments @ ..] = &state[..] else {
            return Err(invalid("a predicate has a name and arguments"));
        };
        let predicate = Predicate { name: name.clone(), arguments: arguments.to_vec() };
        self.state.with(py, |state| state.environment.holds(predicate).map_err(invalid))
    }

    fn readings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let robot = self.state.with(py, |state| Ok(state.environment.robot_state()))?;
        let dict = PyDict::new(py);
        for (name, values) in robot_readings(&robot) {
            dict.set_item(name, PyArray1::from_slice(py, values))?;
        }
        Ok(dict)
    }

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

    fn planes(&self, py: Python<'_>) -> PyResult<[f64; 3]> {
        self.state.with(py, |state| Ok(state.environment.model().planes()))
    }

    fn controller_pose<'py>(&self, py: Python<'py>) -> PyResult<Pose<'py>> {
        let pose = self.state.with(py, |state| Ok(state.environment.controller_pose()))?;
        Ok((shaped(py, pose.0.to_vec(), &[3])?, shaped(py, pose.1.to_vec(), &[3, 3])?))
    }

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

    fn data_array<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let (values, rows) = self.state.with(py, |state| data_array(state, name))?;
        Ok(by_rows(py, values, rows)?.into_any())
    }

    fn names(&self, py: Python<'_>, kind: &str) -> PyResult<Vec<Option<String>>> {
        let kind = object_kind(kind)?;
        self.state.with(py, |state| {
            let model = state.environment.model();
            Ok((0..model.count(kind)).map(|id| model.name(kind, id)).collect())
        })
    }

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

type Pose<'py> = (Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>);

fn numbers(given: &Numbers<'_>) -> Vec<f64> {
    given.as_array().iter().copied().collect()
}

pub(crate) fn action_frame(absolute: bool) -> ActionFrame {
    if absolute { ActionFrame::Absolute } else { ActionFrame::Relative }
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

/// Read-only, because a write to the copy would have no effect on the simulation.
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
