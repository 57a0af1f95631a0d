use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use benchmark::presets::{PRESETS, apply_preset};
use benchmark::{Axis, Level, Perturbation};
use npyz::NpyFile;
use zip::ZipArchive;

/// Float arrays by name, row by row.
pub(crate) type Arrays = BTreeMap<String, Vec<f64>>;

/// Returns a folder of the reference data; if there is none, prints that the test is skipped.
pub(crate) fn folder(name: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/oracle").join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: {} is not here", folder.display());
    None
}

pub(crate) fn presets(axis: Axis) -> impl Iterator<Item = (Level, u16, Perturbation)> {
    let levels = Level::PERTURBED.into_iter();
    levels.flat_map(move |level| {
        (0..PRESETS).map(move |config| {
            let mut perturbation = Perturbation::default();
            apply_preset(&mut perturbation, axis, level, config);
            (level, config, perturbation)
        })
    })
}

fn open(path: &Path) -> ZipArchive<File> {
    ZipArchive::new(File::open(path).expect("a file")).expect("an archive")
}

/// Reads the float arrays of an archive; leaves out text and integers.
pub(crate) fn arrays(path: &Path) -> Arrays {
    let mut archive = open(path);
    let names: Vec<String> =
        archive.file_names().map(|name| name.expect("a name").into_owned()).collect();
    let mut arrays = Arrays::new();
    for name in names {
        let file = archive.by_name(&name).expect("listed");
        let file = NpyFile::new(file).expect("an array");
        let descr = file.dtype().descr();
        let values = if descr.contains("<f8") {
            file.into_vec::<f64>().expect("doubles")
        } else if descr.contains("<f4") {
            let floats = file.into_vec::<f32>().expect("floats");
            floats.into_iter().map(f64::from).collect()
        } else {
            continue;
        };
        let name = name.strip_suffix(".npy").expect("an array's name");
        arrays.insert(name.to_owned(), values);
    }
    arrays
}

pub(crate) fn integers(path: &Path, name: &str) -> Vec<i64> {
    let mut archive = open(path);
    let file = archive.by_name(&format!("{name}.npy")).expect("listed");
    let file = NpyFile::new(file).expect("an array");
    if file.dtype().descr().contains("<i4") {
        let narrow = file.into_vec::<i32>().expect("integers");
        return narrow.into_iter().map(i64::from).collect();
    }
    file.into_vec::<i64>().expect("integers")
}

/// Returns the tasks of the reference and the paths of their model arrays: `goal_t0`, ...
pub(crate) fn models(folder: &Path) -> Vec<(String, PathBuf)> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut models: Vec<(String, PathBuf)> = entries
        .map(|entry| entry.expect("an entry").path())
        .filter_map(|path| {
            let stem = path.file_stem()?.to_str()?.strip_prefix("model_")?;
            Some((stem.to_owned(), path.clone()))
        })
        .collect();
    models.sort();
    assert!(!models.is_empty(), "no model in {}", folder.display());
    models
}

pub(crate) fn group<const N: usize>(values: &[f64], index: usize) -> [f64; N] {
    let group = &values[N * index..N * (index + 1)];
    group.try_into().expect("a group of N values")
}

pub(crate) fn check_close(values: &[f64], expected: &[f64], tolerance: f64, case: &str) {
    assert_eq!(values.len(), expected.len(), "{case}");
    for (value, expected) in values.iter().zip(expected) {
        let difference = (value - expected).abs();
        assert!(difference <= tolerance, "{case}: {value} is not {expected}");
    }
}
