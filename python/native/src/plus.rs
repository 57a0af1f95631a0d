//! LIBERO-Plus: its variants, the changes that the path of a BDDL file names, and the corruption of
//! pictures.

use std::path::PathBuf;

use libero_ctrl::Suite;
use libero_family::corruption;
use libero_family::plus::{self, BddlPath, CameraPose, Entry, ProblemClass, Variant};
use libero_family::plus::{Prompt, entry, inventory, start_posture};
use numpy::{PyArray1, PyArrayDyn, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use scene::Sources;
use sim::written_camera;

use crate::error::{self, value};
use crate::generator::{self, Generator};
use crate::pack::opened;
use crate::state::shaped;

/// A variant of the benchmark.
#[pyclass(frozen, module = "rollout_libero._native")]
pub(crate) struct PlusVariant(&'static Entry);

#[pymethods]
impl PlusVariant {
    /// Returns the variants of a suite, in the benchmark's order.
    #[staticmethod]
    fn of_suite(suite: &str) -> PyResult<Vec<Self>> {
        let suite: Suite = suite.parse().map_err(value)?;
        let entries = inventory().iter();
        let entries = entries.filter(|entry| entry.variant.task.suite() == suite);
        Ok(entries.map(Self).collect())
    }

    /// Finds a variant by its name; `None` if the benchmark does not have it.
    #[staticmethod]
    fn find(name: &str) -> Option<Self> {
        let variant: Variant = name.parse().ok()?;
        entry(&variant).map(Self)
    }

    /// Name of the variant, which is also the stem of its BDDL file's path.
    #[getter]
    fn name(&self) -> String {
        self.0.variant.to_string()
    }

    /// Position in the suite, from 1.
    #[getter]
    fn id(&self) -> u16 {
        self.0.id
    }

    /// Dimension of robustness, in the benchmark's words.
    #[getter]
    fn category(&self) -> &'static str {
        self.0.dimension().category()
    }

    /// Difficulty, 1 to 5; `None` if not given.
    #[getter]
    fn difficulty(&self) -> Option<u8> {
        self.0.difficulty
    }

    /// Path of the file of initial states, relative to the folder `init_files`.
    #[getter]
    fn states_file(&self) -> String {
        self.0.variant.states_file()
    }

    /// True if the file of initial states has one state, as a vector.
    #[getter]
    fn has_one_state(&self) -> bool {
        self.0.variant.has_one_state()
    }

    /// True if the prompt is the sentence of the BDDL file.
    #[getter]
    fn has_own_sentence(&self) -> bool {
        matches!(self.0.variant.change, plus::Change::Language(_))
    }

    /// Returns the released prompt. `sentence` is the BDDL file's, in lower case.
    fn prompt(&self, sentence: &str) -> String {
        Prompt::Released.of(&self.0.variant, sentence)
    }

    /// Describes the files that the variant lacks in an asset pack; `None` if it lacks none.
    fn lack(&self, assets: &str, sources: PathBuf) -> PyResult<Option<String>> {
        let sources = Sources::open(&sources).map_err(error::scene)?;
        let pack = opened(assets, &sources).map_err(error::scene)?;
        let is_composable = self.0.is_composable(|file| pack.dir().join(file).is_file());
        let assets = self.0.assets();
        Ok((!is_composable).then(|| format!("{assets}, which no package index has")))
    }
}

/// Returns the problem class of LIBERO that a class of LIBERO-Plus copies. For a class of LIBERO,
/// returns that class; for any other name, `None`.
#[pyfunction]
pub(crate) fn plus_problem_parent(problem: &str) -> Option<&'static str> {
    ProblemClass::parse(problem).ok().map(|class| class.parent)
}

/// A BDDL file and the changes that its path names.
#[pyclass(frozen, module = "rollout_libero._native")]
pub(crate) struct PlusPath(BddlPath);

#[pymethods]
impl PlusPath {
    #[new]
    fn new(path: &str) -> PyResult<Self> {
        BddlPath::parse(path).map(Self).map_err(value)
    }

    /// Path of the file to be opened.
    #[getter]
    fn file(&self) -> &str {
        &self.0.file
    }

    /// Number of the corruption of `agentview`'s pictures; 0 if there is none.
    #[getter]
    fn noise(&self) -> u8 {
        self.0.corruption.map_or(0, corruption::Corruption::number)
    }

    /// Angles of the arm's joints at resets, 7 numbers, rad; `None` for LIBERO's.
    #[getter(posture)]
    fn posture_array<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.posture().map(|posture| PyArray1::from_slice(py, &posture))
    }

    /// Checks that pictures of a size can be corrupted.
    fn check(&self, height: usize, width: usize) -> PyResult<()> {
        let Some(corruption) = self.0.corruption else {
            return Ok(());
        };
        let checked = corruption.check(height, width, height * width * CHANNELS);
        checked.map_err(value)
    }

    /// Returns the state of NumPy's generator after the corruption of a picture.
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

    /// Returns a corrupted copy of a picture, [height, width, 3]; row 0 is the bottom. The random
    /// numbers are drawn from a generator in the given state.
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

/// Channels of a picture.
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
