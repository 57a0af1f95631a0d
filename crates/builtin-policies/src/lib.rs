//! Policies that need no server: a script that reads the simulator's state, and a small network that
//! sees what every policy sees.

#![deny(unsafe_op_in_unsafe_fn)]

pub mod expert;
pub mod student;
