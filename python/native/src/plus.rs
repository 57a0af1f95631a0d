//! LIBERO-Plus: its variants, the changes that the path of a BDDL file names, and the corruption of
//! pictures.

use std::path::PathBuf;

use benchmark::Suite;
use benchmark::family::corruption;
use benchmark::family::plus::{self, BddlPath, CameraPose, Entry, ProblemClass, Variant};
use benchmark::family::plus::{Prompt, entry, inventory, start_posture};
use numpy::{PyArray1, PyArrayDyn, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use scene::Sources;
use sim::written_camera;

use crate::error::{self, value};
use crate::generator::{self, Generator};
use crate::state::shaped;

#[pyclass(frozen, module = "rollout_libero._native")]
pub(crate) struct PlusVariant(&'static Entry);

#[pymethods]
impl PlusVariant {
    #[staticmethod]
    fn of_suite(suite: &str) -> PyResult<Vec<Self>> {
        let suite: Suite = suite.parse().map_err(value)?;
        let entries = inventory().iter();
        let entries = entries.filter(|entry| entry.variant.task.suite() == suite);
        Ok(entries.map(Self).collect())
    }

    #[staticmethod]
    fn find(name: &str) -> Option<Self> {
        let variant: Variant = name.parse().ok()?;
        entry(&variant).map(Self)
    }

    #[getter]
    fn name(&self) -> String {
        self.0.variant.to_string()
    }

    #[getter]
    fn id(&self) -> u16 {
        self.0.id
    }

    #[getter]
    fn category(&self) -> &'static str {
        self.0.dimension().category()
    }

    #[getter]
    fn difficulty(&self) -> Option<u8> {
        self.0.difficulty
    }

    #[getter]
    fn states_file(&self) -> String {
        self.0.variant.states_file()
    }

    #[getter]
    fn has_one_state(&self) -> bool {
        self.0.variant.has_one_state()
    }

    #[getter]
    fn has_own_sentence(&self) -> bool {
        matches!(self.0.variant.change, plus::Change::Language(_))
    }

    fn prompt(&self, sentence: &str) -> String {
        Prompt::Released.of(&self.0.variant, sentence)
    }

    fn lack(&self, assets: &str, sources: PathBuf) -> PyResult<Option<String>> {
        let sources = Sources::open(&sources).map_err(error::scene)?;
        let pack = crate::scene::opened_pack(assets, &sources).map_err(error::scene)?;
        let is_composable = self.0.is_composable(|file| pack.dir().join(file).is_file());
        let assets = self.0.assets();
        Ok((!is_composable).then(|| format!("{assets}, which no package index has")))
    }
}

#[pyfunction]
pub(crate) fn plus_problem_parent(problem: &str) -> Option<&'static str> {
    ProblemClass::parse(problem).ok().map(|class| class.parent)
}

#[pyclass(frozen, module = "rollout_libero._native")]
pub(crate) struct PlusPath(BddlPath);

#[pymethods]
impl PlusPath {
    #[new]
    fn new(path: &str) -> PyResult<Self> {
        BddlPath::parse(path).map(Self).map_err(value)
    }

    #[getter]
    fn file(&self) -> &str {
        &self.0.file
    }

    #[getter]
    fn noise(&self) -> u8 {
        self.0.corruption.map_or(0, corruption::Corruption::number)
    }

    #[getter(posture)]
    fn posture_array<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.posture().map(|posture| PyArray1::from_slice(py, &posture))
    }

    fn check(&self, height: usize, width: usize) -> PyResult<()> {
        let Some(corruption) = self.0.corruption else {
            return Ok(());
        };
        let checked = corruption.check(height, width, height * width * CHANNELS);
        checked.map_err(value)
    }

    fn skip<'py>(
        &self,
        py: Python<'py>,
        generator: Generator<'py>,
        height: usize,
        width: usize,
    ) -> PyResult<Generator<'py>> {
        let mut rng = generator::read(&generator)?;
        let rng = py.detach(move || {
            if let Some(corruption) = self.0.corruption {
                corruption.skip(height, width, &mut rng);
            }
            rng
        });
        Ok(generator::write(py, &rng))
    }

    fn corrupted<'py>(
        &self,
        py: Python<'py>,
        generator: Generator<'py>,
        picture: PyReadonlyArray3<'py, u8>,
    ) -> PyResult<Bound<'py, PyArrayDyn<u8>>> {
        let mut rng = generator::read(&generator)?;
        let &[height, width, channels] = picture.shape() else {
            unreachable!("an array of three axes")
        };
        let mut rgb: Vec<u8> = picture.as_array().iter().copied().collect();
        let rgb = py.detach(|| {
            if let Some(corruption) = self.0.corruption {
                let mut picture = corruption::Picture { height, width, rgb: &mut rgb };
                corruption.apply(&mut picture, &mut rng).map_err(value)?;
            }
            Ok::<_, PyErr>(rgb)
        })?;
        shaped(py, rgb, &[height, width, channels])
    }
}

const CHANNELS: usize = 3;

impl PlusPath {
    /// Returns the angles of the arm's joints at resets, rad; `None` for LIBERO's.
    pub(crate) fn posture(&self) -> Option<[f64; 7]> {
        self.0.robot.and_then(start_posture)
    }

    /// Returns the pose of `agentview` in a scene; `None` if the scene's arena sets no pose.
    pub(crate) fn camera(&self, scene: &crate::scene::Scene) -> Option<CameraPose> {
        written_camera(&scene.problem.name).map(|nominal| self.0.view.apply(nominal))
    }
}
