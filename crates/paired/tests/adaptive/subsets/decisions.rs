//! Properties of explanations and decisions that hold for any outcomes.

use std::collections::BTreeMap;

use benchmark::{Axis, AxisSet, Condition, Level, RolloutId, TaskRef};
use paired::adaptive::Decision;
use paired::adaptive::subsets::{
    Evidence, Explained, Lattice, Repeats, Request, Strategy, Unexplained, Verdict, explain, next,
    occurrences,
};
use paired::{Outcome, Transition};
use proptest::prelude::{
    BoxedStrategy, Just, any, prop, prop_assert, prop_assert_eq, prop_oneof, proptest,
};
use proptest::strategy::Strategy as Generator;

use super::full;
use super::planted::{is_of_source, source};

type Outcomes = BTreeMap<AxisSet, Outcome>;

fn subsets_with(
    outcomes: impl Generator<Value = Outcome> + 'static,
    axes: usize,
) -> BoxedStrategy<Outcomes> {
    let sets = full(axes).subsets();
    let outcomes = prop::collection::vec(outcomes, sets.len());
    outcomes.prop_map(move |outcomes| sets.iter().copied().zip(outcomes).collect()).boxed()
}

/// Outcomes under every subset of two to six axes. `quarantine` is the weight of quarantined
/// outcomes; success and failure have the weight 10.
fn any_outcomes(quarantine: u32) -> BoxedStrategy<Outcomes> {
    let outcome = prop_oneof![
        10 => Just(Outcome::Success),
        10 => Just(Outcome::Failure),
        quarantine => Just(Outcome::Quarantined),
    ];
    (2..=6_usize).prop_flat_map(move |axes| subsets_with(outcome.clone(), axes)).boxed()
}

/// Outcomes that form a transition, in either direction.
fn transitions() -> BoxedStrategy<Outcomes> {
    let drawn = (any_outcomes(0), any::<bool>());
    drawn
        .prop_map(|(mut outcomes, emergent)| {
            let full = *outcomes.keys().last().expect("sets");
            for (set, outcome) in &mut outcomes {
                if emergent && set.len() < 2 {
                    *outcome = Outcome::Success;
                }
            }
            outcomes.insert(full, Outcome::from(!emergent));
            if !emergent {
                outcomes.insert(AxisSet::of(Axis::Camera), Outcome::Failure);
            }
            outcomes
        })
        .boxed()
}

/// Emergent failures of six axes in which every superset of a failing set fails.
fn monotone() -> BoxedStrategy<Outcomes> {
    let sets = AxisSet::ALL.subsets();
    let larger: Vec<AxisSet> = sets.iter().copied().filter(|set| set.len() > 1).collect();
    prop::collection::vec(prop::sample::select(larger), 1..6)
        .prop_map(move |failing| {
            let outcome = |set: &AxisSet| {
                let fails = failing.iter().any(|culprit| culprit.is_subset(*set));
                (*set, Outcome::from(!fails))
            };
            sets.iter().map(outcome).collect()
        })
        .boxed()
}

fn full_of(outcomes: &Outcomes) -> AxisSet {
    *outcomes.keys().last().expect("sets")
}

/// Returns the lattice with the outcomes of the subsets that every campaign runs: those of fewer
/// than two axes, and all axes.
fn campaign(outcomes: &Outcomes) -> Lattice {
    source(full_of(outcomes), Evidence::Once, |set| outcomes[&set])
}

fn complete(outcomes: &Outcomes) -> Lattice {
    let mut lattice = Lattice::new(full_of(outcomes), Evidence::Once).expect("two axes at least");
    for (&set, &outcome) in outcomes {
        lattice.record(set, outcome).expect("a subset");
    }
    lattice
}

/// Runs the decided rollouts, at most `cut` of each batch, until no batch is decided.
fn search(outcomes: &Outcomes, strategy: Strategy, cut: usize) -> Lattice {
    let mut lattice = campaign(outcomes);
    for _ in 0..=outcomes.len() {
        let Decision::Run(batch) = next(&lattice, strategy) else {
            assert_eq!(next(&lattice, strategy), Decision::Done);
            return lattice;
        };
        assert!(!batch.is_empty());
        for Request { set, rollouts } in batch.into_iter().take(cut) {
            assert_eq!(rollouts, 1);
            assert_eq!(lattice.tally(set).requested(), 0, "{set} was requested before");
            lattice.record(set, outcomes[&set]).expect("a subset");
        }
    }
    panic!("more batches than subsets");
}

fn minimal_sets(lattice: &Lattice) -> Vec<(AxisSet, Vec<AxisSet>)> {
    let answers = explain(lattice).map(|explanation| explanation.answers);
    let answers = answers.unwrap_or_default().into_iter();
    answers
        .map(|answer| {
            let minimal = answer.minimal.iter().map(|minimal| minimal.set);
            (answer.start, minimal.collect())
        })
        .collect()
}

proptest! {
    #[test]
    fn explanations_agree_with_their_definitions(outcomes in transitions(), run in prop::collection::vec(any::<bool>(), 64)) {
        let full = full_of(&outcomes);
        let mut lattice = campaign(&outcomes);
        for ((&set, &outcome), run) in outcomes.iter().zip(run) {
            if run && !is_of_source(set, full) {
                lattice.record(set, outcome).expect("a subset");
            }
        }
        let success = |set: AxisSet| lattice.verdict(set).success();
        let explanation = explain(&lattice).expect("a transition");
        let simultaneous = success(full).expect("known");
        let starts: Vec<AxisSet> = match simultaneous {
            false => vec![AxisSet::EMPTY],
            true => full.axes().map(AxisSet::of).filter(|set| success(*set) == Some(false)).collect(),
        };
        prop_assert_eq!(explanation.answers.iter().map(|answer| answer.start).collect::<Vec<_>>(), starts);
        for answer in &explanation.answers {
            let strictly_inside = |set: AxisSet, end: AxisSet| {
                answer.start.is_proper_subset(set) && set.is_proper_subset(end)
            };
            let flips = |set: AxisSet| success(set) == Some(simultaneous);
            for set in full.subsets() {
                let below: Vec<AxisSet> = full.subsets().into_iter().filter(|below| strictly_inside(*below, set)).collect();
                let is_minimal = answer.start.is_proper_subset(set) && flips(set) && !below.iter().any(|below| flips(*below));
                let reported_subset = answer.minimal.iter().find(|minimal| minimal.set == set);
                prop_assert_eq!(reported_subset.is_some(), is_minimal, "{}", set);
                if let Some(reported_subset) = reported_subset {
                    let unknown: Vec<AxisSet> = below.into_iter().filter(|below| success(*below).is_none()).collect();
                    prop_assert_eq!(reported_subset.is_established(), unknown.is_empty());
                    prop_assert_eq!(&reported_subset.open, &unknown);
                }
                let unflipped = answer.start.is_subset(set) && success(set) == Some(!simultaneous);
                let larger = |above: AxisSet| set.is_proper_subset(above) && success(above) == Some(!simultaneous);
                let is_largest = (unflipped || set == answer.start) && !full.subsets().into_iter().any(larger);
                prop_assert_eq!(answer.largest_unflipped.contains(&set), is_largest, "{}", set);
            }
            for pair in &answer.non_monotone {
                prop_assert!(pair.minimal.is_proper_subset(pair.superset));
                prop_assert!(flips(pair.minimal) && success(pair.superset) == Some(!simultaneous));
            }
            let has_unflipped_superset = |minimal: AxisSet| {
                let mut above = full.subsets().into_iter().filter(|set| minimal.is_subset(*set));
                above.any(|set| success(set) == Some(!simultaneous))
            };
            for minimal in &answer.minimal {
                let reported = answer.non_monotone.iter().any(|pair| pair.minimal == minimal.set);
                prop_assert_eq!(reported, has_unflipped_superset(minimal.set));
            }
        }
    }

    #[test]
    fn every_search_ends_and_the_exhaustive_one_finds_all_minimal_subsets(
        outcomes in any_outcomes(3), cut in 1..64_usize,
    ) {
        search(&outcomes, Strategy::Adaptive, cut);
        let exhaustive = minimal_sets(&search(&outcomes, Strategy::Exhaustive, cut));
        prop_assert_eq!(exhaustive, minimal_sets(&complete(&outcomes)));
    }

    #[test]
    fn monotone_outcomes_are_explained_exactly(outcomes in monotone(), cut in 1..20_usize) {
        let truth = minimal_sets(&complete(&outcomes));
        for strategy in Strategy::ALL {
            let lattice = search(&outcomes, strategy, cut);
            prop_assert_eq!(&minimal_sets(&lattice), &truth, "{:?}", strategy);
        }
    }

    #[test]
    fn reported_subsets_are_verified_and_include_all_minimal_pairs(outcomes in transitions(), cut in 1..20_usize) {
        let truth = minimal_sets(&complete(&outcomes));
        let lattice = search(&outcomes, Strategy::Adaptive, cut);
        for answer in explain(&lattice).expect("a transition").answers {
            let of_start = truth.iter().find(|(start, _)| *start == answer.start);
            let truly_minimal = &of_start.expect("the same starts").1;
            for minimal in &answer.minimal {
                let is_right = truly_minimal.contains(&minimal.set);
                prop_assert!(is_right || !minimal.is_established(), "{:?}", minimal);
                let one_axis_less = minimal.set.len() - 1;
                let lacks_one_axis = minimal.open.iter().any(|set| set.len() == one_axis_less);
                prop_assert!(!lacks_one_axis, "{:?}", minimal);
                prop_assert!(minimal.set.len() > 3 || minimal.is_established(), "{:?}", minimal);
            }
        }
        let pairs = |(start, sets): &(AxisSet, Vec<AxisSet>)| {
            let pairs = sets.iter().copied().filter(|set| set.len() == 2);
            (*start, pairs.collect::<Vec<_>>())
        };
        let found_pairs: Vec<_> = minimal_sets(&lattice).iter().map(pairs).collect();
        prop_assert_eq!(found_pairs, truth.iter().map(pairs).collect::<Vec<_>>());
    }

    #[test]
    fn decisions_do_not_depend_on_the_order_of_outcomes(
        rollouts in prop::collection::vec((prop::sample::select(full(4).subsets()), prop::sample::select(vec![
            Outcome::Success, Outcome::Failure, Outcome::Missing, Outcome::Quarantined]), any::<bool>()), 0..60),
    ) {
        for evidence in [Evidence::Once, Evidence::Repeated(Repeats { batch: 2, most: 6, error: 0.5 })] {
            let mut forwards = Lattice::new(full(4), evidence).expect("four axes");
            let mut backwards = forwards.clone();
            let add = |lattice: &mut Lattice, (set, outcome, selects): &(AxisSet, Outcome, bool)| {
                let added = match selects {
                    true => lattice.record_source(*set, *outcome),
                    false => lattice.record(*set, *outcome),
                };
                added.expect("a subset");
            };
            rollouts.iter().for_each(|rollout| add(&mut forwards, rollout));
            rollouts.iter().rev().for_each(|rollout| add(&mut backwards, rollout));
            for strategy in Strategy::ALL {
                let decision = next(&forwards, strategy);
                prop_assert_eq!(&decision, &next(&backwards, strategy));
                if let Decision::Run(batch) = decision {
                    for Request { set, rollouts } in batch {
                        let requested = forwards.tally(set).requested();
                        prop_assert!(rollouts > 0);
                        let most = if evidence == Evidence::Once { 1 } else { 6 };
                        prop_assert!(requested + rollouts <= most);
                    }
                }
            }
            prop_assert_eq!(explain(&forwards), explain(&backwards));
        }
    }

    #[test]
    fn no_rollout_is_requested_while_one_is_pending(
        outcomes in transitions(), index in any::<prop::sample::Index>(),
    ) {
        let mut lattice = campaign(&outcomes);
        if let Decision::Run(batch) = next(&lattice, Strategy::Adaptive) {
            let pending = index.get(&batch).set;
            for Request { set, .. } in &batch {
                let outcome = if *set == pending { Outcome::Missing } else { outcomes[set] };
                lattice.record(*set, outcome).expect("a subset");
            }
            for strategy in Strategy::ALL {
                prop_assert_eq!(next(&lattice, strategy), Decision::Wait);
            }
        }
    }

    #[test]
    fn a_search_with_repeats_ends_within_the_largest_number_of_rollouts(
        coins in prop::collection::vec(any::<bool>(), 16 * 6),
        quarantined in prop::sample::select(full(4).subsets()),
    ) {
        let repeats = Repeats { batch: 2, most: 6, error: 0.8 };
        let sets = full(4).subsets();
        let outcome = |set: AxisSet, number: u32| {
            let index = sets.iter().position(|other| *other == set).expect("a subset");
            match set == quarantined && set.len() == 2 {
                true => Outcome::Quarantined,
                false => Outcome::from(coins[16 * (number as usize % 6) + index] || set.len() < 2),
            }
        };
        let mut lattice = source(full(4), Evidence::Repeated(repeats), |set| outcome(set, 0));
        let mut batches = 0;
        while let Decision::Run(batch) = next(&lattice, Strategy::Adaptive) {
            batches += 1;
            prop_assert!(batches <= 16 * 3);
            for Request { set, rollouts } in batch {
                for _ in 0..rollouts {
                    let number = lattice.outcomes().both(set).requested();
                    lattice.record(set, outcome(set, number)).expect("a subset");
                }
                prop_assert!(lattice.tally(set).requested() <= repeats.most);
            }
        }
        prop_assert_eq!(next(&lattice, Strategy::Adaptive), Decision::Done);
    }
}

fn lattice_of(outcomes: &[(&str, Outcome)]) -> Lattice {
    let mut lattice = Lattice::new(full(3), Evidence::Once).expect("three axes");
    for (set, outcome) in outcomes {
        let set = set.parse().expect("a set");
        lattice.record(set, *outcome).expect("a subset");
    }
    lattice
}

const EMERGENT: [(&str, Outcome); 4] = [
    ("camera", Outcome::Success),
    ("lighting", Outcome::Success),
    ("robot", Outcome::Success),
    ("camera+lighting+robot", Outcome::Failure),
];

#[test]
fn without_a_transition_the_error_names_the_reason() {
    assert_eq!(explain(&lattice_of(&EMERGENT[1..])), Err(Unexplained::Incomplete));
    let unchanged =
        lattice_of(&[&EMERGENT[..3], &[("camera+lighting+robot", Outcome::Success)]].concat());
    let reason = Unexplained::Unchanged(Transition::StillSucceeds);
    assert_eq!(explain(&unchanged), Err(reason));
    assert_eq!(
        reason.to_string(),
        "simultaneous perturbation changes nothing: the rollout still succeeds"
    );
    let nominal = lattice_of(&[&EMERGENT[..], &[("none", Outcome::Failure)]].concat());
    assert_eq!(explain(&nominal), Err(Unexplained::NominalFails));
    for lattice in [unchanged, nominal] {
        assert_eq!(next(&lattice, Strategy::Adaptive), Decision::Done);
    }
}

#[test]
fn a_quarantined_pair_is_neither_run_again_nor_inferred() {
    let lattice = lattice_of(
        &[
            &EMERGENT[..],
            &[
                ("camera+lighting", Outcome::Quarantined),
                ("camera+robot", Outcome::Success),
                ("lighting+robot", Outcome::Success),
            ],
        ]
        .concat(),
    );
    assert_eq!(next(&lattice, Strategy::Adaptive), Decision::Done);
    let answer = &explain(&lattice).expect("a transition").answers[0];
    assert_eq!(answer.minimal.len(), 1);
    assert_eq!(answer.minimal[0].set, lattice.full());
    assert_eq!(answer.minimal[0].open, ["camera+lighting".parse().expect("a set")]);
    assert_eq!(lattice.verdict(answer.minimal[0].open[0]), Verdict::Quarantined);
}

fn simultaneous_id(task: usize) -> RolloutId {
    let task = TaskRef::all().nth(task).expect("a task");
    RolloutId::perturbed(task, Condition::Simultaneous, Level::L2, 0).expect("a perturbed level")
}

#[test]
fn explanations_are_unchanged_by_json_and_frequent_subsets_come_first() {
    let failing = |pairs: &[&'static str]| {
        let pairs = pairs.iter().map(|pair| (*pair, Outcome::Failure));
        lattice_of(&EMERGENT.into_iter().chain(pairs).collect::<Vec<_>>())
    };
    let compensated = lattice_of(&[
        ("camera", Outcome::Failure),
        ("lighting", Outcome::Success),
        ("robot", Outcome::Success),
        ("camera+robot", Outcome::Success),
        ("camera+lighting+robot", Outcome::Success),
    ]);
    let lattices = [
        compensated,
        failing(&["lighting+robot", "camera+robot"]),
        failing(&["lighting+robot"]),
        failing(&[]),
    ];
    let explained: Vec<Explained> = lattices
        .iter()
        .enumerate()
        .map(|(task, lattice)| Explained::of(simultaneous_id(task), lattice).expect("a transition"))
        .collect();
    assert_eq!(explained[1].rollouts, 2);
    let text = serde_json::to_string(&explained).expect("JSON");
    let parsed: Vec<Explained> = serde_json::from_str(&text).expect("explanations");
    assert_eq!(parsed, explained);
    let rows: Vec<String> = occurrences(&explained)
        .iter()
        .map(|o| {
            format!(
                "{} {} {}: {}, {}",
                o.transition.name(),
                o.start,
                o.set,
                o.configurations,
                o.established
            )
        })
        .collect();
    assert_eq!(
        rows,
        [
            "emergent none lighting+robot: 2, 2",
            "emergent none camera+robot: 1, 1",
            "emergent none camera+lighting+robot: 1, 0",
            "compensated camera camera+robot: 1, 1",
        ]
    );
}
