//! Sets the run path of this package's programs to the folder of libmujoco at link time.

fn main() {
    println!("cargo:rerun-if-env-changed=MUJOCO_DYNAMIC_LINK_DIR");
    let folder = std::env::var_os("MUJOCO_DYNAMIC_LINK_DIR").map(std::path::PathBuf::from);
    // Symbolic links are resolved, since the programs outlive this checkout.
    if let Some(folder) = folder.and_then(|folder| folder.canonicalize().ok()) {
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", folder.display());
    }
}
