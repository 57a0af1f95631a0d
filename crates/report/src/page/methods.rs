//! Methods section: versions, digests, realisation modes and statistics, so that others
//! can reproduce the figures.

use std::collections::BTreeSet;

use benchmark::attempt::Provenance;
use benchmark::{Look, Realisation};
use paired::MIN_TASKS;

use crate::analysis::Analysis;
use crate::block::Block;
use crate::document::Document;
use crate::subject::{BeyondRange, Origin};

pub(super) fn methods(document: &Document) -> Vec<Block<'_>> {
    let mut words = "Protocol: LIBERO-CTRL (arXiv 2609.15940). ".to_owned();
    words += match document.analyses.iter().any(Analysis::is_paired) {
        true => {
            "Every configuration pairs one initial state with one preset of each axis; it is run \
             under each axis alone and under all of them simultaneously, so that outcomes are \
             compared configuration by configuration. Incomplete configurations are in no paired \
             figure. McNemar's exact test takes rollouts as independent; sign-flip tests take tasks \
             as independent. The findings rest on sign-flip tests of costs and of I, t tests of the \
             excess over the noise floor, and permutation tests of directions, at 1 % after Holm's \
             correction. Intervals for each target are jackknives over tasks, directions and \
             configurations with Student's t."
        }
        false => {
            "This campaign runs further rollouts of another campaign's configurations: the same \
             initial states, and perturbations drawn from the same seeds."
        }
    };
    if let Some(analysis) = document.analyses.first() {
        let bootstrap = analysis.report.bootstrap;
        words += &format!(
            " The paper's intervals, about new tasks under these directions, are 95 % percentile \
             intervals of {} bootstrap replicates that resample whole tasks (ChaCha12, seed {}). \
             Fewer than {MIN_TASKS} tasks get no interval (“too few tasks”), because it would be too \
             narrow, and neither does a measure that no resampling changes (“no spread”).",
            bootstrap.replicates, bootstrap.seed
        );
    }
    words += " Rollouts that infrastructure kept from finishing are never counted as failures. \
              Computed by rollout ";
    words += concat!(env!("CARGO_PKG_VERSION"), ".");
    let policies = document.analyses.iter();
    let policies = policies
        .flat_map(|of| [Block::Heading(of.label.clone()), Block::Terms(policy_methods(of))]);
    [Block::Paragraph(words)].into_iter().chain(policies).collect()
}

/// Returns what is known of the measurement of a policy, each with its name.
fn policy_methods(analysis: &Analysis) -> Vec<(String, String)> {
    let subject = &analysis.subject;
    let with_digest = |name: &str, digest: &str| match digest {
        "" => name.to_owned(),
        digest => format!("{name}, SHA-256 {digest}"),
    };
    let distinct = |name: &'static str, property: &dyn Fn(&Provenance) -> String| {
        let values: BTreeSet<String> = subject.provenances.iter().map(property).collect();
        let values: Vec<String> = values.into_iter().filter(|value| !value.is_empty()).collect();
        (name, values.join("; "))
    };
    let looks: Vec<&str> = subject.looks().into_iter().map(Look::name).collect();
    let origin = match &subject.origin {
        Origin::Campaign { name, endpoint, design } => [
            ("campaign", format!("{name}, design `{design}`")),
            ("policy", format!("{} at `{endpoint}`", subject.policy)),
        ],
        Origin::File { name, digest, source } => {
            [("results", with_digest(name, digest)), ("source", source.clone())]
        }
    };
    let unknown = match subject.provenances.is_empty() {
        true => "not known: result rows do not name it",
        false => "",
    };
    let beyond = subject.beyond.map(|range| beyond(range, subject.realisation));
    let measured = [
        ("realisation", subject.realisation.map_or("not known", |mode| mode.name()).to_owned()),
        ("look", looks.join("; ")),
        ("execution", subject.execution.to_string()),
        distinct("checkpoint", &|p| {
            let name = format!("{} {}", p.policy_name, p.policy_checkpoint);
            with_digest(name.trim(), &p.policy_checkpoint_digest)
        }),
        distinct("asset pack", &|p| with_digest(&p.pin.asset_pack, &p.pin.asset_pack_digest)),
        distinct("MuJoCo", &|p| p.pin.mujoco_version.clone()),
        distinct("renderer", &|p| p.pin.renderer.clone()),
        distinct("fingerprint", &|p| p.fingerprint.clone()),
        distinct("settings", &Provenance::policy_settings_in_words),
        ("beyond ±1", beyond.unwrap_or_default()),
        distinct("batch mode", &|p| p.batch_mode.clone()),
        distinct("worker", &|p| format!("rollout {}", p.program_version)),
        distinct("machines", &|p| p.host.clone()),
        ("simulator", unknown.to_owned()),
    ];
    let entries = origin.into_iter().chain(measured).filter(|(_, words)| !words.is_empty());
    entries.map(|(name, words)| (name.to_owned(), words)).collect()
}

/// Describes the number of clipped actions, which bounds the effect of clipping before or after
/// the actuation axis.
fn beyond(range: BeyondRange, realisation: Option<Realisation>) -> String {
    let BeyondRange { actions, of_actions, rollouts } = range;
    let when = match realisation {
        Some(Realisation::Reference) => "after",
        _ => "before",
    };
    format!("{actions} of {of_actions}, in {rollouts} rollouts; clipped {when} the actuation axis")
}
