//! Subjects that the tests report on, all made from the example data.

use std::path::Path;

use benchmark::attempt::{Fingerprints, Pin, Provenance};
use paired::{Count, Outcome};
use report::{BeyondRange, Document, Origin, Quarantined, Subject, import};

pub(crate) fn example() -> Subject {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/openvla_oft");
    import(Path::new(folder)).expect("the example data")
}

pub(crate) fn document(subjects: Vec<Subject>) -> Document {
    Document::new(subjects).expect("no duplicates")
}

pub(crate) fn provenance(mujoco_version: &str, batch_mode: &str) -> Provenance {
    Provenance {
        host: "one".to_owned(),
        pin: Pin {
            renderer: "llvmpipe".to_owned(),
            look: benchmark::Look::default(),
            mujoco_version: mujoco_version.to_owned(),
            asset_pack: "libero".to_owned(),
            asset_pack_digest: "a".repeat(64),
        },
        fingerprint: "f".repeat(64),
        realisation: "matched".to_owned(),
        policy_name: "servo <b>".to_owned(),
        policy_checkpoint: "step 7".to_owned(),
        policy_checkpoint_digest: "c".repeat(64),
        policy_privileged: false,
        policy_canonical_only: false,
        policy_settings: [("executed".to_owned(), "8".to_owned())].into(),
        batch_mode: batch_mode.to_owned(),
        program_version: "0.1.0".to_owned(),
        simulator: Default::default(),
    }
}

/// Returns the example as a faulty campaign: some outcomes are quarantined or missing, results have
/// several simulators, batch modes and fingerprints, and the reproduction gate fails.
pub(crate) fn broken() -> Subject {
    let mut subject = example();
    for (index, record) in subject.records.iter_mut().enumerate() {
        match index % 97 {
            0 => record.outcome = Outcome::Quarantined,
            1 => record.outcome = Outcome::Missing,
            _ => {}
        }
    }
    let quarantined = subject.records.iter().filter(|r| r.outcome == Outcome::Quarantined);
    Subject {
        policy: "servo <b>".to_owned(),
        origin: Origin::Campaign {
            name: "broken".to_owned(),
            endpoint: "http://127.0.0.1:1".to_owned(),
            design: "libero-ctrl-v0.1".to_owned(),
        },
        realisation: Some("matched".parse().expect("a mode")),
        errors: quarantined
            .map(|record| Quarantined {
                rollout: record.id.to_string(),
                last_error: "the simulator said <nothing>".to_owned(),
            })
            .collect(),
        left_out: 3,
        beyond: Some(BeyondRange { actions: 1_234, of_actions: 1_800_000, rollouts: 17 }),
        fingerprints: Some(Fingerprints {
            results: [("f".repeat(64), 8_000), ("e".repeat(64), 3)].into(),
            mixed: (0..7).map(|state| format!("libero_goal/3 from state {state}")).collect(),
        }),
        provenances: vec![provenance("3.3.7", "single"), provenance("3.2.3", "dynamic 8")],
        published_nominal: Some(0.9),
        published_by_suite: Vec::new(),
        directions: benchmark::Directions::default(),
        reported_nominal: Some(Count { successes: 100, n: 2000 }),
        ..subject
    }
}

/// Returns the example with three replicates. Some outcomes of replicates 1 and 2 differ from those
/// of replicate 0.
pub(crate) fn replicated() -> Subject {
    let mut subject = example();
    for replicate in 1..3 {
        for index in 0..8400 {
            let mut record = subject.records[index];
            record.replicate = replicate;
            if (index + replicate as usize).is_multiple_of(13) {
                record.outcome = Outcome::from(record.outcome != Outcome::Success);
            }
            subject.records.push(record);
        }
    }
    subject
}
