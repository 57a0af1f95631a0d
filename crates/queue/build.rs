//! Rebuilds the crate when a migration is added or changed: `sqlx::migrate!` reads the folder
//! during compilation, which cargo does not notice.

fn main() {
    println!("cargo:rerun-if-changed=../../migrations");
}
