//! Compiled scenes.

use std::ffi::CString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use libero_ctrl::Look;
use libero_ctrl::presets::ENV_SEED;
use pyo3::exceptions::PyRuntimeWarning;
use pyo3::prelude::*;
use scene::{InstanceKind, Sources, TaskFiles, compose};
use sim::{CompiledScene, ReadyScene, SceneFolder};

use crate::error;
use crate::error::invalid;
use crate::pack::{opened, opened_for};

/// A compiled scene, shared by all its simulations.
#[pyclass(frozen, weakref, module = "rollout_libero._native")]
pub(crate) struct Scene {
    pub(crate) compiled: Arc<CompiledScene>,
    /// The scene with the task's initial states; `None` if no file of states was given.
    pub(crate) ready: Option<Arc<ReadyScene>>,
    pub(crate) problem: scene::Problem,
    #[pyo3(get)]
    bddl_file: PathBuf,
    #[pyo3(get)]
    pack: String,
    look: Look,
    #[pyo3(get)]
    digest: String,
    /// Files in which the pack differs from LIBERO's.
    #[pyo3(get)]
    pack_differences: Vec<String>,
}

/// Instances with their categories.
type Instances = Vec<(String, &'static str)>;

#[pymethods]
impl Scene {
    /// Compiles the scene of a BDDL file, or maps the stored scene into memory if this machine has
    /// compiled it before.
    /// `init_file` provides the initial states of rollouts.
    /// `look` is one of `LOOKS`.
    #[new]
    #[pyo3(signature = (bddl_file, *, assets, sources, look, init_file = None))]
    fn new(
        py: Python<'_>,
        bddl_file: PathBuf,
        assets: &str,
        sources: PathBuf,
        look: &str,
        init_file: Option<PathBuf>,
    ) -> PyResult<Self> {
        let look = look.parse().map_err(|error| invalid(format_args!("{error}")))?;
        let scene = py.detach(|| Self::compile(bddl_file, assets, &sources, look, init_file))?;
        if let Some(problem) = SceneFolder::take_problem() {
            let problem = CString::new(problem)?;
            PyErr::warn(py, &py.get_type::<PyRuntimeWarning>(), &problem, 1)?;
        }
        Ok(scene)
    }

    /// Problem class, such as `libero_tabletop_manipulation`.
    #[getter]
    fn problem(&self) -> &str {
        &self.problem.name
    }

    /// Instruction given in the BDDL file.
    #[getter]
    fn language(&self) -> &str {
        &self.problem.language
    }

    #[getter]
    fn look(&self) -> &'static str {
        self.look.name()
    }

    #[getter]
    fn objects(&self) -> Instances {
        self.instances(InstanceKind::Object)
    }

    #[getter]
    fn fixtures(&self) -> Instances {
        self.instances(InstanceKind::Fixture)
    }

    #[getter]
    fn objects_of_interest(&self) -> Vec<String> {
        self.problem.objects_of_interest.clone()
    }

    #[getter]
    fn goal(&self) -> Vec<Vec<String>> {
        let goal = self.problem.goal.iter();
        goal.map(|predicate| {
            let name = std::iter::once(&predicate.name);
            name.chain(&predicate.arguments).cloned().collect()
        })
        .collect()
    }

    /// Number of initial states.
    #[getter]
    fn initial_states(&self) -> usize {
        self.ready.as_ref().map_or(0, |ready| ready.states().count())
    }

    /// Returns the name of an instance's root body.
    fn root_body(&self, instance: &str) -> PyResult<&str> {
        Ok(&self.instance(instance)?.root_body)
    }

    /// Returns the names of an instance's joints; an object's free joint is the last.
    fn joints(&self, instance: &str) -> PyResult<Vec<String>> {
        Ok(self.instance(instance)?.joints.clone())
    }
}

impl Scene {
    fn compile(
        bddl_file: PathBuf,
        assets: &str,
        sources: &Path,
        look: Look,
        init_file: Option<PathBuf>,
    ) -> PyResult<Self> {
        let sources = Sources::open(sources).map_err(error::scene)?;
        let files =
            TaskFiles { bddl: bddl_file.clone(), init: init_file.clone().unwrap_or_default() };
        let named_pack = opened(assets, &sources).map_err(error::scene)?;
        let pack = opened_for(&files, assets, &sources).map_err(error::scene)?.with_look(look);
        let problem = files.problem().map_err(error::scene)?;
        let (compiled, ready) = if init_file.is_some() {
            let ready = ReadyScene::compile(files, &pack, &sources).map_err(error::simulation)?;
            (Arc::clone(ready.compiled()), Some(Arc::new(ready)))
        } else {
            let scene = compose(&problem, &pack, &sources, ENV_SEED).map_err(error::scene)?;
            let compiled =
                CompiledScene::compile(scene, &pack, &sources).map_err(error::simulation)?;
            (Arc::new(compiled), None)
        };
        Ok(Self {
            digest: compiled.scene().digest(),
            compiled,
            ready,
            problem,
            bddl_file,
            pack: named_pack.name().to_owned(),
            look,
            pack_differences: named_pack.differences().to_vec(),
        })
    }

    fn instances(&self, kind: InstanceKind) -> Instances {
        let instances = self.compiled.scene().instances.iter();
        instances
            .filter(|instance| instance.kind == kind)
            .map(|instance| (instance.name.clone(), instance.category.name))
            .collect()
    }

    fn instance(&self, name: &str) -> PyResult<&scene::Instance> {
        self.compiled.scene().instance(name).ok_or_else(|| {
            let names: Vec<&str> = self
                .compiled
                .scene()
                .instances
                .iter()
                .map(|instance| instance.name.as_str())
                .collect();
            invalid(format_args!(
                "find instance `{name}` in the scene: it has {}",
                names.join(", ")
            ))
        })
    }
}
