//! Tests of the texts of the 1,200 paraphrases against a table of the words that each task's
//! sentences must contain. The table is independent of the rules in `data/paraphrases.json`.

use std::collections::BTreeSet;

use benchmark::{Level, TaskRef, paraphrase};
use sha2::{Digest, Sha256};

const MAX_CHARS: usize = 160;

/// SHA-256 over `TASK VARIANT_ID TEXT\n` of all sentences, so that no edit of the data is
/// overlooked: results before and after the edit would be pooled under one design. After a
/// deliberate change, print the sentences (`cargo test -p benchmark --test paraphrases --
/// --ignored --nocapture`), read the changed sentences, and write here the digest that the failing
/// test prints.
const DIGEST: &str = "9f0453463c67776c6cf0d85e7408cf93ce29aa134419c8b8a8ef7b2577e2a23b";

/// Words that a sentence must contain: one alternative of every row.
type Required = &'static [&'static [&'static str]];

const BOWL: &[&str] = &["black bowl"];
const ANY_BOWL: &[&str] = &["bowl"];
const ON: &[&str] = &[" on ", " onto ", " on top of ", " atop ", " upon "];
const ON_TOP: &[&str] = &["on top of", "atop", "the top of"];
const IN: &[&str] = &[" in ", " into ", " inside "];
const NEXT_TO: &[&str] = &["next to", "beside", "alongside", "adjacent to"];
const PLATE: &[&str] =
    &["on the plate", "onto the plate", "on the dinner plate", "on top of the plate"];
const RAMEKIN: &[&str] = &["ramekin"];
const COOKIES: &[&str] = &["cookie", "biscuit"];
const STOVE: &[&str] = &["stove", "cooktop", "hob", "cooker", "burner"];
const WOODEN: &[&str] = &["wooden ", "wood "];
const CABINET: &[&str] = &["cabinet", "cupboard", "chest of drawers", "dresser", "drawer unit"];
const BASKET: &[&str] = &["basket", "hamper"];
const TOP_DRAWER: &[&str] = &["top drawer", "topmost drawer", "uppermost drawer", "highest drawer"];
const MIDDLE_DRAWER: &[&str] = &["middle drawer", "center drawer", "central drawer"];
const BOTTOM_DRAWER: &[&str] =
    &["bottom drawer", "bottommost drawer", "lowest drawer", "lowermost drawer"];
const OPEN: &[&str] = &["open"];
const CLOSE: &[&str] = &["close", "closing", "shut"];
const TURN_ON: &[&str] = &["switch", "power", "turn", "start", "fire", "activat"];
const TOWARDS_FRONT: &[&str] = &["in front of", "to the front of", "to the front side of"];
const MOKA: &[&str] = &["moka", "coffee pot", "coffee maker", "espresso"];
const YELLOW_MUG: &[&str] =
    &["yellow and white mug", "yellow and white cup", "yellow and white coffee"];
const WHITE_MUG: &[&str] = &["the white mug", "the white cup", "the white coffee"];
const LEFT_PLATE: &[&str] =
    &["left plate", "left-hand plate", "left dinner plate", "left-hand dinner plate"];
const RIGHT_PLATE: &[&str] =
    &["right plate", "right-hand plate", "right dinner plate", "right-hand dinner plate"];
const RIGHT_OF: &[&str] = &["to the right of", "to the right-hand side of"];

fn required(task: &str) -> Required {
    match task {
        "libero_spatial/0" => &[BOWL, &["between the"], &["plate and the"], RAMEKIN, PLATE],
        "libero_spatial/1" => &[BOWL, NEXT_TO, RAMEKIN, PLATE],
        "libero_spatial/2" => &[BOWL, &["center"], &["table"], PLATE],
        "libero_spatial/3" => &[BOWL, ON, COOKIES, PLATE],
        "libero_spatial/4" => &[BOWL, IN, TOP_DRAWER, WOODEN, CABINET, PLATE],
        "libero_spatial/5" => &[BOWL, ON, RAMEKIN, PLATE],
        "libero_spatial/6" => &[BOWL, NEXT_TO, COOKIES, PLATE],
        "libero_spatial/7" => &[BOWL, ON, STOVE, PLATE],
        "libero_spatial/8" => &[BOWL, NEXT_TO, PLATE],
        "libero_spatial/9" => &[BOWL, ON, WOODEN, CABINET, PLATE],
        "libero_object/0" => &[&["alphabet soup"], IN, BASKET],
        "libero_object/1" => &[&["cream cheese"], IN, BASKET],
        "libero_object/2" => &[&["salad dressing"], IN, BASKET],
        "libero_object/3" => &[&["bbq sauce", "barbecue sauce"], IN, BASKET],
        "libero_object/4" => &[&["ketchup"], IN, BASKET],
        "libero_object/5" => &[&["tomato sauce"], IN, BASKET],
        "libero_object/6" => &[&["butter"], IN, BASKET],
        "libero_object/7" => &[&["milk"], IN, BASKET],
        "libero_object/8" => &[&["chocolate pudding"], IN, BASKET],
        "libero_object/9" => &[&["orange juice"], IN, BASKET],
        "libero_goal/0" => &[OPEN, MIDDLE_DRAWER, CABINET],
        "libero_goal/1" => &[ANY_BOWL, ON, STOVE],
        "libero_goal/2" => &[&["bottle"], ON_TOP, CABINET],
        "libero_goal/3" => &[OPEN, TOP_DRAWER, ANY_BOWL, &["inside", "into it", "in there"]],
        "libero_goal/4" => &[ANY_BOWL, ON_TOP, CABINET],
        "libero_goal/5" => &[&["plate"], TOWARDS_FRONT, STOVE],
        "libero_goal/6" => &[&["cream cheese"], IN, ANY_BOWL],
        "libero_goal/7" => &[TURN_ON, STOVE],
        "libero_goal/8" => &[ANY_BOWL, PLATE],
        "libero_goal/9" => &[&["bottle"], ON, &["rack", "holder", "stand"]],
        "libero_10/0" => &[&["both"], &["alphabet soup"], &["tomato sauce"], IN, BASKET],
        "libero_10/1" => &[&["both"], &["cream cheese"], &["butter"], IN, BASKET],
        "libero_10/2" => {
            &[TURN_ON, STOVE, MOKA, &["on it", "on top of it", "onto it", "on the stovetop"]]
        }
        "libero_10/3" => &[BOWL, IN, BOTTOM_DRAWER, CABINET, CLOSE],
        "libero_10/4" => &[WHITE_MUG, LEFT_PLATE, YELLOW_MUG, RIGHT_PLATE, ON],
        "libero_10/5" => &[&["book"], IN, &["back", "rear"], &["caddy", "organizer"]],
        "libero_10/6" => &[WHITE_MUG, PLATE, &["chocolate pudding"], RIGHT_OF],
        "libero_10/7" => &[&["both"], &["alphabet soup"], &["cream cheese"], IN, BASKET],
        "libero_10/8" => &[&["both"], MOKA, ON, STOVE],
        "libero_10/9" => &[YELLOW_MUG, IN, &["microwave"], CLOSE],
        other => panic!("add the words that the paraphrases of {other} must contain"),
    }
}

struct Sentence {
    task: TaskRef,
    level: Level,
    config: u16,
    variant_id: String,
    text: String,
}

fn sentences() -> impl Iterator<Item = Sentence> {
    TaskRef::all()
        .flat_map(|task| Level::PERTURBED.map(|level| (task, level)))
        .flat_map(|(task, level)| (0..10).map(move |config| (task, level, config)))
        .map(|(task, level, config)| {
            let paraphrase = paraphrase(task, level, config);
            Sentence {
                task,
                level,
                config,
                variant_id: paraphrase.variant_id,
                text: paraphrase.text,
            }
        })
}

#[test]
fn every_task_level_and_configuration_has_a_named_sentence() {
    let all: Vec<Sentence> = sentences().collect();
    assert_eq!(all.len(), 1_200);
    for Sentence { task, level, config, variant_id, .. } in all {
        assert_eq!(variant_id, format!("t{}/{level}/v{config:02}", task.index()));
    }
    let first = "libero_goal/0".parse().expect("a task");
    assert_eq!(paraphrase(first, Level::L1, 1).variant_id, "t0/L1/v01");
}

/// Covers all levels at once, so that no level repeats a sentence of another level.
#[test]
fn the_thirty_sentences_of_a_task_are_distinct() {
    for task in TaskRef::all() {
        let texts: BTreeSet<String> = sentences()
            .filter(|sentence| sentence.task == task)
            .map(|sentence| sentence.text)
            .collect();
        assert_eq!(texts.len(), 30, "{task}");
    }
}

#[test]
fn no_sentence_is_a_canonical_instruction() {
    let canonical: BTreeSet<String> = TaskRef::all().map(TaskRef::instruction).collect();
    for Sentence { task, text, .. } in sentences() {
        assert!(!canonical.contains(&text), "{task}: {text}");
    }
}

#[test]
fn every_sentence_names_the_objects_and_relations_of_its_task() {
    for Sentence { task, variant_id, text, .. } in sentences() {
        // Padding lets short words at the start or end match as whole words.
        let padded = format!(" {text} ");
        for alternatives in required(&task.to_string()) {
            let is_named = alternatives.iter().any(|words| padded.contains(words));
            assert!(is_named, "{task} {variant_id} `{text}`: none of {alternatives:?}");
        }
    }
}

#[test]
fn the_orthography_is_that_of_the_canonical_instructions() {
    for Sentence { task, variant_id, text, .. } in sentences() {
        let name = format!("{task} {variant_id} `{text}`");
        assert!(text.len() <= MAX_CHARS, "{name}: {} characters", text.len());
        let is_allowed = |c: char| c.is_ascii_lowercase() || " ,-".contains(c);
        assert!(text.chars().all(is_allowed), "{name}");
        let is_letter = |c: Option<char>| c.is_some_and(|c| c.is_ascii_lowercase());
        assert!(is_letter(text.chars().next()) && is_letter(text.chars().last()), "{name}");
        for mistake in ["  ", " ,", ",,", "the the ", "{", "}"] {
            assert!(!text.contains(mistake), "{name}");
        }
    }
}

#[test]
fn a_higher_level_has_more_words_on_average() {
    let words = |level| -> usize {
        let of_level = sentences().filter(|sentence| sentence.level == level);
        of_level.map(|sentence| sentence.text.split(' ').count()).sum()
    };
    let [l1, l2, l3] = Level::PERTURBED.map(words);
    assert!(l1 < l2 && l2 < l3, "{l1}, {l2}, {l3}");
}

#[test]
fn the_sentences_have_the_reviewed_digest() {
    let mut hash = Sha256::new();
    for Sentence { task, variant_id, text, .. } in sentences() {
        hash.update(format!("{task} {variant_id} {text}\n"));
    }
    let digest = hex::encode(hash.finalize());
    assert_eq!(digest, DIGEST, "the sentences are not those that were reviewed");
}

#[test]
fn the_documented_sentences_of_a_task_are_current() {
    let documented = include_str!("../../../docs/dev/PARAPHRASES.md");
    let task = "libero_10/2".parse().expect("a task");
    let current = task_text(task);
    let is_row = |line: &&str| line.starts_with("| ") && line.contains(" | L");
    let rows: Vec<&str> = documented.lines().filter(is_row).collect();
    let outdated: Vec<_> = rows.iter().filter(|row| !current.contains(*row)).collect();
    assert!(rows.len() >= 9 && outdated.is_empty(), "not among\n{current}{outdated:#?}");
}

fn task_text(task: TaskRef) -> String {
    let sentences = sentences().filter(|sentence| sentence.task == task);
    let mut lines: Vec<(u16, Level, String)> = sentences
        .map(|Sentence { level, config, text, .. }| {
            (config, level, format!("| {config} | {level} | {text} |\n"))
        })
        .collect();
    lines.sort();
    lines.into_iter().map(|(_, _, line)| line).collect()
}

#[test]
#[ignore = "prints the 1,200 sentences for a reviewer"]
fn print_all() {
    for Sentence { task, level, config, text, .. } in sentences() {
        println!("{task} {config} {level}: {text}");
    }
}
