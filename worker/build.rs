//! Adds the folder of the libmujoco that the worker is linked with to its library search path.

fn main() {
    println!("cargo:rerun-if-env-changed=MUJOCO_DYNAMIC_LINK_DIR");
    let folder = std::env::var_os("MUJOCO_DYNAMIC_LINK_DIR").map(std::path::PathBuf::from);
    // Uses the folder's canonical path instead of the link in this checkout, because the program
    // may outlive the checkout.
    if let Some(folder) = folder.and_then(|folder| folder.canonicalize().ok()) {
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", folder.display());
    }
}
