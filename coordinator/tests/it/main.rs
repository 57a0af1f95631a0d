//! The coordinator as its users meet it: real sockets, real SQLite files, and
//! where a process has to die, real processes. Only the clock is moved by hand.

mod access;
mod altering;
mod artifacts;
mod blame;
mod campaigns;
mod claims;
mod compare;
mod disk;
mod explain;
mod explained;
mod failpoints;
mod faults;
mod films;
mod fingerprints;
mod harness;
mod invariants;
mod json;
mod manifests;
mod operating;
mod outages;
mod page;
mod pairing;
mod panics;
mod pins;
mod process;
mod random;
mod reports;
mod schema;
mod seeds;
mod standing;
mod subsets;
mod together;
mod upgrade;
