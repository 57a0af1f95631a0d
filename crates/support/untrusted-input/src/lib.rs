//! Checks of every file reader and every message handler against arbitrary
//! input: each must answer, and leave nothing broken. One function per reader or
//! service takes bytes and panics if that does not hold, and comes with seed
//! inputs. `fuzz/` drives the functions with a fuzzer, this package's tests with
//! seeded mutations. Not responsible for the meaning of an input; and no program
//! uses this package.

#![forbid(unsafe_code)]

mod call;
mod coordinator;
mod drawing;
mod files;
mod gateway;
mod scenes;
mod script;

/// A reader or a service under hostile input.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Name of the target: that of the fuzz target too.
    pub name: &'static str,
    /// Gives it an input; says whether nothing of it was refused.
    pub run: fn(&[u8]) -> bool,
    /// Inputs that mean something, to begin with.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All targets.
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

/// The target of this name.
///
/// # Panics
/// If there is none.
pub fn named(name: &str) -> Target {
    let found = TARGETS.into_iter().find(|target| target.name == name);
    found.unwrap_or_else(|| panic!("no target is called {name}"))
}

const fn target(name: &'static str, run: fn(&[u8]) -> bool, seeds: fn() -> Vec<Vec<u8>>) -> Target {
    Target { name, run, seeds }
}
