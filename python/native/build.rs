//! Lets the extension find the libmujoco that lies beside it in the package.

fn main() {
    println!("cargo:rustc-link-arg=-Wl,-rpath,$ORIGIN");
}
