//! Makes the extension load libmujoco from its own folder in the package.

fn main() {
    println!("cargo:rustc-link-arg=-Wl,-rpath,$ORIGIN");
}
