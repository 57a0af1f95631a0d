//! Consistency of a result with its configuration's siblings. A matched comparison is invalid if
//! the scene, the initial state, the perturbation or the first frame differ between rollouts that
//! should share them. Assets, simulator and renderer are covered by the campaign's pin.

use std::sync::Arc;

use benchmark::attempt::{Digests, Provenance, Realised, RolloutResult};
use benchmark::{Axis, ManifestRow, Realisation, RolloutId};

use crate::ids::WorkerId;

/// Requirements of a campaign on one of its results.
#[derive(Clone, Debug)]
pub(crate) struct Demand<'a> {
    pub(crate) realisation: Realisation,
    pub(crate) row: &'a ManifestRow,
}

/// The parts of a result that siblings are compared by.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sibling {
    pub(crate) rollout: RolloutId,
    pub(crate) worker: WorkerId,
    pub(crate) digests: Digests,
    pub(crate) realised: Realised,
    pub(crate) origin: Arc<Provenance>,
}

impl Sibling {
    /// Returns true if a result that is consistent with `self` is also consistent with `other`, so
    /// that `other` need not be compared.
    pub(crate) fn stands_for(&self, other: &Sibling) -> bool {
        self.rollout == other.rollout
            && self.digests.first_frame.is_empty() == other.digests.first_frame.is_empty()
            && must_share_frames(&self.origin, &other.origin)
    }
}

/// Describes the number in a result that no rollout of the manifest row can have; `None` if the
/// result is possible. An action is clipped in the control step that executes it, and settling
/// steps are not counted.
pub(crate) fn impossible_count(row: &ManifestRow, result: &RolloutResult) -> Option<String> {
    let (steps, clipped, budget) = (result.steps, result.clipped_actions, row.max_steps);
    if steps > budget {
        return Some(format!(
            "the result has {steps} control steps, and its manifest row allows {budget}"
        ));
    }
    (clipped > steps)
        .then(|| format!("the result has {clipped} clipped actions in {steps} control steps"))
}

/// Describes the first difference that makes a result inconsistent; `None` if the result may be
/// stored. The siblings are committed rollouts of the same task and initial state, in the campaign
/// or its source.
pub(crate) fn difference(
    demand: &Demand<'_>,
    siblings: &[Sibling],
    result: &Sibling,
) -> Option<String> {
    let difference = difference_in_campaign(demand, &result.origin)
        .or_else(|| difference_in_row(demand.row, &result.realised));
    // Other simulators need not repeat a reset of the same seed, which the report says.
    if demand.row.simulator.is_some() {
        return difference
            .or_else(|| difference_in_packages(siblings, &result.digests))
            .or_else(|| difference_in_perturbation(demand, siblings, &result.realised));
    }
    // Variants of a task have scenes, initial states and pictures of their own.
    if demand.row.id.variant().is_some() {
        return difference;
    }
    difference
        .or_else(|| difference_in_scene(siblings, &result.digests))
        .or_else(|| difference_in_perturbation(demand, siblings, &result.realised))
        .or_else(|| difference_in_first_frame(siblings, result))
}

fn difference_in_campaign(demand: &Demand<'_>, provenance: &Provenance) -> Option<String> {
    let (value, other_value) = (&provenance.realisation, demand.realisation.name());
    differs("realisation mode", value, other_value, "in the campaign")
}

/// Checks that exactly the manifest row's axes were realised. A comparison with siblings does not
/// detect an omitted perturbation.
fn difference_in_row(row: &ManifestRow, realised: &Realised) -> Option<String> {
    let names = |axes: &mut dyn Iterator<Item = Axis>| {
        let names: Vec<&str> = axes.map(Axis::name).collect();
        match names.as_slice() {
            [] => "none".to_owned(),
            names => names.join(", "),
        }
    };
    let value = names(&mut realised.axes().map(|(axis, _)| axis));
    let other_value = names(&mut row.perturbation.axes().into_iter());
    let place = "in its manifest row";
    differs("set of perturbed axes", &value, &other_value, place)
}

/// Compares with one sibling only, since each sibling was compared with an earlier one when it was
/// stored.
fn difference_in_scene(siblings: &[Sibling], digests: &Digests) -> Option<String> {
    let sibling = siblings.first()?;
    let (other, place) = (&sibling.digests, sibling_place(sibling));
    differs("scene digest", &digests.scene, &other.scene, &place).or_else(|| {
        let (value, other_value) = (&digests.init_state, &other.init_state);
        differs("initial-state digest", value, other_value, &place)
    })
}

/// The scene of another simulator's task is identified by the task and the simulator's packages.
fn difference_in_packages(siblings: &[Sibling], digests: &Digests) -> Option<String> {
    let sibling = siblings.first()?;
    let place = sibling_place(sibling);
    let difference = differs(
        "digest of the simulator's packages",
        &digests.scene,
        &sibling.digests.scene,
        &place,
    );
    difference.map(|text| format!("{text}: install the same packages on all machines"))
}

fn difference_in_perturbation(
    demand: &Demand<'_>,
    siblings: &[Sibling],
    realised: &Realised,
) -> Option<String> {
    siblings.iter().find_map(|sibling| {
        realised.axes().find_map(|(axis, value)| {
            if !must_share(axis, demand.realisation, &demand.row.id, &sibling.rollout) {
                return None;
            }
            let difference = value.difference(sibling.realised.of(axis)?)?;
            let place = sibling_place(sibling);
            Some(format!("realisation of axis {axis}: {difference} {place}"))
        })
    })
}

/// Returns true if two rollouts of one initial state that both perturb `axis` must realise it
/// equally.
fn must_share(axis: Axis, mode: Realisation, first: &RolloutId, second: &RolloutId) -> bool {
    let is_same_configuration =
        first.level() == second.level() && first.config() == second.config();
    match mode {
        Realisation::Matched => is_same_configuration,
        // Random values are seeded with the rollout's id.
        Realisation::Reference if !axis.def().is_random => is_same_configuration,
        Realisation::Reference => first == second,
    }
}

/// Compares first frames. For one scene and initial state, the axes that act on the scene or the
/// pictures determine the policy's first observation. It is therefore equal in all replicates of a rollout, and in the
/// nominal rollout and the rollouts that perturb only actions or the instruction. Frames are
/// compared bit by bit, and only between results with the same renderer, fingerprint and policy, in
/// which the realised values of these axes have the same bits.
fn difference_in_first_frame(siblings: &[Sibling], result: &Sibling) -> Option<String> {
    if result.digests.first_frame.is_empty() {
        return None;
    }
    let has_same_view = |sibling: &&Sibling| {
        let has_same_values = |axis| sibling.realised.of(axis) == result.realised.of(axis);
        !sibling.digests.first_frame.is_empty()
            && must_share_frames(&sibling.origin, &result.origin)
            && Axis::every().filter(|axis| axis.def().in_first_frame()).all(has_same_values)
    };
    let sibling = siblings.iter().find(has_same_view)?;
    let (value, other_value) = (&result.digests.first_frame, &sibling.digests.first_frame);
    differs("first-frame digest", value, other_value, &sibling_place(sibling))
}

/// Returns true if results of these two origins must have equal frames of equal scenes: renderer,
/// fingerprint and policy are the same.
fn must_share_frames(first: &Provenance, second: &Provenance) -> bool {
    first.pin.renderer == second.pin.renderer
        && first.fingerprint == second.fingerprint
        && first.policy_name == second.policy_name
        && first.policy_checkpoint == second.policy_checkpoint
        && first.policy_checkpoint_digest == second.policy_checkpoint_digest
}

fn sibling_place(sibling: &Sibling) -> String {
    format!("in its sibling `{}` (worker `{}`)", sibling.rollout, sibling.worker)
}

fn differs(name: &str, value: &str, other_value: &str, place: &str) -> Option<String> {
    (value != other_value).then(|| format!("{name} is `{value}` here and `{other_value}` {place}"))
}

#[cfg(test)]
mod tests {
    use benchmark::Design;

    use benchmark::attempt::Pin;

    use super::*;

    /// Returns a digest of 64 equal digits.
    fn hex(digit: char) -> String {
        digit.to_string().repeat(64)
    }

    /// Returns realised axes, each with one value.
    fn axes(values: &[(Axis, f64)]) -> Realised {
        let mut realised = Realised::default();
        for (axis, value) in values {
            realised.add(*axis, vec![0.5], vec![*value]);
        }
        realised
    }

    fn row(id: &str) -> ManifestRow {
        let rows = Design::v0_1().expand().expect("rows");
        let id: RolloutId = id.parse().expect("an id");
        let mut rows = rows.into_iter();
        rows.find(|row| row.id == id).expect("a row of the design")
    }

    fn origin(mode: Realisation) -> Arc<Provenance> {
        Arc::new(Provenance {
            pin: Pin { renderer: "llvmpipe".to_owned(), ..Pin::default() },
            fingerprint: hex('f'),
            realisation: mode.to_string(),
            policy_name: "p".to_owned(),
            ..Provenance::default()
        })
    }

    fn sibling(id: &str, values: &[(Axis, f64)], first_frame: &str) -> Sibling {
        Sibling {
            rollout: id.parse().expect("an id"),
            worker: WorkerId("w".to_owned()),
            digests: Digests {
                scene: hex('1'),
                init_state: hex('2'),
                first_frame: first_frame.to_owned(),
            },
            realised: axes(values),
            origin: origin(Realisation::Matched),
        }
    }

    /// Describes the difference that makes a result with these realised values, in this mode,
    /// inconsistent with the sibling `committed`; `None` if it is consistent.
    fn inconsistency(
        (id, mode): (&str, Realisation),
        values: &[(Axis, f64)],
        first_frame: &str,
        committed: &Sibling,
    ) -> Option<String> {
        let row = row(id);
        let demand = Demand { realisation: mode, row: &row };
        let result = Sibling { origin: origin(mode), ..sibling(id, values, first_frame) };
        difference(&demand, std::slice::from_ref(committed), &result)
    }

    fn check(difference: Option<String>, words: &[&str]) {
        let difference = difference.expect("a difference");
        for word in words {
            assert!(difference.contains(word), "{difference} lacks {word}");
        }
    }

    const SIMULTANEOUS: &str = "goal/t0/simultaneous/L2/c01";
    const METRIC_VALUES: [(Axis, f64); 5] = [
        (Axis::Camera, 1.0),
        (Axis::Lighting, 2.0),
        (Axis::Robot, 3.0),
        (Axis::Sensor, 4.0),
        (Axis::Actuation, 5.0),
    ];

    fn difference_from_single(mode: Realisation, axis: Axis) -> Option<String> {
        let other = sibling(&format!("goal/t0/{axis}/L2/c01"), &[(axis, 0.0)], "");
        inconsistency((SIMULTANEOUS, mode), &METRIC_VALUES, "", &other)
    }

    #[test]
    fn in_matched_mode_an_axis_is_realised_alone_as_in_simultaneous() {
        for axis in Axis::METRIC {
            let difference = difference_from_single(Realisation::Matched, axis);
            check(difference, &[&format!("realisation of axis {axis}"), "`w`"]);
        }
        let same = sibling("goal/t0/sensor/L2/c01", &[(Axis::Sensor, 4.0)], "");
        let difference =
            inconsistency((SIMULTANEOUS, Realisation::Matched), &METRIC_VALUES, "", &same);
        assert_eq!(difference, None);
    }

    #[test]
    fn realised_values_agree_within_rounding_errors_and_differ_beyond() {
        let matched = (SIMULTANEOUS, Realisation::Matched);
        for (off_by, agrees) in [(1e-16, true), (1e-9, true), (1e-6, false)] {
            let other = sibling("goal/t0/robot/L2/c01", &[(Axis::Robot, 3.0 + off_by)], "");
            let difference = inconsistency(matched, &METRIC_VALUES, "", &other);
            assert_eq!(difference.is_none(), agrees, "{off_by}: {difference:?}");
        }
    }

    #[test]
    fn reference_mode_draws_sensor_and_actuation_anew_in_every_rollout() {
        for axis in [Axis::Camera, Axis::Lighting, Axis::Robot] {
            let difference = difference_from_single(Realisation::Reference, axis);
            check(difference, &[&format!("realisation of axis {axis}")]);
        }
        for axis in [Axis::Sensor, Axis::Actuation] {
            assert_eq!(difference_from_single(Realisation::Reference, axis), None);
        }
        // Replicates of one rollout must still agree.
        let of_sensor = ("goal/t0/sensor/L2/c01", Realisation::Reference);
        let replicate = sibling(of_sensor.0, &[(Axis::Sensor, 0.0)], "");
        let difference = inconsistency(of_sensor, &METRIC_VALUES[3..4], "", &replicate);
        check(difference, &["realisation of axis sensor", of_sensor.0]);
    }

    #[test]
    fn other_levels_and_configurations_may_be_realised_differently() {
        for id in ["goal/t0/sensor/L1/c01", "goal/t0/sensor/L2/c02"] {
            let other = sibling(id, &[(Axis::Sensor, 0.0)], "");
            let difference =
                inconsistency((SIMULTANEOUS, Realisation::Matched), &METRIC_VALUES, "", &other);
            assert_eq!(difference, None);
        }
    }

    #[test]
    fn a_missing_or_extra_axis_is_detected_from_the_manifest_row() {
        let other = sibling("goal/t0/nominal/i06", &[], "");
        let matched = |id| (id, Realisation::Matched);
        check(
            inconsistency(matched(SIMULTANEOUS), &METRIC_VALUES[..4], "", &other),
            &["set of perturbed axes", "actuation` in its manifest row"],
        );
        check(
            inconsistency(matched("goal/t0/language/L2/c01"), &METRIC_VALUES[..1], "", &other),
            &["`camera` here and `none`"],
        );
    }

    #[test]
    fn replicates_and_conditions_that_show_the_same_scene_show_the_same_first_frame() {
        let matched = |id| (id, Realisation::Matched);
        let (nominal, language) = ("goal/t0/nominal/i06", "goal/t0/language/L3/c01");
        let (actuation, actuated) = ("goal/t0/actuation/L2/c01", &METRIC_VALUES[4..]);
        let (frame, other_frame) = (hex('f'), hex('0'));
        let compare = |id, values: &[_], committed: &Sibling| {
            inconsistency(matched(id), values, &frame, committed)
        };
        for (id, values, committed) in [
            (actuation, actuated, sibling(nominal, &[], &other_frame)),
            (language, &[][..], sibling(nominal, &[], &other_frame)),
            (language, &[][..], sibling(actuation, actuated, &other_frame)),
            (SIMULTANEOUS, &METRIC_VALUES[..], sibling(SIMULTANEOUS, &METRIC_VALUES, &other_frame)),
        ] {
            check(compare(id, values, &committed), &["first-frame digest", "sibling"]);
        }
        assert_eq!(compare(language, &[], &sibling(nominal, &[], &frame)), None);
        // The simultaneous frame shows its camera perturbation, and rollouts without cameras have
        // no frame.
        assert_eq!(
            compare(SIMULTANEOUS, &METRIC_VALUES, &sibling(nominal, &[], &other_frame)),
            None
        );
        assert_eq!(compare(language, &[], &sibling(nominal, &[], "")), None);
        let without_frame =
            inconsistency(matched(language), &[], "", &sibling(nominal, &[], &other_frame));
        assert_eq!(without_frame, None);
    }

    #[test]
    fn another_renderer_policy_or_processor_may_show_other_frames() {
        let language = ("goal/t0/language/L3/c01", Realisation::Matched);
        let with_other_origin = |change: fn(&mut Provenance)| {
            let mut other = sibling("goal/t0/nominal/i06", &[], &hex('0'));
            change(Arc::make_mut(&mut other.origin));
            inconsistency(language, &[], &hex('f'), &other)
        };
        assert_eq!(
            with_other_origin(|provenance| provenance.pin.renderer = "NVIDIA".to_owned()),
            None
        );
        assert_eq!(
            with_other_origin(|provenance| provenance.policy_checkpoint_digest = hex('9')),
            None
        );
        assert_eq!(with_other_origin(|provenance| provenance.fingerprint = hex('e')), None);
        assert!(with_other_origin(|_| ()).is_some());
    }

    #[test]
    fn siblings_in_another_simulator_share_its_packages_but_not_always_their_state() {
        let rows = benchmark::manifest::parse(r#"{"simulator": "s", "task": "t", "seed": 0}"#);
        let row = &rows.expect("a valid row").remove(0);
        let demand = Demand { realisation: Realisation::Matched, row };
        let siblings = [sibling("sim/t0/nominal/i00", &[], "")];
        let mut result = siblings[0].clone();
        result.digests.init_state = hex('3');
        assert_eq!(difference(&demand, &siblings, &result), None);
        result.digests.scene = hex('3');
        let text = difference(&demand, &siblings, &result).expect("other packages");
        assert!(text.contains("install the same packages on all machines"), "{text}");
    }
}
