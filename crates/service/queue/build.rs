//! A new migration must reach the program: `sqlx::migrate!` reads the folder
//! while compiling, which cargo does not see.

fn main() {
    println!("cargo:rerun-if-changed=../../../migrations");
}
