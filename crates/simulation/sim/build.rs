//! Lets programs that link libmujoco load it from the folder that they were linked against. The
//! build script of every package with such programs.

fn main() {
    println!("cargo:rerun-if-env-changed=MUJOCO_DYNAMIC_LINK_DIR");
    let folder = std::env::var_os("MUJOCO_DYNAMIC_LINK_DIR").map(std::path::PathBuf::from);
    // Resolves links, since the programs outlive this checkout.
    if let Some(folder) = folder.and_then(|folder| folder.canonicalize().ok()) {
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", folder.display());
    }
}
