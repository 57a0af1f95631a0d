//! The benchmark's 10,030 variants in its own order, with their difficulties.
//! `data/plus.py` writes them from the released files.

use std::sync::OnceLock;

use libero_ctrl::{Suite, TaskRef};

use super::camera::View;
use super::problem::{Assets, ProblemClass};
use super::variant::{Change, Dimension, Variant};

const FIGURES: &str = include_str!("../../data/plus.txt");

/// A variant's place in the benchmark.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// The variant.
    pub variant: Variant,
    /// Place in its suite, from 1: `id` in `task_classification.json`.
    pub id: u16,
    /// 1 to 5; none: not given, as for 121 variants of the lights in `libero_goal`.
    pub difficulty: Option<u8>,
    /// The problem class of its BDDL file, if it is another than the task's.
    pub class: Option<ProblemClass>,
}

impl Entry {
    /// Files that it needs beside its BDDL file and states.
    pub fn assets(&self) -> Assets {
        match (self.variant.change, &self.class) {
            (Change::Added(_), _) => Assets::NewObjects,
            (_, Some(class)) => class.assets(),
            (_, None) => Assets::Libero,
        }
    }

    /// Dimension of robustness.
    pub fn dimension(&self) -> Dimension {
        self.variant.dimension()
    }
}

/// All variants, suite by suite, in the benchmark's order.
pub fn inventory() -> &'static [Entry] {
    static INVENTORY: OnceLock<Vec<Entry>> = OnceLock::new();
    INVENTORY.get_or_init(|| {
        let mut entries: Vec<Entry> = Vec::new();
        for line in FIGURES.lines() {
            let mut fields = line.split(' ');
            let run = [fields.next(), fields.next(), fields.next()];
            let entry = |field| read(run, field).expect("the committed figures are well-formed");
            for field in fields {
                let mut entry = entry(field);
                entry.id = match entries.last() {
                    Some(last) if suite(last) == suite(&entry) => last.id + 1,
                    _ => 1,
                };
                entries.push(entry);
            }
        }
        entries
    })
}

/// The benchmark's entry of a variant; none: its name is well-formed, and the benchmark
/// does not use it.
pub fn entry(variant: &Variant) -> Option<&'static Entry> {
    inventory().iter().find(|entry| entry.variant == *variant)
}

fn suite(entry: &Entry) -> Suite {
    entry.variant.task.suite()
}

fn read([suite, task, kind]: [Option<&str>; 3], field: &str) -> Option<Entry> {
    let task = TaskRef::new(suite?.parse().ok()?, task?.parse().ok()?).ok()?;
    let mut parts = field.split(':');
    let (name, difficulty, alias) = (parts.next()?, parts.next()?, parts.next());
    let small = |text: &str| text.parse::<u8>().ok();
    let change = match kind? {
        "camera" => {
            let numbers = name.split('_').map(|part| part.parse().ok());
            Change::Camera(View::from_numbers(&numbers.collect::<Option<Vec<u16>>>()?)?)
        }
        "robot" => Change::Robot(name.parse().ok()?),
        "noise" => Change::Noise(small(name)?),
        "language" => Change::Language(small(name)?),
        "light" => Change::Light(small(name)?),
        "table" => Change::Table(small(name)?),
        "tb" => Change::TableAndBackground(small(name)?),
        "add" => Change::Added(small(name)?),
        "level" => {
            let (level, sample) = name.split_once('_')?;
            Change::Level {
                level: small(level)?,
                sample: small(sample)?,
            }
        }
        _ => return None,
    };
    let class = alias.map(|alias| class_of(task, kind?, alias));
    Some(Entry {
        variant: Variant { task, change },
        id: 0,
        difficulty: small(difficulty),
        class: match class {
            Some(class) => Some(class?),
            None => None,
        },
    })
}

/// The class that an alias stands for in a task.
fn class_of(task: TaskRef, kind: &str, alias: &str) -> Option<ProblemClass> {
    let (parent, prefix) = match (task.suite(), task.name()) {
        (Suite::Object, _) => ("Libero_Floor_Manipulation", "floor"),
        (Suite::Long, name) if name.starts_with("KITCHEN") => {
            ("Libero_Kitchen_Tabletop_Manipulation", "kitchen")
        }
        (Suite::Long, name) if name.starts_with("STUDY") => {
            ("Libero_Study_Tabletop_Manipulation", "study")
        }
        (Suite::Long, _) => ("Libero_Living_Room_Tabletop_Manipulation", "liv"),
        _ => ("Libero_Tabletop_Manipulation", "tabletop"),
    };
    let name = match kind {
        "light" => format!("{parent}_{prefix}_light_sync_modified_{alias}"),
        _ => format!("{parent}_{alias}"),
    };
    ProblemClass::parse(&name).ok()
}
