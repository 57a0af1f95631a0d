//! Intentionally empty: this package exists for its dependencies. See its `Cargo.toml`.
