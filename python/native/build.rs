//! Lets the extension find libmujoco beside it in the package.

fn main() {
    println!("cargo:rustc-link-arg=-Wl,-rpath,$ORIGIN");
}
