//! Methods section: versions, digests, realisation modes and statistics, so that others
//! can reproduce the figures.

use std::collections::BTreeSet;

use benchmark::attempt::Provenance;
use benchmark::{Look, Realisation};
use maud::{Markup, html};
use paired::MIN_TASKS;

use crate::analysis::Analysis;
use crate::document::Document;
use crate::subject::{BeyondRange, Origin};

pub(super) fn methods(document: &Document) -> Markup {
    let bootstrap = document.analyses.first().map(|analysis| analysis.report.bootstrap);
    let is_paired = document.analyses.iter().any(Analysis::is_paired);
    html! {
        section {
            h2 { "Methods" }
            p {
                "Protocol: LIBERO-CTRL (arXiv 2609.15940). "
                @if is_paired {
                    "Every configuration pairs one initial state with one preset of each axis; it \
                    is run under each axis alone and under all of them simultaneously, so that \
                    outcomes are compared configuration by configuration. McNemar's exact test takes \
                    rollouts as independent; sign-flip tests take tasks as independent. The findings rest \
                    on sign-flip tests of costs and of I, t tests of the excess over the noise \
                    floor, and permutation tests of directions, at 1 % after Holm's correction. \
                    Intervals for each target are jackknives over tasks, directions and \
                    configurations with Student's t. "
                } @else {
                    "This campaign runs further rollouts of another campaign's configurations: the \
                    same initial states, and perturbations drawn from the same seeds. "
                }
                @if let Some(bootstrap) = bootstrap {
                    "The paper's intervals, about new tasks under these directions, are 95 % percentile intervals of " (bootstrap.replicates)
                    " bootstrap replicates that resample whole tasks (ChaCha12, seed "
                    (bootstrap.seed) "). Fewer than "
                    (MIN_TASKS) " tasks get no interval (“too few tasks”), because it would be too \
                    narrow: for normally distributed tasks, a nominal 95 % interval covers the \
                    truth in 50 % of cases for two tasks, 85 % for five, 90 % for ten and 94 % for \
                    forty (Hesterberg, The American Statistician 69, 2015; Cameron, Gelbach and \
                    Miller, Review of Economics and Statistics 90, 2008). A measure that no \
                    resampling changes gets no interval either (“no spread”): an interval without \
                    width would say nothing about the uncertainty of the measure."
                }
                @if is_paired { " Incomplete configurations are in no paired figure." }
                " Rollouts that infrastructure \
                kept from finishing are never counted as failures. Computed by rollout "
                (env!("CARGO_PKG_VERSION")) "."
            }
            @for analysis in &document.analyses { (policy_methods(analysis)) }
        }
    }
}

fn policy_methods(analysis: &Analysis) -> Markup {
    let subject = &analysis.subject;
    let distinct = |property: fn(&Provenance) -> String| -> Option<String> {
        let values: BTreeSet<String> = subject.provenances.iter().map(property).collect();
        let values: Vec<String> = values.into_iter().filter(|value| !value.is_empty()).collect();
        (!values.is_empty()).then(|| values.join("; "))
    };
    let with_digest = |name: &str, digest: &str| match digest {
        "" => name.to_owned(),
        digest => format!("{name}, SHA-256 {digest}"),
    };
    let entries = [
        ("MuJoCo", distinct(|p| p.pin.mujoco_version.clone())),
        ("renderer", distinct(|p| p.pin.renderer.clone())),
        ("fingerprint", distinct(|p| p.fingerprint.clone())),
        ("policy settings", distinct(Provenance::policy_settings_in_words)),
        ("actions beyond ±1", subject.beyond.map(|range| beyond(range, subject.realisation))),
        ("batch mode", distinct(|p| p.batch_mode.clone())),
        ("worker", distinct(|p| format!("rollout {}", p.program_version))),
        ("machines", distinct(|p| p.host.clone())),
    ];
    let packs: BTreeSet<String> = subject
        .provenances
        .iter()
        .map(|p| with_digest(&p.pin.asset_pack, &p.pin.asset_pack_digest))
        .collect();
    let checkpoints: BTreeSet<String> = subject
        .provenances
        .iter()
        .map(|p| {
            let name = format!("{} {}", p.policy_name, p.policy_checkpoint);
            with_digest(name.trim(), &p.policy_checkpoint_digest)
        })
        .collect();
    html! {
        h3 { (analysis.label) }
        dl.methods {
            @match &subject.origin {
                Origin::Campaign { name, endpoint, design } => {
                    dt { "campaign" } dd { (name) ", design " code { (design) } }
                    dt { "policy" } dd { (subject.policy) " at " code { (endpoint) } }
                }
                Origin::File { name, digest, source } => {
                    dt { "results" } dd { (name) ", SHA-256 " code { (digest) } }
                    @if !source.is_empty() { dt { "source" } dd { (source) } }
                }
            }
            dt { "realisation" }
            dd { (subject.realisation.map_or("not known", |realisation| realisation.name())) }
            @if !subject.looks().is_empty() {
                dt { "look" }
                dd { (subject.looks().into_iter().map(Look::name).collect::<Vec<_>>().join("; ")) }
            }
            dt { "execution model" } dd { (subject.execution) }
            @for checkpoint in &checkpoints { dt { "checkpoint" } dd { (checkpoint) } }
            @for pack in &packs { dt { "asset pack" } dd { (pack) } }
            @for (name, values) in entries {
                @if let Some(values) = values { dt { (name) } dd { (values) } }
            }
            @if subject.provenances.is_empty() {
                dt { "simulator" } dd { "not known: result rows do not name it" }
            }
        }
    }
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
