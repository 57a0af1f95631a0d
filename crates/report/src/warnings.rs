//! Warnings of a report, to be read before its figures. They depend on the results alone, not
//! on times, numbers of attempts or workers.

use std::collections::BTreeSet;

use paired::Outcome;

use benchmark::attempt::{CONNECTED_SINCE, Fingerprints, Provenance, first_names};
use benchmark::{Condition, Look, execution_at};

use crate::simulated::paired_by_seed_only;
use crate::subject::{Subject, pluralise};

/// The built-in asset pack, which is a different benchmark from LIBERO.
pub(crate) const PRIMITIVES: &str = "primitives";
/// End of the batch mode of a server that takes no seed.
const UNSEEDED: &str = ", unseeded";
/// Number of hexadecimal digits shown of a digest.
const DIGEST_DIGITS: usize = 12;

/// Returns the warnings about one subject, most severe first.
pub(crate) fn subject_warnings(subject: &Subject) -> Vec<String> {
    let provenances = &subject.provenances;
    let mut warnings = Vec::new();
    warnings.extend(left_out(subject));
    warnings.extend(paired_by_seed_only(subject));
    for (name, consequence, property) in MIXTURES {
        warnings.extend(mixed(property(subject), name, consequence));
    }
    warnings.extend(mixed(
        executions(subject).collect(),
        "execution model",
        "never pooled: the robot moves differently under each",
    ));
    warnings.extend(subject.fingerprints.as_ref().map(Fingerprints::to_string));
    if let Some(look) = subject.looks().into_iter().find(|look| *look != Look::default()) {
        warnings.push(format!(
            "drawn with the look `{look}`: LIBERO's demonstrations have `{}`, and a policy that \
             was trained on one look can fail in the other (docs/LOOKS.md)",
            Look::default()
        ));
    }
    if provenances.iter().any(|p| p.pin.asset_pack == PRIMITIVES && p.simulator.is_empty()) {
        warnings.push(format!(
            "simulated with the built-in `{PRIMITIVES}` asset pack: boxes and cylinders, not \
             LIBERO's objects; these rates say nothing about LIBERO and compare with no \
             published figure"
        ));
    }
    if provenances.iter().any(|p| p.policy_privileged) {
        warnings.push(format!(
            "policy `{}` is privileged: it was given the simulator's own state, which no real \
             policy sees; these rates are a check of the set-up, not a measurement of a policy",
            subject.policy
        ));
    }
    if provenances.iter().any(|p| p.policy_canonical_only) {
        warnings.push(format!(
            "policy `{}` always gets the canonical instruction: its language axis is an \
             identity, and its rates there say nothing about language",
            subject.policy
        ));
    }
    warnings.extend(unidentified(subject));
    warnings.extend(other_training_pack(subject));
    warnings.extend(other_training_look(subject));
    warnings.extend(no_nominal_success(subject));
    warnings.extend(divergent(subject));
    warnings.extend(incomplete(subject));
    warnings
}

/// Returns the warnings about comparing subjects with each other, most severe first.
pub(crate) fn comparison_warnings(subjects: &[Subject]) -> Vec<String> {
    let mut warnings = Vec::new();
    if subjects.len() < 2 {
        return warnings;
    }
    let realisations: BTreeSet<&str> =
        subjects.iter().filter_map(|subject| Some(subject.realisation?.name())).collect();
    if realisations.len() > 1 {
        warnings.push(format!(
            "the policies were perturbed in different realisation modes ({}): the magnitudes \
             agree, the random elements do not; compare them with care",
            realisations.into_iter().collect::<Vec<_>>().join(", ")
        ));
    }
    let comparable = [
        ("MuJoCo version", "each simulates differently", mujoco as Property),
        ("asset pack", "each is a benchmark of its own", pack),
        ("renderer", "each draws different pictures", renderer),
        ("look", "each shows other colours", look),
    ];
    for (name, consequence, property) in comparable {
        let values = subjects.iter().flat_map(property);
        warnings.extend(more_than_one(name, consequence, values.collect()));
    }
    let executions = subjects.iter().map(|subject| subject.execution.to_string());
    warnings.extend(more_than_one(
        "execution model",
        "the robot moves differently under each",
        executions.collect(),
    ));
    warnings
}

fn more_than_one(name: &str, consequence: &str, values: BTreeSet<String>) -> Option<String> {
    (values.len() > 1).then(|| {
        let values: Vec<String> = values.into_iter().collect();
        format!(
            "the policies were measured with more than one {name} ({consequence}): {}",
            values.join("; ")
        )
    })
}

/// Returns the known values of a property of the measurement.
pub(crate) type Property = fn(&Subject) -> BTreeSet<String>;

/// Properties that all results of a campaign should share, and the consequence if they
/// differ.
const MIXTURES: [(&str, &str, Property); 7] = [
    ("MuJoCo version", "never pooled: each simulates differently", mujoco),
    ("asset pack", "never pooled: each is a benchmark of its own", pack),
    ("policy checkpoint", "each is a policy of its own", |s| recorded(s, checkpoint)),
    ("batch mode", "batched queries can change a policy's answers", |s| {
        recorded(s, |p| p.batch_mode.clone())
    }),
    ("renderer", "never pooled: each draws different pictures", renderer),
    ("look", "never pooled: each shows other colours", look),
    ("program version", "compare with care", |s| recorded(s, |p| p.program_version.clone())),
];

/// Returns the values of a property that results record.
fn recorded(subject: &Subject, property: fn(&Provenance) -> String) -> BTreeSet<String> {
    let values = subject.provenances.iter().map(property);
    values.filter(|value| !value.is_empty()).collect()
}

pub(crate) fn mujoco(subject: &Subject) -> BTreeSet<String> {
    recorded(subject, |p| p.pin.mujoco_version.clone())
}

pub(crate) fn pack(subject: &Subject) -> BTreeSet<String> {
    recorded(subject, |p| {
        format!("{} ({})", p.pin.asset_pack, abbreviated_digest(&p.pin.asset_pack_digest))
    })
}

pub(crate) fn renderer(subject: &Subject) -> BTreeSet<String> {
    recorded(subject, |p| p.pin.renderer.clone())
}

pub(crate) fn look(subject: &Subject) -> BTreeSet<String> {
    subject.looks().iter().map(Look::to_string).collect()
}

/// Returns the execution models of the results, without those that an axis sets.
fn executions(subject: &Subject) -> impl Iterator<Item = String> {
    let ids = subject.records.iter().map(|record| record.id);
    let ids = ids.filter(|id| id.condition().sets_execution());
    let of_axes: BTreeSet<String> =
        ids.filter_map(|id| Some(execution_at(id.level())?.to_string())).collect();
    let models = subject.provenances.iter().map(|provenance| provenance.execution().to_owned());
    models.filter(move |model| !of_axes.contains(model))
}

fn checkpoint(p: &Provenance) -> String {
    let digest = abbreviated_digest(&p.policy_checkpoint_digest);
    format!("{} {} ({digest})", p.policy_name, p.policy_checkpoint)
}

fn mixed(values: BTreeSet<String>, name: &str, consequence: &str) -> Option<String> {
    (values.len() > 1).then(|| {
        let values: Vec<String> = values.into_iter().collect();
        format!("results of more than one {name} are mixed ({consequence}): {}", values.join("; "))
    })
}

fn left_out(subject: &Subject) -> Option<String> {
    let mode = subject.realisation?;
    (subject.left_out > 0).then(|| {
        format!(
            "realisation modes are mixed: {} results are of another mode than `{mode}`, which \
             perturbs differently; they are in no figure and count as missing",
            subject.left_out
        )
    })
}

/// Warns of a policy whose server names no weights, and of several connections to such a server,
/// which may have been replaced in between.
fn unidentified(subject: &Subject) -> Vec<String> {
    let (policy, provenances) = (&subject.policy, &subject.provenances);
    let mut warnings = Vec::new();
    if let Some(origin) = provenances.iter().find(|origin| origin.is_unidentified()) {
        let seeds = match origin.batch_mode.ends_with(UNSEEDED) {
            true => " and takes no seed",
            false => "",
        };
        warnings.push(format!(
            "policy `{policy}` names no checkpoint{seeds}: which weights these rates are of is not \
             recorded; add `?checkpoint=NAME` to the address of an openpi server, or have the \
             server report a digest"
        ));
    }
    let connections =
        provenances.iter().filter(|origin| origin.policy_checkpoint_digest.is_empty());
    let connections: BTreeSet<&String> =
        connections.filter_map(|origin| origin.policy_settings.get(CONNECTED_SINCE)).collect();
    if connections.len() > 1 {
        let connections: Vec<String> = connections.iter().map(ToString::to_string).collect();
        warnings.push(format!(
            "results of policy `{policy}` are of {} connections, and whether the same weights \
             answered on all of them is not known, because the server reports none: {}",
            connections.len(),
            first_names(&connections)
        ));
    }
    warnings
}

/// Warns of a policy that was measured on a different asset pack than it was trained on.
fn other_training_pack(subject: &Subject) -> Option<String> {
    let mut provenances = subject.provenances.iter();
    provenances.find_map(|provenance| {
        let taught_on = provenance.other_training_pack()?;
        Some(format!(
            "policy `{}` was taught on asset pack `{taught_on}` and measured on `{}`: objects of \
             the two packs look different, so that these rates say little about the policy",
            subject.policy, provenance.pin.asset_pack
        ))
    })
}

/// Warns of a policy that was measured on a different look than it was trained on.
fn other_training_look(subject: &Subject) -> Option<String> {
    let mut provenances = subject.provenances.iter();
    provenances.find_map(|provenance| {
        let taught_on = provenance.other_training_look()?;
        Some(format!(
            "policy `{}` was taught on the look `{taught_on}` and measured on `{}`, which shows \
             other colours: start workers with `--look {taught_on}`",
            subject.policy, provenance.pin.look
        ))
    })
}

/// Warns of a policy that solves no nominal rollout.
fn no_nominal_success(subject: &Subject) -> Option<String> {
    let nominal = subject.records.iter();
    let nominal = nominal.filter(|record| record.id.condition() == Condition::Nominal);
    let outcomes = nominal.map(|record| record.outcome);
    let (mut successes, mut failures) = (0_u64, 0_u64);
    for outcome in outcomes {
        match outcome {
            Outcome::Success => successes += 1,
            Outcome::Failure => failures += 1,
            Outcome::Missing | Outcome::Quarantined => {}
        }
    }
    (successes == 0 && failures > 0).then(|| {
        format!(
            "policy `{}` solved none of {failures} nominal rollouts, so that nothing is known of \
             its robustness; `policy-gateway check` looks for the usual mistakes of a policy \
             server that scores 0 %",
            subject.policy
        )
    })
}

fn divergent(subject: &Subject) -> Option<String> {
    let divergent = &subject.divergent;
    (!divergent.is_empty()).then(|| {
        format!(
            "{} ran twice with different outcomes (the first outcome counts): {}",
            pluralise(divergent.len() as u64, "rollout"),
            first_names(divergent)
        )
    })
}

fn incomplete(subject: &Subject) -> Option<String> {
    if subject.has_stopped() {
        return None;
    }
    let open = subject.records.iter();
    let open = open.filter(|record| record.outcome == Outcome::Missing).count();
    (open > 0).then(|| {
        format!(
            "{open} of {} rollouts have no result yet: figures cover the results so far",
            subject.records.len()
        )
    })
}

/// Abbreviates a digest to [`DIGEST_DIGITS`] digits; `no digest` if it is empty.
pub(crate) fn abbreviated_digest(digest: &str) -> &str {
    match digest.get(..DIGEST_DIGITS).unwrap_or(digest) {
        "" => "no digest",
        digest => digest,
    }
}
