//! Lets this package's programs find libmujoco where they were linked with it.

fn main() {
    println!("cargo:rerun-if-env-changed=MUJOCO_DYNAMIC_LINK_DIR");
    let folder = std::env::var_os("MUJOCO_DYNAMIC_LINK_DIR").map(std::path::PathBuf::from);
    // The link's target is used, because the programs outlive this checkout.
    if let Some(folder) = folder.and_then(|folder| folder.canonicalize().ok()) {
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", folder.display());
    }
}
