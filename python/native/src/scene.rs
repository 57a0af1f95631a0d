use std::collections::HashMap;
use std::ffi::CString;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use benchmark::Look;
use benchmark::presets::ENV_SEED;
use pyo3::exceptions::PyRuntimeWarning;
use pyo3::prelude::*;
use scene::{AssetPack, InstanceKind, SceneError, Sources, TaskFiles, compose};
use sim::{CompiledScene, ReadyScene, SceneFolder};

use crate::error;
use crate::error::invalid;

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
    #[pyo3(get)]
    pack_differences: Vec<String>,
}

type Instances = Vec<(String, &'static str)>;

#[pymethods]
impl Scene {
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

    #[getter]
    fn problem(&self) -> &str {
        &self.problem.name
    }

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

    #[getter]
    fn initial_states(&self) -> usize {
        self.ready.as_ref().map_or(0, |ready| ready.states().count())
    }

    fn root_body(&self, instance: &str) -> PyResult<&str> {
        Ok(&self.instance(instance)?.root_body)
    }

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
        let named_pack = opened_pack(assets, &sources).map_err(error::scene)?;
        let pack = pack_for(&files, assets, &sources).map_err(error::scene)?.with_look(look);
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

/// Packs by name or path, sources, and true if they include files that LIBERO lacks.
type Packs = HashMap<(String, PathBuf, bool), AssetPack>;

static PACKS: Mutex<Option<Packs>> = Mutex::new(None);

/// Opens a pack once per process, because comparing a folder with LIBERO's pack reads all files.
fn cached(
    key: (&str, &Sources, bool),
    open: impl FnOnce() -> Result<AssetPack, SceneError>,
) -> Result<AssetPack, SceneError> {
    let (assets, sources, is_whole) = key;
    let key = (assets.to_owned(), sources.dir().to_owned(), is_whole);
    let mut packs = PACKS.lock().unwrap_or_else(PoisonError::into_inner);
    let packs = packs.get_or_insert_default();
    if let Some(pack) = packs.get(&key) {
        return Ok(pack.clone());
    }
    let pack = open()?;
    packs.insert(key, pack.clone());
    Ok(pack)
}

/// Opens `libero`, `primitives`, or a folder.
pub(crate) fn opened_pack(assets: &str, sources: &Sources) -> Result<AssetPack, SceneError> {
    cached((assets, sources, false), || AssetPack::open(assets, sources))
}

/// If the scene needs models or textures that LIBERO lacks and the pack is a folder with LIBERO's
/// files, the pack has all files of that folder.
fn pack_for(task: &TaskFiles, assets: &str, sources: &Sources) -> Result<AssetPack, SceneError> {
    let pack = opened_pack(assets, sources)?;
    if !pack.is_too_narrow(std::iter::once(task.clone())) {
        return Ok(pack);
    }
    cached((assets, sources, true), || AssetPack::open_whole(pack.dir()))
}
