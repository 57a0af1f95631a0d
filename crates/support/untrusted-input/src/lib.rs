//! Checks of every file parser and message handler with arbitrary input: each must answer and leave
//! a consistent state. One function per parser or service takes bytes and panics if a check fails,
//! and has seed inputs. `fuzz/` drives these functions with a fuzzer; this package's tests use
//! seeded mutations. The checks do not cover whether an input is interpreted correctly. No program
//! depends on this package.

#![forbid(unsafe_code)]
#![allow(missing_docs, reason = "names and messages are self-explanatory")]

mod call;
mod coordinator;
mod drawing;
mod files;
mod gateway;
mod scenes;
mod script;

/// A parser or service under test.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Name of the target, shared with the fuzz target.
    pub name: &'static str,
    /// Runs one input; returns true if no part of it was refused.
    pub run: fn(&[u8]) -> bool,
    /// Valid inputs to start from.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

pub const TARGETS: [Target; 15] = [
    target("bddl", scenes::bddl, scenes::bddl_seeds),
    target("mjcf", scenes::mjcf, scenes::mjcf_seeds),
    target(
        "pruned_init",
        scenes::pruned_init,
        scenes::pruned_init_seeds,
    ),
    target("manifest", files::manifest, files::manifest_seeds),
    target(
        "campaign_spec",
        files::campaign_spec,
        files::campaign_spec_seeds,
    ),
    target("result_rows", files::result_rows, files::result_rows_seeds),
    target("about_file", files::about_file, files::about_file_seeds),
    target(
        "recorded_actions",
        files::recorded_actions,
        files::recorded_actions_seeds,
    ),
    target(
        "gateway_file",
        files::gateway_file,
        files::gateway_file_seeds,
    ),
    target("recording", files::recording, files::recording_seeds),
    target("token_file", files::token_file, files::token_file_seeds),
    target("rpc", coordinator::messages, coordinator::seeds),
    target("rpc_policy", gateway::messages, gateway::seeds),
    target("policy_answer", gateway::answers, gateway::answer_seeds),
    target("drawing", drawing::draw, drawing::seeds),
];

/// Returns the target with this name.
///
/// # Panics
/// If there is no such target.
pub fn named(name: &str) -> Target {
    let found = TARGETS.into_iter().find(|target| target.name == name);
    found.unwrap_or_else(|| panic!("there is no target {name}"))
}

const fn target(name: &'static str, run: fn(&[u8]) -> bool, seeds: fn() -> Vec<Vec<u8>>) -> Target {
    Target { name, run, seeds }
}
