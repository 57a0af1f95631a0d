//! Tests of pairing: an axis is perturbed identically alone and in combination with other axes.

use benchmark::streams::Randomness;
use benchmark::{
    Axis, Condition, Design, Level, MAX_CONFIGS, ManifestRow, Nominal, Realisation, TaskRef,
};
use proptest::prelude::*;
use proptest::sample::{select, subsequence};

fn design(axes: Vec<Axis>, task: TaskRef, level: Level, config: u16) -> Design {
    Design {
        axes,
        tasks: vec![task],
        levels: vec![level],
        configs: vec![config],
        nominal: Nominal::Eval,
        seed: 7,
        ..Design::v0_1()
    }
}

fn level() -> impl Strategy<Value = Level> {
    let unnamed = (1..100_000_u32).prop_map(|millis| {
        let text = format!("r{}.{:03}", millis / 1_000, millis % 1_000);
        text.parse().expect("a level")
    });
    prop_oneof![select(Level::PERTURBED.to_vec()), unnamed]
}

fn row(rows: &[ManifestRow], condition: Condition) -> &ManifestRow {
    let mut rows = rows.iter();
    rows.find(|row| row.id.condition() == condition).expect("a row of the condition")
}

proptest! {
    // A failing case prints its input, so it is not stored in a file.
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn an_axis_has_the_same_perturbation_alone_and_in_any_combination(
        axes in subsequence(Axis::METRIC.to_vec(), 2..=5),
        task in select(TaskRef::all().collect::<Vec<_>>()),
        level in level(),
        config in 0..MAX_CONFIGS,
        step in 0..520_u32,
    ) {
        let rows = design(axes.clone(), task, level, config).expand().expect("rows");
        let combined = row(&rows, Condition::Simultaneous);
        let nominal = row(&rows, Condition::Nominal);
        prop_assert_eq!(combined.perturbation.axes(), axes.clone());
        prop_assert_eq!(combined.init_id, nominal.init_id);
        for axis in axes {
            let alone = row(&rows, Condition::Single(axis));
            prop_assert_eq!(alone.init_id, combined.init_id);
            prop_assert_eq!(alone.perturbation.values(axis), combined.perturbation.values(axis));
            let matched = |row: &ManifestRow| {
                let randomness = Randomness::of(&row.id, axis, Realisation::Matched);
                let Randomness::Matched(stream) = randomness else {
                    panic!("the realisation is matched");
                };
                let mut noise = stream.at(step, 0);
                (stream.fixed().line_angle(), noise.standard_normal(), noise.standard_normal())
            };
            prop_assert_eq!(matched(alone), matched(combined));
        }
    }
}
