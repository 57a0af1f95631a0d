//! What a reader must know before a figure is believed, in words. Pure, and the
//! same for the same results: no instant, no count of attempts, no worker.

use std::collections::BTreeSet;

use paired::Outcome;

use super::{Facts, rollout_name};
use crate::store::results::Provenance;

/// The built-in pack, which is another benchmark than LIBERO.
const PRIMITIVES: &str = "primitives";
/// Rollouts named in one warning; more are counted.
const MAX_NAMED: usize = 5;

/// The warnings, worst first.
pub(super) fn warnings(facts: &Facts) -> Vec<String> {
    let mut warnings = Vec::new();
    warnings.extend(mixed(
        facts,
        "MuJoCo version",
        "never pooled: each is another simulator",
        |p| p.mujoco_version.clone(),
    ));
    warnings.extend(mixed(
        facts,
        "asset pack",
        "never pooled: each is another benchmark",
        |p| format!("{} ({})", p.asset_pack, short(&p.asset_pack_digest)),
    ));
    warnings.extend(mixed(
        facts,
        "policy checkpoint",
        "each is another policy",
        |p| {
            format!(
                "{} {} ({})",
                p.policy_name,
                p.policy_checkpoint,
                short(&p.policy_checkpoint_digest)
            )
        },
    ));
    warnings.extend(mixed(
        facts,
        "renderer",
        "pictures differ between them",
        |p| p.gl_renderer.clone(),
    ));
    warnings.extend(mixed(facts, "program version", "compare with care", |p| {
        p.program_version.clone()
    }));
    if facts.provenances.iter().any(|p| p.asset_pack == PRIMITIVES) {
        warnings.push(format!(
            "simulated with the built-in `{PRIMITIVES}` asset pack: boxes and cylinders, not \
             LIBERO's objects; these rates say nothing about LIBERO and compare with no \
             published figure"
        ));
    }
    if facts.provenances.iter().any(|p| p.policy_privileged) {
        warnings.push(format!(
            "policy `{}` is privileged: it was given the simulator's own state, which no real \
             policy sees; these rates are a check of the set-up, not a measurement of a policy",
            facts.policy
        ));
    }
    warnings.extend(divergent(facts));
    warnings.extend(incomplete(facts));
    warnings
}

fn mixed(
    facts: &Facts,
    what: &str,
    so: &str,
    of: impl Fn(&Provenance) -> String,
) -> Option<String> {
    let values: BTreeSet<String> = facts.provenances.iter().map(of).collect();
    (values.len() > 1).then(|| {
        let values: Vec<String> = values.into_iter().collect();
        format!(
            "results of more than one {what} are mixed ({so}): {}",
            values.join("; ")
        )
    })
}

fn divergent(facts: &Facts) -> Option<String> {
    let names = facts
        .divergent
        .iter()
        .map(|(id, replicate)| rollout_name(id, *replicate));
    (!facts.divergent.is_empty()).then(|| {
        format!(
            "{} rollouts ran twice and came out differently (the first outcome counts): {}",
            facts.divergent.len(),
            some_of(names)
        )
    })
}

fn incomplete(facts: &Facts) -> Option<String> {
    let open = facts.records.iter();
    let open = open
        .filter(|record| record.outcome == Outcome::Missing)
        .count();
    (open > 0).then(|| {
        format!(
            "{open} of {} rollouts have no result yet: figures are of what is complete",
            facts.records.len()
        )
    })
}

fn some_of(names: impl ExactSizeIterator<Item = String>) -> String {
    let left_out = names.len().saturating_sub(MAX_NAMED);
    let mut text = names.take(MAX_NAMED).collect::<Vec<_>>().join("; ");
    if left_out > 0 {
        text.push_str(&format!("; and {left_out} more"));
    }
    text
}

fn short(digest: &str) -> &str {
    match crate::ids::shortened(digest, 12) {
        "" => "no digest",
        digest => digest,
    }
}
