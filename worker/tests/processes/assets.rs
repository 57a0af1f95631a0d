//! Asset packs from the command line.

use std::fs;
use std::process::Output;

use crate::worker_process::{ready, run};

fn said(output: Output) -> (Option<i32>, String) {
    let said = [output.stdout, output.stderr].concat();
    (output.status.code(), String::from_utf8(said).expect("text"))
}

#[test]
fn a_pack_without_a_manifest_is_verified_by_what_it_can_show() {
    if !ready("a_pack_without_a_manifest_is_verified_by_what_it_can_show") {
        return;
    }
    let (code, built_in) = said(run(&["assets", "verify"]));
    assert_eq!(code, Some(0), "{built_in}");
    assert!(built_in.contains("all files are as they should be"));

    // A copy, as a folder of LIBERO's own package is: nothing was recorded of it.
    let sources = scene::Sources::open(&scene::Sources::default_dir()).expect("ready");
    let primitives = scene::AssetPack::open("primitives", &sources).expect("built in");
    let folder = tempfile::tempdir().expect("a folder");
    let copy = folder.path().join("assets");
    let copied = std::process::Command::new("cp")
        .arg("-r")
        .args([primitives.dir(), &copy])
        .status();
    assert!(copied.expect("cp runs").success());
    let path = copy.to_str().expect("UTF-8");
    let (code, whole) = said(run(&["assets", "verify", path]));
    assert_eq!(code, Some(0), "{whole}");
    for words in [
        "40 of 40 compose",
        "were not compared",
        "--manifest files.txt",
    ] {
        assert!(whole.contains(words), "{whole}");
    }
    assert!(
        whole
            .lines()
            .all(|line| line.chars().count() <= 80 || line.contains(path))
    );

    fs::remove_file(copy.join("scenes/libero_floor_base_style.xml")).expect("was there");
    let (code, part) = said(run(&["assets", "verify", path]));
    assert_eq!(code, Some(1), "{part}");
    for words in [
        "cannot show all tasks",
        "libero_floor",
        "worker assets fetch",
    ] {
        assert!(part.contains(words), "{part}");
    }
}

#[test]
fn a_manifest_that_is_not_there_is_named() {
    let (code, said) = said(run(&[
        "assets",
        "verify",
        "/tmp",
        "--manifest",
        "/nowhere/files.txt",
    ]));
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("/nowhere/files.txt"), "{said}");
}
