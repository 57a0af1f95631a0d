//! What pairing rests on: an axis means the same alone and among any others.

use proptest::prelude::*;
use proptest::sample::{select, subsequence};
use protocol::streams::Randomness;
use protocol::{
    Axis, CampaignSpec, Condition, Level, ManifestRow, Nominal, PolicyRoute, Realisation, TaskRef,
};

fn campaign(axes: Vec<Axis>, task: TaskRef, level: Level, config: u16) -> CampaignSpec {
    let policy = PolicyRoute {
        name: "expert".to_owned(),
        endpoint: "http://127.0.0.1:50051".to_owned(),
    };
    CampaignSpec {
        axes,
        tasks: vec![task],
        levels: vec![level],
        configs: vec![config],
        nominal: Nominal::Eval,
        ..CampaignSpec::v0_1("pairs", policy)
    }
}

fn row(rows: &[ManifestRow], condition: Condition) -> &ManifestRow {
    let mut rows = rows.iter();
    rows.find(|row| row.id.condition() == condition)
        .expect("a row of the condition")
}

proptest! {
    // A failing case prints its input; there is no folder to keep it in.
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn an_axis_is_realised_alike_alone_and_in_any_combination(
        axes in subsequence(Axis::METRIC.to_vec(), 2..=5),
        task in select(TaskRef::all().collect::<Vec<_>>()),
        level in select(Level::PERTURBED.to_vec()),
        config in 0..10_u16,
        step in 0..520_u32,
    ) {
        let rows = campaign(axes.clone(), task, level, config).expand().expect("rows");
        let combined = row(&rows, Condition::Combination);
        let nominal = row(&rows, Condition::Clean);
        prop_assert_eq!(combined.perturbation.axes(), axes.clone());
        prop_assert_eq!(combined.init_id, nominal.init_id);
        for axis in axes {
            let alone = row(&rows, Condition::Single(axis));
            prop_assert_eq!(alone.init_id, combined.init_id);
            prop_assert_eq!(alone.perturbation.values(axis), combined.perturbation.values(axis));
            let matched = |row: &ManifestRow| {
                let randomness = Randomness::of(&row.id, axis, Realisation::Matched);
                let Randomness::Matched(stream) = randomness else {
                    panic!("matched was asked for");
                };
                let mut noise = stream.at(step, 0);
                (stream.fixed().line_angle(), noise.standard_normal(), noise.standard_normal())
            };
            prop_assert_eq!(matched(alone), matched(combined));
        }
    }
}
