//! Lets programs load libmujoco from the folder that they were linked against. All packages whose
//! programs link libmujoco share this build script.

fn main() {
    println!("cargo:rerun-if-env-changed=MUJOCO_DYNAMIC_LINK_DIR");
    let folder = std::env::var_os("MUJOCO_DYNAMIC_LINK_DIR").map(std::path::PathBuf::from);
    // Resolves symbolic links, since the programs may be used without this checkout.
    if let Some(folder) = folder.and_then(|folder| folder.canonicalize().ok()) {
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", folder.display());
    }
}
