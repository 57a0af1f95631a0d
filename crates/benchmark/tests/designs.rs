//! Tests of custom designs: other radii, more configurations, fewer axes.

use std::collections::BTreeSet;

use benchmark::presets::{PRESETS, apply_preset, round6, unit};
use benchmark::{
    Axis, CampaignSpec, Condition, Design, Level, MAX_CONFIGS, ManifestRow, Nominal, Perturbation,
    PolicyRoute, Realisation, Record, RolloutId, Rollouts, TaskRef, Wanted, manifest,
};
use proptest::prelude::*;
use proptest::sample::{select, subsequence};

/// Components that are at least 0 in drawn directions: the camera's distance, the hand's height,
/// lag and noise of the actions.
const HALF_SPACES: [(Axis, usize); 4] =
    [(Axis::Camera, 2), (Axis::Robot, 2), (Axis::Actuation, 3), (Axis::Actuation, 4)];

fn level_of_micros(micros: u32) -> String {
    let text = format!("r{}.{:06}", micros / 1_000_000, micros % 1_000_000);
    let text = text.trim_end_matches('0').trim_end_matches('.');
    text.to_owned()
}

fn any_level() -> impl Strategy<Value = Level> {
    let unnamed = (1_000..=100_000_000_u32)
        .prop_map(|micros| level_of_micros(micros).parse().expect("a level"));
    prop_oneof![select(Level::PERTURBED.to_vec()), unnamed]
}

prop_compose! {
    fn any_design()(
        tasks in subsequence(TaskRef::all().collect::<Vec<_>>(), 1..=3),
        axes in subsequence(Axis::METRIC.to_vec(), 1..=5),
        levels in prop::collection::btree_set(any_level(), 1..=3),
        configs in prop::collection::btree_set(0..MAX_CONFIGS, 1..=4),
        nominal in select(vec![Nominal::All, Nominal::Eval, Nominal::None]),
        seed in any::<u64>(),
    ) -> Design {
        let (levels, configs) = (levels.into_iter().collect(), configs.into_iter().collect());
        Design { tasks, axes, levels, configs, nominal, seed, ..Design::v0_1() }
    }
}

fn single(axis: Axis, level: Level, config: u16, seed: u64) -> ManifestRow {
    let design = Design {
        tasks: vec!["libero_goal/3".parse().expect("a task")],
        axes: vec![axis],
        levels: vec![level],
        configs: vec![config],
        nominal: Nominal::None,
        seed,
        ..Design::v0_1()
    };
    design.expand().expect("rows").remove(0)
}

fn normalised(axis: Axis, row: &ManifestRow) -> Vec<f64> {
    let values = row.perturbation.values(axis);
    let normalised = values.iter().zip(unit(axis)).map(|(x, unit)| x / unit);
    normalised.collect()
}

proptest! {
    // A failing case prints its input, so it is not stored in a file.
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn the_level_of_any_radius_is_parsed_from_its_text_and_from_a_rollout_id(
        micros in 1_000..=100_000_000_u32,
        config in any::<u16>(),
    ) {
        let text = level_of_micros(micros);
        let level: Level = text.parse().expect("a level");
        prop_assert_eq!(level.radius(), text[1..].parse::<f64>().expect("a number"));
        if !level.is_named() {
            prop_assert_eq!(level.to_string(), text);
        }
        let task = "long/5".parse().expect("a task");
        let id = RolloutId::perturbed(task, Condition::Simultaneous, level, config);
        let id = id.expect("an id");
        prop_assert_eq!(id.to_string().parse(), Ok(id));
    }

    #[test]
    fn parameters_have_the_radius_of_the_level_and_one_direction_at_all_levels(
        axis in select(Axis::METRIC.to_vec()),
        level in any_level(),
        config in 0..MAX_CONFIGS,
        seed in any::<u64>(),
    ) {
        let row = single(axis, level, config, seed);
        let (given, radius) = (normalised(axis, &row), level.radius());
        // The published directions have four or five decimals, a parameter has six.
        let rounding = unit(axis).iter().map(|unit| 0.5e-6 / unit).sum::<f64>();
        let length = given.iter().map(|x| x * x).sum::<f64>().sqrt();
        prop_assert!((length - radius).abs() < 2e-4 * radius + rounding, "{length}");

        let far = normalised(axis, &single(axis, Level::L3, config, seed));
        for (near, far) in given.iter().zip(far) {
            let scaled = far * radius / 8.0;
            let tolerance = rounding * (1.0 + radius / 8.0);
            prop_assert!((near - scaled).abs() <= tolerance, "{near} is not {scaled}");
        }
        for value in row.perturbation.values(axis) {
            prop_assert_eq!(value, round6(value));
        }
    }

    #[test]
    fn configurations_beyond_the_presets_respect_the_half_spaces(
        (axis, component) in select(HALF_SPACES.to_vec()),
        config in PRESETS..MAX_CONFIGS,
        seed in any::<u64>(),
    ) {
        let row = single(axis, Level::L3, config, seed);
        prop_assert!(row.perturbation.values(axis)[component] >= 0.0);
    }

    #[test]
    fn the_ten_presets_are_the_protocols_in_every_design(
        axis in select(Axis::METRIC.to_vec()),
        level in select(Level::PERTURBED.to_vec()),
        config in 0..PRESETS,
        seed in any::<u64>(),
    ) {
        let mut preset = Perturbation::default();
        apply_preset(&mut preset, axis, level, config);
        prop_assert_eq!(single(axis, level, config, seed).perturbation, preset);
    }

    #[test]
    fn the_manifest_of_any_design_is_parsed_and_expanded_in_the_same_order(design in any_design()) {
        let rows = design.expand().expect("rows");
        let read = manifest::parse(&manifest::to_text(&rows)).expect("reads back");
        prop_assert_eq!(&read, &rows);

        let mut shuffled = rows.clone();
        shuffled.sort_by_key(|row| std::cmp::Reverse(row.id));
        let imported = campaign(Rollouts::Rows(shuffled)).expand().expect("rows");
        prop_assert_eq!(imported, rows);
    }

    #[test]
    fn custom_designs_have_the_same_version_only_if_they_have_the_same_rows(
        first in any_design(),
        second in any_design(),
    ) {
        prop_assert!(first.version().as_str().starts_with("custom-"));
        let have_same_rows = first.expand() == second.expand();
        prop_assert_eq!(first.version() == second.version(), have_same_rows);
        let text = serde_json::to_string(&campaign(Rollouts::Design(first.clone())));
        let read = CampaignSpec::from_json(&text.expect("JSON")).expect("reads back");
        prop_assert_eq!(read.version(), first.version());
    }
}

#[test]
fn drawn_directions_are_uniform_on_the_sphere() {
    for axis in Axis::METRIC {
        let configs = PRESETS..MAX_CONFIGS;
        let directions: Vec<Vec<f64>> =
            configs.map(|config| normalised(axis, &single(axis, Level::L3, config, 0))).collect();
        let is_half_space = |component| HALF_SPACES.contains(&(axis, component));
        for component in 0..unit(axis).len() {
            let values = directions.iter().map(|direction| direction[component] / 8.0);
            let mean = values.clone().sum::<f64>() / directions.len() as f64;
            let square = values.map(|x| x * x).sum::<f64>() / directions.len() as f64;
            let dimension = unit(axis).len() as f64;
            // Five standard errors of the mean of 990 values, each of variance 1 / dimension.
            let tolerance = 5.0 / (dimension * directions.len() as f64).sqrt();
            assert!(mean.abs() < tolerance || is_half_space(component), "{axis}: {mean}");
            // The standard error of the scaled mean square is below 0.04.
            assert!((square * dimension - 1.0).abs() < 0.2, "{axis}: {square}");
        }
    }
}

#[test]
fn the_first_fifty_configurations_cover_all_initial_states() {
    let design = Design {
        tasks: vec!["libero_goal/3".parse().expect("a task")],
        axes: vec![Axis::Camera],
        levels: vec![Level::L1],
        configs: (0..60).collect(),
        ..Design::v0_1()
    };
    let rows = design.expand().expect("rows");
    let perturbed: Vec<&ManifestRow> =
        rows.iter().filter(|row| row.id.config().is_some()).collect();
    let states: BTreeSet<u16> = perturbed[..50].iter().map(|row| row.init_id).collect();
    assert_eq!((perturbed.len(), states.len()), (60, 50));
    assert_eq!(perturbed[57].init_id, perturbed[7].init_id);
    assert_ne!(perturbed[57].perturbation, perturbed[7].perturbation);
}

#[test]
fn configurations_beyond_the_ten_paraphrases_repeat_them() {
    let design = Design {
        tasks: vec!["libero_goal/3".parse().expect("a task")],
        axes: vec![Axis::Camera, Axis::Language],
        levels: vec![Level::L2],
        configs: vec![4, 14],
        nominal: Nominal::None,
        ..Design::v0_1()
    };
    let rows = design.expand().expect("rows");
    assert_eq!(rows[4].instruction, rows[1].instruction);
    assert_eq!(rows[4].variant_id.as_deref(), Some("t3/L2/v04"));
    assert_eq!(rows[5].instruction, rows[4].instruction);
}

fn campaign(rollouts: Rollouts) -> CampaignSpec {
    CampaignSpec {
        execution: Default::default(),
        name: "beyond".to_owned(),
        policy: PolicyRoute {
            name: "expert".to_owned(),
            endpoint: "http://127.0.0.1:50051".to_owned(),
        },
        rollouts,
        purpose: None,
        realisation: Realisation::Matched,
        replicates: 1,
        record: Record::None,
        wanted: Wanted::default(),
        stop: None,
    }
}
