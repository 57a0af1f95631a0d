//! Python wheels from which the simulator takes files. The wheels serve as archives only; they are
//! neither installed nor imported.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::dist::digest;
use crate::process::capture;

pub(crate) struct Wheel {
    /// Name and version in pip's syntax.
    pub(crate) requirement: &'static str,
    /// File name of the wheel for this machine.
    file: &'static str,
    sha256: &'static str,
    /// Folder in the cache that the wheel is unpacked into.
    into: &'static str,
    /// Folders and files in the wheel to extract, with their destinations.
    extracted: &'static [(&'static str, &'static str)],
}

/// Python version of the wheels with native code; fixed, so that every machine fetches the same
/// files.
const PYTHON_TAGS: [&str; 6] =
    ["--implementation", "cp", "--python-version", "3.11", "--abi", "cp311"];

#[cfg(target_arch = "x86_64")]
const MUJOCO: (&str, &str) = (
    "mujoco-3.3.7-cp311-cp311-manylinux_2_27_x86_64.manylinux_2_28_x86_64.whl",
    "9371506f0df2d82152685fc8d38465843abcea8d371745ea7c125001e8f3f2d8",
);
#[cfg(target_arch = "aarch64")]
const MUJOCO: (&str, &str) = (
    "mujoco-3.3.7-cp311-cp311-manylinux_2_27_aarch64.manylinux_2_28_aarch64.whl",
    "9381bf5364eb2da86f0b1388c98b57e706123c8370660f977004fb5f94ef900f",
);

/// All wheels, first the one that the linker needs, with the digests of their files on PyPI.
pub(crate) const WHEELS: [Wheel; 3] = [
    Wheel {
        requirement: "mujoco==3.3.7",
        file: MUJOCO.0,
        sha256: MUJOCO.1,
        into: "mujoco-3.3.7",
        extracted: &[
            ("mujoco/libmujoco.so.3.3.7", "libmujoco.so.3.3.7"),
            ("mujoco/include", "include"),
        ],
    },
    Wheel {
        requirement: "robosuite==1.4.0",
        file: "robosuite-1.4.0-py3-none-any.whl",
        sha256: "aba065e7b36745738cede259457b2cb349427f3608728d867ef3a2034cb62994",
        into: "sources/robosuite",
        extracted: &[
            ("robosuite/models/assets/base.xml", "base.xml"),
            ("robosuite/models/assets/robots/panda", "robots/panda"),
            ("robosuite/models/assets/grippers/panda_gripper.xml", "grippers/panda_gripper.xml"),
            (
                "robosuite/models/assets/grippers/meshes/panda_gripper",
                "grippers/meshes/panda_gripper",
            ),
            ("robosuite/models/assets/mounts/rethink_mount.xml", "mounts/rethink_mount.xml"),
            ("robosuite/models/assets/mounts/null_mount.xml", "mounts/null_mount.xml"),
            ("robosuite/models/assets/mounts/meshes/rethink_mount", "mounts/meshes/rethink_mount"),
        ],
    },
    Wheel {
        requirement: "hf-libero==0.1.4",
        file: "hf_libero-0.1.4-py3-none-any.whl",
        sha256: "207f76e2f28bff30f78132223d8592fe8f64b1f8fd90ce7024948ada0d7e2c27",
        into: "sources/libero",
        extracted: &[
            ("libero/libero/bddl_files", "bddl_files"),
            ("libero/libero/init_files", "init_files"),
        ],
    },
];

const LICENCES: &str = "\
import sys, zipfile
wheel = zipfile.ZipFile(sys.argv[1])
names = [n for n in wheel.namelist() if '.dist-info/' in n and 'LICENSE' in n]
print('\\n\\n'.join(wheel.read(n).decode().strip() for n in names))
";

/// File that marks a folder as completely unpacked; holds the wheel's digest.
const STAMP: &str = ".unpacked";

impl Wheel {
    /// Fetches, checks and unpacks the wheel into `cache` unless its files are there; returns a
    /// description of the work done.
    pub(crate) fn provide(&self, cache: &Path) -> Result<&'static str> {
        let target = cache.join(self.into);
        if std::fs::read_to_string(target.join(STAMP)).is_ok_and(|stamp| stamp == self.sha256) {
            return Ok("already there");
        }
        let wheel = cache.join("wheels").join(self.file);
        let fetched = !wheel.is_file();
        if fetched {
            self.fetch(&cache.join("wheels"))?;
        }
        self.check(&wheel)?;
        self.unpack(&wheel, &target)?;
        Ok(if fetched { "fetched, checked, unpacked" } else { "checked, unpacked" })
    }

    pub(crate) fn licences(&self, cache: &Path) -> Result<String> {
        let wheel = cache.join("wheels").join(self.file);
        if !wheel.is_file() {
            self.fetch(&cache.join("wheels"))?;
        }
        let texts = capture(Command::new("python3").args(["-c", LICENCES]).arg(&wheel))?;
        ensure!(!texts.is_empty(), "find the licence in {}", wheel.display());
        Ok(texts)
    }

    fn fetch(&self, wheels: &Path) -> Result<()> {
        let mut pip = Command::new("python3");
        pip.args(["-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"])
            .args(["--only-binary", ":all:"])
            .args(PYTHON_TAGS);
        for glibc in ["2_28", "2_27"] {
            pip.args(["--platform", &format!("manylinux_{glibc}_{}", std::env::consts::ARCH)]);
        }
        pip.arg("--dest").arg(wheels).arg(self.requirement);
        capture(&mut pip).with_context(|| {
            format!("download {} (is the package index reachable?)", self.requirement)
        })?;
        ensure!(
            wheels.join(self.file).is_file(),
            "download {}: pip downloaded a file other than {}",
            self.requirement,
            self.file
        );
        Ok(())
    }

    fn check(&self, wheel: &Path) -> Result<()> {
        let found = digest(wheel)?;
        ensure!(
            found == self.sha256,
            "check {}: its SHA-256 is {found}, expected {}; delete the file and run this command \
             again",
            wheel.display(),
            self.sha256
        );
        Ok(())
    }

    /// Unpacks into a temporary folder and renames it, so that an interrupted run leaves no folder
    /// that looks complete.
    fn unpack(&self, wheel: &Path, target: &Path) -> Result<()> {
        let partial = target.with_extension("unpacking");
        remove(&partial)?;
        let whole = partial.join("whole");
        std::fs::create_dir_all(&whole).with_context(|| format!("make {}", whole.display()))?;
        let mut unzip = Command::new("python3");
        capture(unzip.args(["-m", "zipfile", "--extract"]).arg(wheel).arg(&whole))?;
        for (from, to) in self.extracted {
            let to = partial.join(to);
            std::fs::create_dir_all(to.parent().expect("inside the target"))?;
            std::fs::rename(whole.join(from), &to)
                .with_context(|| format!("find {from} in {}", wheel.display()))?;
        }
        remove(&whole)?;
        std::fs::write(partial.join(STAMP), self.sha256)?;
        remove(target)?;
        std::fs::rename(&partial, target).with_context(|| format!("make {}", target.display()))
    }
}

fn remove(dir: &Path) -> Result<()> {
    match std::fs::remove_dir_all(dir) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("remove {}", dir.display()))
        }
        _ => Ok(()),
    }
}
