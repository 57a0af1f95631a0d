//! Sandbox for the commands of a page: a copy of the checkout that protects the
//! original, with a separate network.

use std::fs::{self, File};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use tempfile::TempDir;

use crate::programs::program;

/// Folders of the checkout that are copied because commands write to them. All other entries are
/// symbolic links, except `.git`, `target` and `demo-data`, which the sandbox lacks.
const COPIED: [&str; 2] = ["assets", "policies"];

/// Environment variables that are removed, since a new reader has not set them.
const UNSET: [&str; 6] = [
    "COORDINATOR_URL",
    "ROLLOUT_TOKENS",
    "ROLLOUT_TOKEN_FILE",
    "ROLLOUT_CA",
    "RUST_LOG",
    "VIRTUAL_ENV",
];

/// A requirement that only some machines meet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Requirement {
    /// `reference data`: the folder `shared` beside the checkout.
    ReferenceData,
    /// `Python packages`: the downloads of the pages' `pip install`.
    PythonPackages,
    /// `TypeScript build`: npm's build of `policies/typescript`.
    TypeScriptBuild,
}

impl Requirement {
    pub fn parse(word: &str) -> Option<Self> {
        match word {
            "reference data" => Some(Self::ReferenceData),
            "Python packages" => Some(Self::PythonPackages),
            "TypeScript build" => Some(Self::TypeScriptBuild),
            _ => None,
        }
    }

    /// Returns the reason why the requirement is not met; `None` if it is met.
    pub fn unmet_reason(self) -> Option<String> {
        match self {
            Self::ReferenceData => {
                let dir = checkout().join("../shared");
                (!dir.is_dir()).then(|| format!("no reference data at {}", dir.display()))
            }
            Self::PythonPackages => python_packages().is_none().then(|| {
                "ROLLOUT_PYTHON_PACKAGES is not set: `cargo xtask test` downloads the packages and \
                 sets it"
                    .to_owned()
            }),
            Self::TypeScriptBuild => (!checkout().join(BUILT).is_file()).then(|| {
                "no TypeScript build; `cargo xtask test` makes one if npm is installed".to_owned()
            }),
        }
    }
}

/// A file that the TypeScript build produces.
const BUILT: &str = "policies/typescript/dist/src/main.js";

/// Returns the folder of wheels for the pages' `pip install`; tests never download them.
fn python_packages() -> Option<PathBuf> {
    std::env::var_os("ROLLOUT_PYTHON_PACKAGES").map(PathBuf::from)
}

/// Network isolation of pages, which use the same ports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Network {
    /// A network namespace created by root.
    OfRoot,
    /// A network namespace in a user namespace, created by an unprivileged user.
    OfUser,
    /// The machine's own network, used by one page at a time.
    Machine,
}

/// Shell command that brings the loopback device up and executes the following program.
const UP: &str = "ip link set lo up && exec \"$@\"";

impl Network {
    /// Returns the best isolation that this machine supports.
    pub fn of_this_machine() -> Self {
        let works = |network: &Self| {
            let mut words = network.wrapper().iter();
            let Some(first) = words.next() else {
                return true;
            };
            let mut probe = Command::new(first);
            probe.args(words).arg("true");
            probe.stdout(Stdio::null()).stderr(Stdio::null());
            probe.status().is_ok_and(|status| status.success())
        };
        let best = [Self::OfRoot, Self::OfUser].into_iter().find(works);
        best.unwrap_or(Self::Machine)
    }

    pub fn wrapper(self) -> &'static [&'static str] {
        match self {
            Self::OfRoot => &["unshare", "--net", "sh", "-c", UP, "sh"],
            Self::OfUser => {
                &["unshare", "--user", "--map-root-user", "--net", "sh", "-c", UP, "sh"]
            }
            Self::Machine => &[],
        }
    }
}

/// The folder of one page's session.
pub struct Folder {
    root: TempDir,
    network: Network,
    /// Lock held while the machine's own network is used.
    _lock: Option<File>,
}

impl Folder {
    /// Creates the folder.
    pub fn make() -> Self {
        let network = Network::of_this_machine();
        let lock = (network == Network::Machine).then(|| {
            let path = std::env::temp_dir().join("rollout-documents.lock");
            let file = File::create(path).expect("a lock file");
            file.lock().expect("the lock");
            file
        });
        let root = tempfile::tempdir().expect("a folder");
        let folder = Self { root, network, _lock: lock };
        folder.fill().expect("a folder like the checkout");
        folder
    }

    fn fill(&self) -> std::io::Result<()> {
        let target = self.checkout();
        fs::create_dir_all(&target)?;
        fs::create_dir(self.outputs())?;
        for entry in fs::read_dir(checkout())? {
            let (name, path) = entry.map(|entry| (entry.file_name(), entry.path()))?;
            match name.to_str() {
                Some(".git" | "target" | "demo-data") => {}
                Some(copied) if COPIED.contains(&copied) => copy(&path, &target.join(name))?,
                _ => symlink(path, target.join(name))?,
            }
        }
        let shared = checkout().join("../shared");
        if let Ok(shared) = shared.canonicalize() {
            symlink(shared, self.root.path().join("shared"))?;
        }
        Ok(())
    }

    /// Returns the folder that takes the place of the checkout.
    pub fn checkout(&self) -> PathBuf {
        self.root.path().join("rollout")
    }

    pub fn outputs(&self) -> PathBuf {
        self.root.path().join("outputs")
    }

    pub fn network(&self) -> Network {
        self.network
    }

    /// Sets a shell's working folder and the environment of a new reader.
    pub fn prepare_shell(&self, shell: &mut Command) {
        shell.current_dir(self.checkout());
        for name in UNSET {
            shell.env_remove(name);
        }
        let path = std::env::var("PATH").unwrap_or_default();
        shell.env("PATH", format!("{}:{path}", programs().display()));
        if let Some(packages) = python_packages() {
            shell.env("PIP_NO_INDEX", "1").env("PIP_FIND_LINKS", packages);
        }
        shell.env("PIP_DISABLE_PIP_VERSION_CHECK", "1");
    }
}

/// Returns the checkout that the test was built from.
pub fn checkout() -> PathBuf {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).parent();
    dir.expect("the package is in the workspace").to_owned()
}

fn programs() -> PathBuf {
    let coordinator = program("coordinator");
    let dir = coordinator.parent().expect("programs are in a folder");
    dir.canonicalize().expect("the folder of the programs")
}

/// Copies a folder; installed packages and build output become symbolic links.
fn copy(from: &Path, to: &Path) -> std::io::Result<()> {
    fs::create_dir(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        let is_installed = matches!(entry.file_name().to_str(), Some("node_modules" | "dist"));
        match entry.file_type()? {
            _ if is_installed => symlink(path, target)?,
            kind if kind.is_dir() => copy(&path, &target)?,
            _ => drop(fs::copy(path, target)?),
        }
    }
    Ok(())
}
