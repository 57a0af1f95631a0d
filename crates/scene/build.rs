//! Embeds the built-in asset pack: writes a table of its files.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn main() -> std::io::Result<()> {
    let pack = Path::new(&std::env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets the variable"))
        .join("../../assets/primitives");
    println!("cargo:rerun-if-changed={}", pack.display());
    let mut files = Vec::new();
    let mut folders = vec![pack.clone()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "xml" || ending == "png") {
                files.push(path);
            }
        }
    }
    files.sort();
    let mut table = String::from("pub(super) const FILES: &[(&str, &[u8])] = &[\n");
    for path in &files {
        let inside = path
            .strip_prefix(&pack)
            .expect("the file was listed below the folder")
            .to_string_lossy();
        let _ = writeln!(table, "    ({inside:?}, include_bytes!({:?})),", path.display());
    }
    table.push_str("];\n");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").expect("set by cargo"));
    std::fs::write(out.join("primitives.rs"), table)
}
