//! The minimal subsets of planted rules are found at the promised cost.

use adaptive::subsets::{Evidence, Repeats, Strategy};

use super::planted::{Found, Kind, Rule, search_noisy, search_rule, seeded};

const RULES: usize = 300;
/// Subsets that a campaign does not run by itself.
const FURTHER: f64 = 56.0;

fn each(kind: Kind, strategy: Strategy) -> Vec<(Rule, Found)> {
    let mut rng = seeded(11);
    let one = |_| {
        let rule = Rule::draw(kind, &mut rng);
        let found = search_rule(&rule, strategy);
        (rule, found)
    };
    (0..RULES).map(one).collect()
}

fn mean_subsets(kind: Kind, strategy: Strategy) -> f64 {
    let subsets = each(kind, strategy)
        .into_iter()
        .map(|(_, found)| found.subsets as f64);
    subsets.sum::<f64>() / RULES as f64
}

fn exact_share(kind: Kind, strategy: Strategy) -> f64 {
    let all = each(kind, strategy);
    let exact = all.iter().filter(|(rule, found)| found.is_exact(rule));
    exact.count() as f64 / RULES as f64
}

#[test]
fn every_monotone_rule_is_recovered_exactly_and_established() {
    for strategy in Strategy::ALL {
        for kind in Kind::MONOTONE {
            for (rule, found) in each(kind, strategy) {
                assert!(
                    found.is_exact(&rule),
                    "{strategy:?} {kind:?} {rule:?} {found:?}"
                );
                assert_eq!(found.rollouts as usize, found.subsets, "each runs once");
                assert!(
                    found.batches <= 6,
                    "{strategy:?} {kind:?}: {}",
                    found.batches
                );
                let explanation = found.explanation.expect("a transition");
                for answer in &explanation.answers {
                    assert!(
                        answer
                            .minimal
                            .iter()
                            .all(|minimal| minimal.is_established())
                    );
                    assert_eq!(answer.non_monotone, []);
                }
            }
        }
    }
}

#[test]
fn the_mixture_takes_a_third_of_the_lattice_at_most() {
    let share = |strategy| {
        let means = Kind::MIXTURE
            .iter()
            .map(|&kind| mean_subsets(kind, strategy));
        means.sum::<f64>() / Kind::MIXTURE.len() as f64 / FURTHER
    };
    let (adaptive, top_down) = (share(Strategy::Adaptive), share(Strategy::TopDown));
    assert!(adaptive <= 1.0 / 3.0, "{adaptive}");
    assert!(top_down < adaptive, "{top_down}");
}

#[test]
fn a_masked_pair_is_always_found_by_running_all_pairs_and_often_missed_from_the_top() {
    assert_eq!(exact_share(Kind::MaskedPair, Strategy::Adaptive), 1.0);
    let top_down = exact_share(Kind::MaskedPair, Strategy::TopDown);
    assert!(top_down < 0.8, "{top_down}");
}

#[test]
fn only_the_whole_lattice_finds_every_masked_triple() {
    let adaptive = exact_share(Kind::MaskedTriple, Strategy::Adaptive);
    assert!(adaptive < 0.9, "{adaptive}");
    for kind in Kind::NON_MONOTONE {
        assert_eq!(exact_share(kind, Strategy::Exhaustive), 1.0);
    }
}

#[test]
fn a_noisy_policy_takes_replicates_and_the_same_subsets_are_found() {
    let mut rng = seeded(12);
    let evidence = Evidence::Repeated(Repeats::default());
    let (mut tried, mut explained, mut exact) = (0, 0, 0);
    for kind in Kind::MONOTONE {
        for _ in 0..60 {
            let rule = Rule::draw(kind, &mut rng);
            let found = search_noisy(&rule, Strategy::Adaptive, evidence, 0.02, &mut rng);
            tried += 1;
            explained += usize::from(found.explanation.is_some());
            exact += usize::from(found.is_exact(&rule));
        }
    }
    // The first rollouts of eight subsets all show the rule's outcomes with probability 0.98⁸ = 85
    // %. A transition that they hide is not pursued.
    assert!(explained * 100 >= 80 * tried, "{explained} of {tried}");
    assert!(exact * 100 >= 98 * explained, "{exact} of {explained}");
}
