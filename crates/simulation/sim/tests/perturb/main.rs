//! The perturbations against values that NumPy, SciPy, Pillow and MuJoCo gave
//! for all thirty presets of every axis. Skipped, by name, where the reference
//! data is not at hand.

mod actuation;
mod reference;
mod robot;
mod scene;
mod sensor;
