//! Third-party components of the archive and of the container image, other than crates.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};

use crate::packages::WHEELS;
use crate::process::capture;

/// Third-party component that the archive or the image contains.
pub(super) struct Component {
    pub(super) name: String,
    pub(super) version: String,
    /// SPDX expression.
    pub(super) licence: &'static str,
    /// Licence texts and notices that must be distributed with the component.
    pub(super) texts: Vec<String>,
}

/// Licences of [`WHEELS`], in their order, as named in the packages.
const WHEEL_LICENCES: [&str; 3] = ["Apache-2.0", "MIT", "MIT"];

/// Describes MuJoCo, the robot's models and LIBERO's task files, from PyPI.
pub(super) fn from_wheels(cache: &Path) -> Result<Vec<Component>> {
    let described = WHEELS.iter().zip(WHEEL_LICENCES);
    let described = described.map(|(wheel, licence)| {
        let (name, version) = wheel.requirement.split_once("==").context("read a version")?;
        Ok(Component {
            name: name.to_owned(),
            version: version.to_owned(),
            licence,
            texts: wheel.licences(cache)?,
        })
    });
    described.collect()
}

/// Describes the compiler's runtime libraries.
pub(super) fn from_compiler(libraries: &[&str]) -> Result<Vec<Component>> {
    if libraries.is_empty() {
        return Ok(Vec::new());
    }
    let version = capture(Command::new("cc").arg("-dumpfullversion"))?;
    let found = libraries.iter().map(|library| Component {
        name: (*library).to_owned(),
        version: version.clone(),
        licence: "GPL-3.0-or-later WITH GCC-exception-3.1",
        texts: vec![
            "Part of GCC, by the Free Software Foundation, copied unaltered from the system on \
             which this archive was built. The \
             GCC Runtime Library Exception 3.1 lets programs of any licence be distributed with \
             it. The texts: https://www.gnu.org/licenses/gpl-3.0.txt and \
             https://www.gnu.org/licenses/gcc-exception-3.1.txt. The source: \
             https://gcc.gnu.org."
                .to_owned(),
        ],
    });
    Ok(found.collect())
}

/// Describes the C library, which the container image contains and the archive does not.
pub(super) fn glibc() -> Result<Component> {
    let ldd_version = capture(Command::new("ldd").arg("--version"))?;
    let first = ldd_version.lines().next().unwrap_or_default();
    let version = first.split_whitespace().last().unwrap_or_default();
    Ok(Component {
        name: "glibc".to_owned(),
        version: version.to_owned(),
        licence: "LGPL-2.1-or-later",
        texts: vec![format!(
            "{first}, unaltered. Text: https://www.gnu.org/licenses/lgpl-2.1.txt. Source: \
             https://sourceware.org/glibc, or the source package of the system on which this \
             image was built."
        )],
    })
}
