//! Reads the reference data of one task. The README of the data describes the layout of
//! the folder.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use npyz::npz::array_name_from_file_name;
use npyz::{DType, NpyFile, TypeChar};
use serde_json::Value;
use zip::ZipArchive;

#[derive(Debug, Clone)]
pub struct ReferenceTask {
    /// Suite's full name.
    pub suite: String,
    /// Index in the suite.
    pub index: usize,
    dir: PathBuf,
    /// Folder whose files replace those of `dir`.
    overlay: Option<PathBuf>,
    /// Folder of the recordings that cover several tasks.
    root: PathBuf,
    meta: Value,
}

/// A named array, widened to doubles.
#[derive(Debug, Clone)]
pub struct Array {
    /// Sizes along its axes.
    pub shape: Vec<usize>,
    /// Values, last axis fastest.
    pub values: Vec<f64>,
}

impl Array {
    pub fn row(&self, index: usize) -> &[f64] {
        let width: usize = self.shape[1..].iter().product();
        &self.values[index * width..(index + 1) * width]
    }

    pub(crate) fn len(&self) -> usize {
        self.shape.first().copied().unwrap_or_default()
    }
}

/// Finds all tasks in a folder, ordered by suite and index. Files in `overlay`, a folder of the same
/// layout, replace theirs.
pub fn find_tasks(reference: &Path, overlay: Option<&Path>) -> Result<Vec<ReferenceTask>> {
    ensure!(
        reference.is_dir(),
        "read the reference {}: no such folder; --reference takes the folder that holds \
         SUITE/NN_TASK folders",
        reference.display()
    );
    // A path of `.` or `..` does not name its parent folder.
    let absolute = reference.canonicalize()?;
    let root = absolute.parent().unwrap_or(&absolute);
    let mut tasks = Vec::new();
    for suite in folders(reference)? {
        for dir in folders(&suite)? {
            let name = dir.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let Some(index) = name.split('_').next().and_then(|number| number.parse().ok()) else {
                continue;
            };
            let path = dir.join("meta.json");
            let text = std::fs::read_to_string(&path)
                .with_context(|| format!("read {}", path.display()))?;
            let meta = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
            let suite = suite.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let overlay = overlay.map(|overlay| overlay.join(&suite).join(&name));
            let root = root.to_owned();
            tasks.push(ReferenceTask { suite, index, dir, overlay, root, meta });
        }
    }
    tasks.sort_by_key(|task| (task.suite.clone(), task.index));
    if tasks.is_empty() {
        bail!("find reference tasks below {}: there are none", reference.display());
    }
    Ok(tasks)
}

fn folders(dir: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(dir).with_context(|| format!("read {}", dir.display()))?;
    let mut folders = Vec::new();
    for entry in entries {
        let path = entry?.path();
        if path.is_dir() {
            folders.push(path);
        }
    }
    folders.sort();
    Ok(folders)
}

impl ReferenceTask {
    pub fn id(&self) -> String {
        format!("{}/{}", self.suite, self.index)
    }

    /// Returns the path of the BDDL file, relative to the LIBERO package.
    pub(crate) fn bddl(&self) -> &str {
        self.meta["bddl"].as_str().unwrap_or_default()
    }

    /// Returns the names of one kind of object, in order of ids.
    pub(crate) fn names(&self, key: &str) -> Result<Vec<Option<String>>> {
        let names = self.meta[key].as_array().with_context(|| format!("meta.json: no `{key}`"))?;
        Ok(names.iter().map(|name| name.as_str().map(str::to_owned)).collect())
    }

    pub(crate) fn path(&self, file: &str) -> PathBuf {
        let mut overlay = self.overlay.iter().map(|overlay| overlay.join(file));
        overlay.find(|path| path.is_file()).unwrap_or_else(|| self.dir.join(file))
    }

    /// Returns the path of the recording of contact-rich steps, if it exists.
    pub(crate) fn contact_path(&self) -> Option<PathBuf> {
        let path = self.root.join("contact").join(format!("{}_{:02}.npz", self.suite, self.index));
        path.is_file().then_some(path)
    }

    /// Returns the original's own sensitivity in the contact-rich steps, if measured: the
    /// running maximum, at every 20th step, of its deviation under torque noise of 1e-14.
    pub(crate) fn contact_sensitivity(&self) -> Result<Option<Vec<f64>>> {
        let path = self.root.join("sensitivity.json");
        if !path.is_file() {
            return Ok(None);
        }
        let text = std::fs::read_to_string(&path)?;
        let all: Value = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
        let sampled = all["tasks"][self.id()]["contact"].as_array();
        Ok(sampled.map(|values| values.iter().filter_map(Value::as_f64).collect()))
    }

    /// Reads the arrays of an `.npz` file in the task's folder.
    pub(crate) fn arrays(&self, file: &str) -> Result<BTreeMap<String, Array>> {
        read_npz(&self.path(file))
    }
}

pub fn read_npz(path: &Path) -> Result<BTreeMap<String, Array>> {
    let read = || format!("read {}", path.display());
    let file = File::open(path).with_context(read)?;
    let mut archive = ZipArchive::new(file).with_context(read)?;
    let members: Vec<String> = archive
        .file_names()
        .map(|name| name.map(Cow::into_owned))
        .collect::<Result<_, _>>()
        .with_context(read)?;
    let mut arrays = BTreeMap::new();
    for member in members {
        let Some(name) = array_name_from_file_name(&member).map(str::to_owned) else {
            continue;
        };
        let array = NpyFile::new(archive.by_name(&member)?)?;
        let shape = array.shape().iter().map(|size| *size as usize).collect();
        let DType::Plain(kind) = array.dtype() else {
            continue;
        };
        let size = kind.num_bytes();
        let values = match (kind.type_char(), size) {
            (TypeChar::Float, Some(8)) => array.into_vec::<f64>()?,
            (TypeChar::Float, Some(4)) => widen(array.into_vec::<f32>()?),
            (TypeChar::Int, Some(8)) => {
                array.into_vec::<i64>()?.into_iter().map(|value| value as f64).collect()
            }
            (TypeChar::Int, Some(4)) => widen(array.into_vec::<i32>()?),
            (TypeChar::Int, Some(1)) => widen(array.into_vec::<i8>()?),
            (TypeChar::Uint, Some(1)) => widen(array.into_vec::<u8>()?),
            (TypeChar::Bool, _) => array
                .into_vec::<bool>()?
                .into_iter()
                .map(|value| f64::from(u8::from(value)))
                .collect(),
            (TypeChar::UnicodeStr | TypeChar::ByteStr, _) => continue,
            (other, _) => bail!("{}: `{name}` holds {other:?}", path.display()),
        };
        arrays.insert(name, Array { shape, values });
    }
    Ok(arrays)
}

fn widen<T: Into<f64>>(values: Vec<T>) -> Vec<f64> {
    values.into_iter().map(Into::into).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn the_sensitivity_is_none_unless_measured_for_the_task() {
        let root = tempfile::tempdir().unwrap();
        let tasks = root.path().join("tasks");
        fs::create_dir_all(tasks.join("libero_goal/03_task")).unwrap();
        fs::write(tasks.join("libero_goal/03_task/meta.json"), "{}").unwrap();
        let sensitivity = || find_tasks(&tasks, None).unwrap()[0].contact_sensitivity().unwrap();
        assert_eq!(sensitivity(), None, "no file");
        let file = root.path().join("sensitivity.json");
        fs::write(&file, r#"{"tasks":{"libero_goal/4":{"contact":[1e-15]}}}"#).unwrap();
        assert_eq!(sensitivity(), None, "not of this task");
        fs::write(&file, r#"{"tasks":{"libero_goal/3":{"contact":[1e-15]}}}"#).unwrap();
        assert_eq!(sensitivity(), Some(vec![1e-15]));
    }

    #[test]
    fn recordings_beside_the_reference_are_found_however_the_folder_is_named() {
        let root = tempfile::tempdir().unwrap();
        let tasks = root.path().join("tasks");
        fs::create_dir_all(tasks.join("libero_goal/03_task")).unwrap();
        fs::write(tasks.join("libero_goal/03_task/meta.json"), "{}").unwrap();
        let contact = root.path().join("contact");
        fs::create_dir(&contact).unwrap();
        fs::write(contact.join("libero_goal_03.npz"), "").unwrap();
        for name in ["", "libero_goal/..", "libero_goal/../."] {
            let found = find_tasks(&tasks.join(name), None).unwrap();
            assert!(found[0].contact_path().is_some(), "`{name}`");
        }
    }
}
