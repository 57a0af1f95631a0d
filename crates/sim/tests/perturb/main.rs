//! Compares the perturbations with values that NumPy, SciPy, Pillow and MuJoCo gave for presets of
//! every axis. Skipped, with a message, if the reference data is missing.

mod actuation;
mod reference;
mod robot;
mod scene;
mod sensor;
