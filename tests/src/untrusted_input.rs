//! Checks of every file parser and message handler with arbitrary input: each must return a value
//! or an error, and leave a consistent state. A [`Target`] for each parser or service has a
//! function that takes bytes and panics if a check fails, and seed inputs. `fuzz/` drives these
//! functions with a fuzzer; this package's tests use seeded mutations. The checks do not cover
//! whether an input is interpreted correctly. No program depends on this package.

mod call;
mod coordinator;
mod drawing;
mod files;
mod gateway;
mod scenes;
mod script;

#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Name, which is also the name of its program in `fuzz`.
    pub name: &'static str,
    /// Runs one input; returns true if it was accepted, by at least one parser if it is given to
    /// several.
    pub run: fn(&[u8]) -> bool,
    pub seeds: fn() -> Vec<Vec<u8>>,
}

pub const TARGETS: [Target; 15] = [
    target("bddl", scenes::bddl, scenes::bddl_seeds),
    target("mjcf", scenes::mjcf, scenes::mjcf_seeds),
    target("pruned_init", scenes::pruned_init, scenes::pruned_init_seeds),
    target("manifest", files::manifest, files::manifest_seeds),
    target("campaign_spec", files::campaign_spec, files::campaign_spec_seeds),
    target("result_rows", files::result_rows, files::result_rows_seeds),
    target("about_file", files::about_file, files::about_file_seeds),
    target("recorded_actions", files::recorded_actions, files::recorded_actions_seeds),
    target("gateway_file", files::gateway_file, files::gateway_file_seeds),
    target("recording", files::recording, files::recording_seeds),
    target("token_file", files::token_file, files::token_file_seeds),
    target("rpc", coordinator::check_calls, coordinator::seeds),
    target("rpc_policy", gateway::check_calls, gateway::seeds),
    target("policy_answer", gateway::check_answers, gateway::answer_seeds),
    target("drawing", drawing::draw, drawing::seeds),
];

/// Returns the target with this name.
pub fn named(name: &str) -> Target {
    let found = TARGETS.into_iter().find(|target| target.name == name);
    found.unwrap_or_else(|| panic!("there is no target {name}"))
}

const fn target(name: &'static str, run: fn(&[u8]) -> bool, seeds: fn() -> Vec<Vec<u8>>) -> Target {
    Target { name, run, seeds }
}
