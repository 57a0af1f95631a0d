//! Container image: the archive in a root with glibc and nothing else.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::process::capture;
use crate::step::step;

use super::archive::Archive;
use super::bare_root::{BareRoot, PREFIX, USER};
use super::release::{VERSION, commit_time};
use super::{bill, components, stage};

/// Largest allowed size of the compressed image, bytes.
const MAX_IMAGE_BYTES: u64 = 80_000_000;

/// Checks that `buildah` is installed.
pub(super) fn require_buildah() -> Result<()> {
    capture(Command::new("buildah").arg("--version"))
        .map(drop)
        .context("find buildah (Debian: `apt-get install buildah`)")
}

/// Makes the image beside the archive, as a file that container engines load.
pub(super) fn make(root: &Path, archive: &Archive) -> Result<PathBuf> {
    require_buildah()?;
    println!("Building the container image");
    let folder = tempfile::tempdir().context("make a folder")?;
    let context = folder.path().join("context");
    std::fs::create_dir_all(context.join("data"))?;
    let bare = BareRoot::make(&context.join("root"), archive)?;
    step("bill of materials, with glibc", || add_glibc(&bare))?;
    let tag = format!("localhost/rollout:{VERSION}");
    let file = archive.file.with_file_name(format!("{}.oci.tar", archive.name));
    let buildah = |arguments: &[&str]| {
        let mut buildah = Command::new("buildah");
        // Storage in the temporary folder leaves nothing on the machine.
        buildah.args(["--storage-driver", "vfs", "--root"]).arg(folder.path().join("images"));
        buildah.arg("--runroot").arg(folder.path().join("run")).args(arguments);
        buildah
    };
    step("image", || {
        let time = commit_time(root);
        #[rustfmt::skip]
        let mut build = buildah(&[
            "build", "--quiet", "--isolation", "chroot", "--format", "oci", "--timestamp", &time,
            "--label", &format!("org.opencontainers.image.version={VERSION}"), "--tag", &tag,
            "--file",
        ]);
        capture(build.arg(root.join("deploy/container/Containerfile")).arg(&context))?;
        let _ = std::fs::remove_file(&file);
        let to = format!("oci-archive:{}:rollout:{VERSION}", file.display());
        capture(&mut buildah(&["push", "--quiet", &tag, &to]))?;
        let size = file.metadata()?.len();
        ensure!(
            size <= MAX_IMAGE_BYTES,
            "build an image of {MAX_IMAGE_BYTES} bytes at most: it has {size} bytes"
        );
        Ok(format!("{:.1} MB compressed", size as f64 / 1e6))
    })?;
    step("settings of the image", || check_user(&buildah, &tag))?;
    step("start of the image", || start_program(&buildah, &tag))?;
    Ok(file)
}

/// Adds the C library to the image's bill of materials.
fn add_glibc(bare: &BareRoot) -> Result<&'static str> {
    let documents = bare.dir().join(PREFIX.trim_start_matches('/')).join(stage::DOCUMENTS);
    let path = documents.join(stage::BILL);
    let mut listed = serde_json::from_str(&std::fs::read_to_string(&path)?)?;
    let glibc = components::glibc()?;
    bill::add(&mut listed, &glibc);
    std::fs::write(&path, serde_json::to_string_pretty(&listed)? + "\n")?;
    let text =
        format!("glibc {}: {}\n\n{}\n", glibc.version, glibc.licence, glibc.texts.join("\n"));
    std::fs::write(documents.join("GLIBC-LICENSE.txt"), text)?;
    Ok("written")
}

/// Checks that the image's programs run as an unprivileged user.
fn check_user(buildah: &dyn Fn(&[&str]) -> Command, tag: &str) -> Result<String> {
    let mut inspect = buildah(&["inspect", "--type", "image", tag]);
    let inspected: serde_json::Value = serde_json::from_str(&capture(&mut inspect)?)?;
    let config = &inspected["OCIv1"]["config"];
    let user = config["User"].as_str().unwrap_or_default();
    ensure!(
        user == format!("{USER}:{USER}"),
        "run the image as an unprivileged user: its user is {user:?}"
    );
    Ok(format!("user {user}"))
}

/// Starts a program in a container of the image, without a container engine.
fn start_program(buildah: &dyn Fn(&[&str]) -> Command, tag: &str) -> Result<String> {
    let container = capture(&mut buildah(&["from", tag]))?;
    let started = capture(&mut buildah(&[
        "run",
        "--isolation",
        "chroot",
        &container,
        "--",
        "worker",
        "assets",
        "list",
        "primitives",
    ]))?;
    ensure!(started.contains("40"), "list the tasks of the built-in pack:\n{started}");
    let first = started.lines().next().unwrap_or_default();
    Ok(first.chars().take(60).collect())
}
