//! Compares inventory, names, cameras, postures and prompts with LIBERO-Plus' own code, by digests
//! of `recorded/plus.py`.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::Suite;
use benchmark::family::plus::{
    Assets, CameraPose, Change, Dimension, Entry, Prompt, Variant, View, entry, inventory,
    start_posture,
};
use sha2::{Digest, Sha256};

const RECORDED: &str = include_str!("recorded/plus.txt");

fn check(kind: &str, lines: &[String]) {
    let recorded = RECORDED.lines().find(|line| line.starts_with(kind));
    let fields: Vec<&str> = recorded.unwrap().split(' ').collect();
    assert_eq!(lines.len().to_string(), fields[1], "{kind}");
    let mut hash = Sha256::new();
    for line in lines {
        hash.update(format!("{line}\n"));
    }
    let digest = hex::encode(hash.finalize());
    assert_eq!(digest, fields[2], "{kind}, for example {:?}", &lines[..2]);
}

fn all_lines(line: impl Fn(&Entry) -> String) -> Vec<String> {
    inventory().iter().map(line).collect()
}

#[test]
fn names_ids_dimensions_and_difficulties_equal_the_benchmarks() {
    let lines = all_lines(|entry| {
        let difficulty = match entry.difficulty {
            Some(difficulty) => difficulty.to_string(),
            None => "None".to_owned(),
        };
        let (variant, category) = (entry.variant, entry.dimension().category());
        let suite = variant.task.suite();
        format!("{suite} {} {variant} {category} {difficulty}", entry.id)
    });
    check("names", &lines);
}

#[test]
fn every_name_is_parsed_and_distinct() {
    let mut names = BTreeSet::new();
    for entry in inventory() {
        let name = entry.variant.to_string();
        assert_eq!(name.parse(), Ok(entry.variant), "{name}");
        assert!(names.insert(name));
    }
}

#[test]
fn state_files_equal_the_released_codes() {
    check("states", &all_lines(|entry| entry.variant.states_file()));
    let single = inventory().iter().filter(|entry| entry.variant.has_one_state());
    // Variants with added objects, and with moved objects.
    assert_eq!(single.count(), 829 + 696);
}

#[test]
fn bddl_files_equal_the_released_codes() {
    let lines = all_lines(|entry| {
        let variant = entry.variant;
        format!("{}/{}", variant.task.suite(), variant.bddl_stem())
    });
    check("bddl", &lines);
    let stems: BTreeSet<String> = lines.into_iter().collect();
    // LIBERO's 40, and one for each variant of language, light, background and layout.
    assert_eq!(stems.len(), 40 + 1537 + 1142 + 1076 + 1525);
}

#[test]
fn released_prompts_reveal_the_change() {
    let is_language = |entry: &&Entry| entry.dimension() == Dimension::Language;
    let reveals_change = |entry: &&Entry| {
        let released = Prompt::Released.of(&entry.variant, "the sentence");
        let stripped = Prompt::Stripped.of(&entry.variant, "the sentence");
        assert_eq!(Prompt::Bddl.of(&entry.variant, "the sentence"), "the sentence");
        released != stripped
    };
    // All variants except the 1,537 of language.
    assert_eq!(inventory().iter().filter(reveals_change).count(), 8493);
    let others = inventory().iter().filter(|entry| !is_language(entry));
    let others = others.map(|entry| Prompt::Released.of(&entry.variant, ""));
    check("released", &others.collect::<Vec<_>>());
    let all = inventory().iter();
    assert!(all.filter(is_language).all(|entry| {
        Prompt::ALL.map(|prompt| prompt.of(&entry.variant, "the sentence")) == ["the sentence"; 3]
    }));
    let variant: Variant =
        "put_the_bowl_on_the_plate_view_0_0_181_0_0_initstate_0".parse().unwrap();
    assert_eq!(
        Prompt::Released.of(&variant, ""),
        "put the bowl on the plate view 0 0 181 0 0 initstate 0"
    );
    let variant: Variant =
        "KITCHEN_SCENE3_turn_on_the_stove_and_put_the_moka_pot_on_it_light_12".parse().unwrap();
    assert_eq!(
        Prompt::Released.of(&variant, ""),
        "turn on the stove and put the moka pot on it light 12"
    );
}

#[test]
fn counts_equal_the_benchmarks_table() {
    let count = |suite: Suite, dimension: Dimension| {
        let all = inventory().iter();
        all.filter(|entry| entry.variant.task.suite() == suite && entry.dimension() == dimension)
            .count()
    };
    let table = Suite::ALL.map(|suite| Dimension::ALL.map(|dimension| count(suite, dimension)));
    assert_eq!(
        table,
        [
            [258, 350, 376, 390, 351, 385, 292],
            [248, 398, 396, 354, 422, 403, 297],
            [281, 409, 408, 410, 379, 425, 279],
            [289, 393, 419, 383, 449, 312, 274],
        ]
    );
    let levels = Dimension::ALL.map(|dimension| {
        [Some(1), Some(2), Some(3), Some(4), Some(5), None].map(|difficulty| {
            let all = inventory().iter();
            all.filter(|entry| entry.dimension() == dimension && entry.difficulty == difficulty)
                .count()
        })
    });
    assert_eq!(
        levels,
        [
            [233, 271, 263, 163, 146, 0],
            [248, 292, 374, 285, 351, 0],
            [199, 360, 325, 228, 487, 0],
            [328, 280, 259, 328, 342, 0],
            [177, 500, 300, 383, 241, 0],
            [348, 302, 329, 257, 289, 0],
            [111, 197, 244, 242, 227, 121],
        ]
    );
}

#[test]
fn the_needed_assets_of_each_variant_are_counted() {
    let mut counts = BTreeMap::new();
    for entry in inventory() {
        *counts.entry(entry.assets()).or_insert(0) += 1;
    }
    assert_eq!(
        counts.into_iter().collect::<Vec<_>>(),
        [
            (Assets::Libero, 7045),
            (Assets::NewObjects, 829),
            (Assets::Lights, 1142),
            (Assets::FloorTextures, 186),
            (Assets::Scenes, 828),
        ]
    );
    let by_suite = Suite::ALL.map(|suite| {
        let all = inventory().iter();
        all.filter(|entry| entry.variant.task.suite() == suite && entry.assets() == Assets::Libero)
            .count()
    });
    assert_eq!(by_suite, [1644, 1827, 1791, 1783]);
    let scenes = |assets| {
        let all = inventory().iter().filter(|entry| entry.assets() == assets);
        let scenes = all.filter_map(|entry| entry.class.as_ref()?.scene.clone());
        scenes.collect::<BTreeSet<_>>().len()
    };
    assert_eq!(scenes(Assets::Lights), 998);
    assert_eq!(scenes(Assets::Scenes), 508);
}

#[test]
fn postures_equal_those_of_the_five_hundred_robot_classes() {
    let lines = (1..=500).map(|number| {
        let posture = start_posture(number).unwrap();
        let angles = posture.map(|angle| format!("{:.8}", angle + 0.0));
        format!("{number} {}", angles.join(" "))
    });
    check("posture", &lines.collect::<Vec<_>>());
    assert_eq!((start_posture(0), start_posture(501)), (None, None));
}

#[test]
fn cameras_equal_the_released_codes() {
    // Orientations of LIBERO's `agentview`, w x y z: above tables, and lower in the scenes of the
    // living room and of the floor.
    const HIGH: [f64; 4] =
        [0.6380177736282349, 0.3048497438430786, 0.30484986305236816, 0.6380177736282349];
    const LOW: [f64; 4] =
        [0.6182166934013367, 0.3432307541370392, 0.3432314395904541, 0.6182177066802979];
    let pose = |pos, quat| CameraPose { pos, quat };
    let high = |x| pose([x, 0.0, 1.6103500240372423], HIGH);
    let bases = BTreeMap::from([
        ("libero_tabletop_manipulation", high(0.6586131746834771)),
        ("libero_kitchen_tabletop_manipulation", high(0.6586131746834771)),
        ("libero_study_tabletop_manipulation", high(0.4586131746834771)),
        ("libero_living_room_tabletop_manipulation", pose([0.6065773716836134, 0.0, 0.96], LOW)),
        ("libero_floor_manipulation", pose([0.8965773716836134, 5.216182733499864e-7, 0.65], LOW)),
    ]);
    let class = |entry: &Entry| match (entry.variant.task.suite(), entry.variant.task.name()) {
        (Suite::Spatial | Suite::Goal, _) => "libero_tabletop_manipulation",
        (Suite::Object, _) => "libero_floor_manipulation",
        (_, name) if name.starts_with("KITCHEN") => "libero_kitchen_tabletop_manipulation",
        (_, name) if name.starts_with("STUDY") => "libero_study_tabletop_manipulation",
        _ => "libero_living_room_tabletop_manipulation",
    };
    let used: BTreeSet<(&str, String, View)> = inventory()
        .iter()
        .map(|entry| (class(entry), entry.variant.view().to_string(), entry.variant.view()))
        .collect();
    let lines = used.into_iter().map(|(class, text, view)| {
        let CameraPose { pos, quat } = view.apply(bases[class]);
        let numbers = pos.iter().chain(&quat).map(|number| format!("{:.4}", number + 0.0));
        format!("{class} {text} {}", numbers.collect::<Vec<_>>().join(" "))
    });
    check("camera", &lines.collect::<Vec<_>>());
    let nominal = View::NOMINAL.apply(bases["libero_tabletop_manipulation"]);
    assert_eq!(nominal, pose([0.6586, 0.0, 1.6104], [0.638, 0.3048, 0.3048, 0.638]));
}

#[test]
fn unknown_names_are_refused_with_the_valid_forms() {
    let refusal = |name: &str| name.parse::<Variant>().unwrap_err().to_string();
    let task = "put_the_bowl_on_the_plate";
    assert!(refusal("put_the_bowl_on_the_moon_light_1").contains("none of LIBERO's forty tasks"));
    for suffix in [
        "",
        "_",
        "_light_0",
        "_light_01",
        "_light_300",
        "_level1_sample1",
        "_moved_level6_sample1",
        "_view_0_0_100_0_0_initstate_501",
        "_view_0_0_100_0_0_initstate_0_noise_51",
        "_view_0_0_181_0_0_initstate_7",
        "_view_0_0_181_0_0_initstate_0_noise_7",
        "_view_0_0_100_0_initstate_7",
        "_language_51_view_0_0_100_0_0_initstate_0",
        "_language_5_view_0_0_110_0_0_initstate_0",
        "_noise_3",
    ] {
        let message = refusal(&format!("{task}{suffix}"));
        assert!(message.contains("_tb_T") || suffix.is_empty(), "{message}");
    }
    let unused: Variant = format!("{task}_table_19").parse().unwrap();
    assert_eq!(unused.change, Change::Table(19));
    assert!(entry(&unused).is_none());
    assert_eq!("noise".parse(), Ok(Dimension::Noise));
    assert!("wind".parse::<Dimension>().unwrap_err().to_string().contains("background"));
}
