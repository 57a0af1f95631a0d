//! The gateway on real sockets keeps its promises to workers, even if a policy server misbehaves.

mod access;
mod answers;
mod batches;
mod both_paths;
mod compare;
mod conformance;
mod crowd;
mod doctor;
mod judgement;
mod outages;
mod planted;
mod program;
mod recordings;
mod replicas;
mod routing;
mod sessions;
mod support;
mod vla_eval;
mod wrong_servers;
