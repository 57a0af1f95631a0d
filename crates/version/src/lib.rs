//! Text of `--version`: the release and the commit that a program was built from.
//!
//! A proc macro rather than a build script, so that a commit recompiles only the crates that call
//! it. A build script would recompile every target of their packages, tests included.

#![forbid(unsafe_code)]

use std::path::{Path, PathBuf};
use std::process::Command;

use proc_macro::TokenStream;

/// Variables that would make git use another repository than the folder's, as inside a hook.
const UNSET: [&str; 3] = ["GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"];

/// Expands to text such as `"0.1.0 (807e12a, 2026-11-23)"`: the calling package's version, the
/// commit and its date; the version alone if git does not track the package. Uncommitted changes
/// are not mentioned.
#[proc_macro]
pub fn version(_: TokenStream) -> TokenStream {
    let cargo_variable = |name| std::env::var(name).expect("a variable that cargo sets");
    let version = cargo_variable("CARGO_PKG_VERSION");
    let code = match Commit::of_package(Path::new(&cargo_variable("CARGO_MANIFEST_DIR"))) {
        // Including the log makes the compiler notice a new commit.
        Some(Commit { name, log }) => {
            format!("{{ const _: &[u8] = include_bytes!({log:?}); \"{version} ({name})\" }}")
        }
        None => format!("{version:?}"),
    };
    code.parse().expect("Rust")
}

#[derive(Debug, PartialEq)]
struct Commit {
    /// Short hash and date, such as `807e12a, 2026-11-23`.
    name: String,
    /// A file of git that changes with every commit and checkout.
    log: PathBuf,
}

impl Commit {
    /// Returns the commit of the package in a folder; `None` if git does not track the package, for
    /// example because it was unpacked inside another repository.
    fn of_package(package: &Path) -> Option<Self> {
        let git = |words: &[&str]| {
            let mut git = Command::new("git");
            UNSET.iter().for_each(|name| _ = git.env_remove(name));
            let output = git.arg("-C").arg(package).args(words).output().ok()?;
            let text = String::from_utf8(output.stdout).ok()?;
            output.status.success().then(|| text.trim().to_owned())
        };
        git(&["ls-files", "--error-unmatch", "Cargo.toml"])?;
        let name = git(&["log", "-1", "--format=%h, %cs"])?;
        let log = ["logs/HEAD", "HEAD"].into_iter().find_map(|file| {
            let path = git(&["rev-parse", "--path-format=absolute", "--git-path", file])?;
            Some(PathBuf::from(path)).filter(|path| path.is_file())
        })?;
        Some(Self { name, log })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn git(folder: &Path, words: &str) -> String {
        let mut git = Command::new("git");
        UNSET.iter().for_each(|name| _ = git.env_remove(name));
        git.args(["-c", "user.name=A", "-c", "user.email=a@example.org"]);
        let output = git.arg("-C").arg(folder).args(words.split(' ')).output();
        let output = output.expect("git runs");
        assert!(output.status.success(), "git {words}: {output:?}");
        String::from_utf8(output.stdout).expect("UTF-8")
    }

    #[test]
    fn the_version_names_the_checked_out_commit() {
        let folder = tempfile::tempdir().expect("a folder");
        let package = folder.path().join("package");
        std::fs::create_dir(&package).expect("a package");
        std::fs::write(package.join("Cargo.toml"), "").expect("its manifest");
        assert_eq!(Commit::of_package(&package), None, "without git");

        git(folder.path(), "init --quiet");
        git(folder.path(), "commit --quiet --allow-empty -m somebody's");
        assert_eq!(Commit::of_package(&package), None, "inside another repository");

        git(folder.path(), "add .");
        git(folder.path(), "commit --quiet -m ours");
        let first = Commit::of_package(&package).expect("a commit");
        let hash = git(folder.path(), "rev-parse HEAD");
        let (short, day) = first.name.split_once(", ").expect("hash and day");
        assert!(hash.starts_with(short) && short.len() >= 7, "{first:?}");
        let digits = day.split('-').map(str::len);
        assert_eq!(digits.collect::<Vec<_>>(), [4, 2, 2], "{day}");

        let logged = std::fs::read(&first.log).expect("git's log");
        git(folder.path(), "commit --quiet --allow-empty -m next");
        let second = Commit::of_package(&package).expect("a commit");
        assert_ne!(first.name, second.name);
        assert_ne!(logged, std::fs::read(&second.log).expect("git's log"));
    }
}
