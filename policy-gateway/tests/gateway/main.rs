//! Integration tests of the gateway over real sockets, with working and faulty policy servers.

mod access;
mod answers;
#[path = "../../../coordinator/tests/it/assertions.rs"]
mod assertions;
#[path = "../../../coordinator/tests/it/authority.rs"]
mod authority;
mod batches;
mod both_paths;
mod conformance;
mod crowd;
#[path = "../../../coordinator/tests/it/json_keys.rs"]
mod json_keys;
mod judgement;
mod outages;
#[path = "../doctor/planted.rs"]
#[allow(dead_code, reason = "only the doctor's tests use all of this file")]
mod planted;
mod program;
mod recordings;
mod replicas;
mod routing;
#[path = "../doctor/scripted.rs"]
#[allow(dead_code, reason = "only the doctor's tests use all of this file")]
mod scripted;
mod sessions;
mod support;
mod vla_eval;
mod wrong_servers;
