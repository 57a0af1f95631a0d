//! Whether a result may stand beside its configuration's others. Pure. A
//! matched comparison is worth nothing if the scene, the initial state, the
//! assets, the simulator, the perturbation or the first picture moved between
//! rollouts that share them.

use protocol::{Axis, ManifestRow, Realisation, RolloutId};

use crate::digests::AxisDigests;
use crate::store::results::{Digests, Provenance, Sibling};
use crate::store::workers::Pin;

/// The axes that the policy's pictures show before its first action. The
/// others act later, or in words.
const PICTURED: [Axis; 4] = [Axis::Camera, Axis::Lighting, Axis::Robot, Axis::Sensor];
/// The axes whose realisation draws nothing: it follows from the parameters
/// and the initial state alone, in either mode.
const DRAWING_NOTHING: [Axis; 3] = [Axis::Camera, Axis::Lighting, Axis::Robot];

/// What a campaign demands of one of its results.
#[derive(Clone, Debug)]
pub(crate) struct Demand<'a> {
    /// What the campaign is pinned to.
    pub(crate) pin: Option<Pin>,
    /// The campaign's realisation mode.
    pub(crate) realisation: Realisation,
    /// The rollout that was to be run.
    pub(crate) row: &'a ManifestRow,
}

/// The first difference that keeps a result out, in words; none if it may
/// stand. The siblings are committed rollouts of the same campaign, task and
/// initial state.
pub(crate) fn difference(
    demand: &Demand<'_>,
    siblings: &[Sibling],
    provenance: &Provenance,
    digests: &Digests,
) -> Option<String> {
    from_the_campaign(demand, provenance)
        .or_else(|| from_the_row(demand.row, &digests.perturbation))
        .or_else(|| from_the_scene(siblings, digests))
        .or_else(|| from_the_perturbation(demand, siblings, &digests.perturbation))
        .or_else(|| from_the_first_frame(siblings, provenance, digests))
}

fn from_the_campaign(demand: &Demand<'_>, provenance: &Provenance) -> Option<String> {
    let campaign = "in the campaign";
    let pinned = demand.pin.as_ref().and_then(|pin| {
        let pack = (&provenance.asset_pack_digest, &pin.asset_pack_digest);
        let mujoco = (&provenance.mujoco_version, &pin.mujoco_version);
        let renderer = (&provenance.renderer, &pin.renderer);
        differs("asset-pack digest", pack.0, pack.1, campaign)
            .or_else(|| differs("MuJoCo version", mujoco.0, mujoco.1, campaign))
            .or_else(|| differs("renderer", renderer.0, renderer.1, campaign))
    });
    pinned.or_else(|| {
        let (here, there) = (&provenance.realisation, demand.realisation.name());
        differs("realisation mode", here, there, campaign)
    })
}

/// A perturbation that was left out would agree with every sibling.
fn from_the_row(row: &ManifestRow, realised: &AxisDigests) -> Option<String> {
    let names = |axes: &mut dyn Iterator<Item = Axis>| {
        let names: Vec<&str> = axes.map(Axis::name).collect();
        match names.as_slice() {
            [] => "none".to_owned(),
            names => names.join(", "),
        }
    };
    let here = names(&mut realised.axes());
    let there = names(&mut row.perturbation.axes().into_iter());
    differs(
        "set of perturbed axes",
        &here,
        &there,
        "in its manifest row",
    )
}

/// One sibling speaks for the others: each was compared before it was stored.
fn from_the_scene(siblings: &[Sibling], digests: &Digests) -> Option<String> {
    let sibling = siblings.first()?;
    let whose = named(sibling);
    let state = (&digests.init_state, &sibling.init_state);
    differs("scene digest", &digests.scene, &sibling.scene, &whose)
        .or_else(|| differs("initial-state digest", state.0, state.1, &whose))
}

fn from_the_perturbation(
    demand: &Demand<'_>,
    siblings: &[Sibling],
    realised: &AxisDigests,
) -> Option<String> {
    siblings.iter().find_map(|sibling| {
        let there = &sibling.perturbation;
        realised.axes().find_map(|axis| {
            if !shares(axis, demand.realisation, &demand.row.id, &sibling.rollout) {
                return None;
            }
            let what = format!("perturbation digest of axis {axis}");
            differs(&what, realised.of(axis)?, there.of(axis)?, &named(sibling))
        })
    })
}

/// Whether two rollouts of one initial state that both perturb an axis must
/// have realised it identically.
fn shares(axis: Axis, mode: Realisation, one: &RolloutId, other: &RolloutId) -> bool {
    let of_one_configuration = one.level() == other.level() && one.config() == other.config();
    match mode {
        Realisation::Matched => of_one_configuration,
        // What is drawn is drawn from the rollout's id.
        Realisation::Reference if DRAWING_NOTHING.contains(&axis) => of_one_configuration,
        Realisation::Reference => one == other,
    }
}

/// Of one scene and initial state, what is perturbed in the pictures decides
/// what the policy sees first: replicates see the same, and so do the nominal
/// rollout and those that perturb actions or words. Another renderer draws
/// other pictures, and another policy looks through other cameras.
fn from_the_first_frame(
    siblings: &[Sibling],
    provenance: &Provenance,
    digests: &Digests,
) -> Option<String> {
    if digests.first_frame.is_empty() {
        return None;
    }
    let looks_alike = |sibling: &&Sibling| {
        let there = &sibling.perturbation;
        let pictured = |axis: &Axis| there.of(*axis) == digests.perturbation.of(*axis);
        !sibling.first_frame.is_empty()
            && sibling.renderer == provenance.renderer
            && sibling.policy_name == provenance.policy_name
            && sibling.policy_checkpoint == provenance.policy_checkpoint
            && sibling.policy_checkpoint_digest == provenance.policy_checkpoint_digest
            && PICTURED.iter().all(pictured)
    };
    let sibling = siblings.iter().find(looks_alike)?;
    let (here, there) = (&digests.first_frame, &sibling.first_frame);
    differs("first-frame digest", here, there, &named(sibling))
}

fn named(sibling: &Sibling) -> String {
    format!(
        "in its sibling `{}` (worker `{}`)",
        sibling.rollout, sibling.worker
    )
}

fn differs(what: &str, here: &str, there: &str, whose: &str) -> Option<String> {
    (here != there).then(|| format!("{what} is `{here}` here and `{there}` {whose}"))
}

#[cfg(test)]
mod tests {
    use protocol::Design;

    use super::*;
    use crate::ids::WorkerId;

    /// A digest of 64 times this digit.
    fn hex(digit: u8) -> String {
        char::from(digit).to_string().repeat(64)
    }

    /// The digests of some axes, each of its own digit.
    fn axes(digests: &[(Axis, u8)]) -> AxisDigests {
        let parts = digests.iter();
        let parts: Vec<String> = parts
            .map(|&(axis, digit)| format!("{axis}:{}", hex(digit)))
            .collect();
        parts.join(",").parse().expect("axis digests")
    }

    /// A row of the whole design.
    fn row(id: &str) -> ManifestRow {
        let rows = Design::v0_1().expand().expect("rows");
        let id: RolloutId = id.parse().expect("an id");
        let mut rows = rows.into_iter();
        rows.find(|row| row.id == id).expect("one of the design")
    }

    fn provenance() -> Provenance {
        Provenance {
            host: "here".to_owned(),
            renderer: "llvmpipe".to_owned(),
            fingerprint: hex(b'f'),
            mujoco_version: "3.3.7".to_owned(),
            asset_pack: "primitives".to_owned(),
            asset_pack_digest: hex(b'a'),
            realisation: "matched".to_owned(),
            policy_name: "p".to_owned(),
            policy_checkpoint: String::new(),
            policy_checkpoint_digest: String::new(),
            policy_privileged: false,
            policy_canonical_only: false,
            batch_mode: String::new(),
            program_version: String::new(),
        }
    }

    fn sibling(id: &str, perturbation: &[(Axis, u8)], first_frame: &str) -> Sibling {
        let there = provenance();
        Sibling {
            rollout: id.parse().expect("an id"),
            worker: WorkerId("w".to_owned()),
            scene: hex(b'1'),
            init_state: hex(b'2'),
            perturbation: axes(perturbation),
            first_frame: first_frame.to_owned(),
            renderer: there.renderer,
            policy_name: there.policy_name,
            policy_checkpoint: there.policy_checkpoint,
            policy_checkpoint_digest: there.policy_checkpoint_digest,
        }
    }

    /// What keeps a result out that realised these, of this mode.
    fn kept_out(
        (id, mode): (&str, Realisation),
        perturbation: &[(Axis, u8)],
        first_frame: &str,
        sibling: &Sibling,
    ) -> Option<String> {
        let row = row(id);
        let demand = Demand {
            pin: None,
            realisation: mode,
            row: &row,
        };
        let digests = Digests {
            scene: hex(b'1'),
            init_state: hex(b'2'),
            perturbation: axes(perturbation),
            first_frame: first_frame.to_owned(),
        };
        let provenance = Provenance {
            realisation: mode.to_string(),
            ..provenance()
        };
        difference(
            &demand,
            std::slice::from_ref(sibling),
            &provenance,
            &digests,
        )
    }

    fn check(difference: Option<String>, words: &[&str]) {
        let difference = difference.expect("a difference");
        for word in words {
            assert!(difference.contains(word), "{difference} lacks {word}");
        }
    }

    const COMBINATION: &str = "goal/t0/combination/L2/c01";
    const FIVE: [(Axis, u8); 5] = [
        (Axis::Camera, b'a'),
        (Axis::Lighting, b'b'),
        (Axis::Robot, b'c'),
        (Axis::Sensor, b'd'),
        (Axis::Actuation, b'e'),
    ];

    /// A combination whose sibling realised one of its axes differently.
    fn against_a_single(mode: Realisation, axis: Axis) -> Option<String> {
        let other = sibling(&format!("goal/t0/{axis}/L2/c01"), &[(axis, b'0')], "");
        kept_out((COMBINATION, mode), &FIVE, "", &other)
    }

    #[test]
    fn matched_mode_realises_every_axis_alone_as_in_the_combination() {
        for axis in Axis::METRIC {
            let difference = against_a_single(Realisation::Matched, axis);
            check(difference, &[&format!("digest of axis {axis}"), "`w`"]);
        }
        let same = sibling("goal/t0/sensor/L2/c01", &[(Axis::Sensor, b'd')], "");
        let difference = kept_out((COMBINATION, Realisation::Matched), &FIVE, "", &same);
        assert_eq!(difference, None);
    }

    #[test]
    fn reference_mode_draws_sensor_and_actuation_anew_in_every_rollout() {
        for axis in DRAWING_NOTHING {
            let difference = against_a_single(Realisation::Reference, axis);
            check(difference, &[&format!("digest of axis {axis}")]);
        }
        for axis in [Axis::Sensor, Axis::Actuation] {
            assert_eq!(against_a_single(Realisation::Reference, axis), None);
        }
        // But not in a replicate of the very rollout.
        let of_sensor = ("goal/t0/sensor/L2/c01", Realisation::Reference);
        let replicate = sibling(of_sensor.0, &[(Axis::Sensor, b'0')], "");
        let difference = kept_out(of_sensor, &[(Axis::Sensor, b'd')], "", &replicate);
        check(difference, &["digest of axis sensor", of_sensor.0]);
    }

    #[test]
    fn other_levels_and_configurations_realise_what_they_like() {
        for id in ["goal/t0/sensor/L1/c01", "goal/t0/sensor/L2/c02"] {
            let other = sibling(id, &[(Axis::Sensor, b'0')], "");
            let difference = kept_out((COMBINATION, Realisation::Matched), &FIVE, "", &other);
            assert_eq!(difference, None);
        }
    }

    #[test]
    fn an_axis_left_out_or_added_is_told_from_the_manifest_row() {
        let other = sibling("goal/t0/clean/i06", &[], "");
        let matched = |id| (id, Realisation::Matched);
        check(
            kept_out(matched(COMBINATION), &FIVE[..4], "", &other),
            &["set of perturbed axes", "actuation` in its manifest row"],
        );
        check(
            kept_out(matched("goal/t0/language/L2/c01"), &FIVE[..1], "", &other),
            &["`camera` here and `none`"],
        );
    }

    #[test]
    fn replicates_and_conditions_that_leave_the_pictures_alone_see_the_same_first_frame() {
        let matched = |id| (id, Realisation::Matched);
        let (clean, language) = ("goal/t0/clean/i06", "goal/t0/language/L3/c01");
        let (actuation, actuated) = ("goal/t0/actuation/L2/c01", &FIVE[4..]);
        let saw = |id, realised: &[_], other: &Sibling| {
            kept_out(matched(id), realised, &hex(b'f'), other)
        };
        let words = ["first-frame digest", "sibling"];
        check(
            saw(actuation, actuated, &sibling(clean, &[], &hex(b'0'))),
            &words,
        );
        check(saw(language, &[], &sibling(clean, &[], &hex(b'0'))), &words);
        check(
            saw(language, &[], &sibling(actuation, actuated, &hex(b'0'))),
            &words,
        );
        check(
            saw(COMBINATION, &FIVE, &sibling(COMBINATION, &FIVE, &hex(b'0'))),
            &words,
        );

        assert_eq!(saw(language, &[], &sibling(clean, &[], &hex(b'f'))), None);
        // The combination shows its camera, and blind rollouts show nothing.
        assert_eq!(
            saw(COMBINATION, &FIVE, &sibling(clean, &[], &hex(b'0'))),
            None
        );
        assert_eq!(saw(language, &[], &sibling(clean, &[], "")), None);
        let blind = kept_out(matched(language), &[], "", &sibling(clean, &[], &hex(b'0')));
        assert_eq!(blind, None);
    }

    #[test]
    fn another_renderer_or_policy_draws_other_frames() {
        let nominal = || sibling("goal/t0/clean/i06", &[], &hex(b'0'));
        let language = ("goal/t0/language/L3/c01", Realisation::Matched);
        for other in [
            Sibling {
                renderer: "NVIDIA".to_owned(),
                ..nominal()
            },
            Sibling {
                policy_checkpoint_digest: hex(b'9'),
                ..nominal()
            },
        ] {
            assert_eq!(kept_out(language, &[], &hex(b'f'), &other), None);
        }
    }
}
