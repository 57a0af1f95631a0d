//! The sentences of reports distinguish three simulated policies: random outcomes without any
//! effect, a planted interaction, and planted effects of directions.

use std::collections::BTreeSet;

use paired::{Bootstrap, FindingKind, Options, report};

use crate::simulated::{Chance, Planted};

const CAMPAIGNS: u64 = 100;

/// Returns the number of campaigns, of a hundred, whose sentences about simultaneity and directions
/// claim what was planted and nothing else.
fn count_correct(planted: Planted, expected: &[(FindingKind, &str)]) -> usize {
    let options = Options {
        // No sentence uses the bootstrap intervals.
        bootstrap: Bootstrap { replicates: 2, ..Bootstrap::default() },
        ..Options::default()
    };
    let is_correct = |seed: &u64| {
        let records = planted.campaign(&mut Chance::new(*seed));
        let report = report(&records, &options).expect("each rollout once");
        let is_tested = |kind| matches!(kind, FindingKind::Simultaneity | FindingKind::Directions);
        let findings = report.findings.iter();
        let findings: Vec<_> =
            findings.filter(|finding| finding.claims && is_tested(finding.kind)).collect();
        let kinds: BTreeSet<_> = findings.iter().map(|finding| finding.kind).collect();
        kinds == expected.iter().map(|(kind, _)| *kind).collect()
            && findings.iter().all(|finding| {
                let words = expected.iter().filter(|(kind, _)| *kind == finding.kind);
                words.into_iter().all(|(_, words)| finding.sentence.contains(words))
                    && !finding.sentence.contains("compensated")
            })
    };
    (0..CAMPAIGNS).filter(is_correct).count()
}

#[test]
fn sentences_distinguish_chance_an_interaction_and_an_effect_of_directions() {
    let emerge = (FindingKind::Simultaneity, "failures emerge beyond chance");
    let depends = (FindingKind::Directions, "success depends on the direction");
    for (planted, name, expected) in [
        (Planted::Coins, "coins", &[][..]),
        (Planted::Interaction, "interaction", &[emerge]),
        (Planted::Directions, "directions", &[depends]),
    ] {
        let correct = count_correct(planted, expected);
        println!("{name}: {correct} of {CAMPAIGNS}");
        assert!(correct >= 95, "{name}: {correct} of {CAMPAIGNS}");
    }
}
