//! The benchmark's 10,030 variants in the benchmark's order, with their difficulties.
//! `data/plus.py` generates the data from the released files.

use std::collections::HashMap;
use std::sync::OnceLock;

use crate::{Suite, TaskRef};

use super::camera::View;
use super::problem::{Assets, ProblemClass, ProblemError, Style};
use super::variant::{Change, Dimension, Variant};

const FIGURES: &str = include_str!("../../../data/plus.txt");

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    pub variant: Variant,
    /// Position in the suite, from 1: `id` in `task_classification.json`.
    pub id: u16,
    /// Difficulty, 1 to 5; `None` if not given, as for 121 light variants in `libero_goal`.
    pub difficulty: Option<u8>,
    /// Problem class of the BDDL file, if it differs from the task's.
    pub class: Option<ProblemClass>,
}

impl Entry {
    /// Returns the files that the variant needs in addition to its BDDL file and states.
    pub fn assets(&self) -> Assets {
        match (self.variant.change, &self.class) {
            (Change::Added(_), _) => Assets::NewObjects,
            (_, Some(class)) => class.assets(),
            (_, None) => Assets::Libero,
        }
    }

    /// Returns true if the floor and wall textures that the variant uses in place of its parent's
    /// are LIBERO's own.
    pub fn uses_liberos_styles(&self) -> bool {
        let styles = self.class.iter().flat_map(|class| [&class.floor, &class.wall]);
        styles.flatten().all(|style| style.is_liberos)
    }

    /// Returns true if the variant's scene can be composed of LIBERO's assets and the files that
    /// `is_present` finds, given their paths relative to the assets' folder. Always false for
    /// variants with added objects.
    pub fn is_composable(&self, is_present: impl Fn(&str) -> bool) -> bool {
        match (self.assets(), &self.class) {
            (Assets::Libero, _) => true,
            (Assets::NewObjects, _) | (_, None) => false,
            (_, Some(class)) => {
                let mut styles = [&class.floor, &class.wall].into_iter().flatten();
                class.scene.as_deref().is_none_or(&is_present)
                    && styles.all(|style| {
                        style.is_liberos || is_present(&format!("textures/{}", style.file))
                    })
            }
        }
    }

    pub fn dimension(&self) -> Dimension {
        self.variant.dimension()
    }
}

pub fn inventory() -> &'static [Entry] {
    static INVENTORY: OnceLock<Vec<Entry>> = OnceLock::new();
    INVENTORY.get_or_init(|| {
        let mut entries: Vec<Entry> = Vec::new();
        for line in FIGURES.lines() {
            let mut fields = line.split(' ');
            let run = [fields.next(), fields.next(), fields.next()];
            let entry =
                |field| parse_entry(run, field).expect("the committed figures are well-formed");
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

pub fn entry(variant: &Variant) -> Option<&'static Entry> {
    static INDICES: OnceLock<HashMap<Variant, usize>> = OnceLock::new();
    let indices = INDICES.get_or_init(|| {
        let variants = inventory().iter().map(|entry| entry.variant);
        variants.zip(0..).collect()
    });
    indices.get(variant).map(|index| &inventory()[*index])
}

/// Parsers of BDDL turn the name to lower case; the returned class has the spelling of the
/// benchmark's variants, which names files.
pub fn problem_class(name: &str) -> Result<ProblemClass, ProblemError> {
    static CLASSES: OnceLock<HashMap<FileNames, &'static ProblemClass>> = OnceLock::new();
    let classes = CLASSES.get_or_init(|| {
        let classes = inventory().iter().filter_map(|entry| entry.class.as_ref());
        classes.map(|class| (file_names(class), class)).collect()
    });
    let class = ProblemClass::parse(name)?;
    let spelled = classes.get(&file_names(&class));
    Ok(spelled.map_or(class, |spelled| (*spelled).clone()))
}

/// LIBERO's class, and the names of scene, floor and wall, in lower case.
type FileNames = (&'static str, [Option<String>; 3]);

fn file_names(class: &ProblemClass) -> FileNames {
    let file = |style: &Option<Style>| Some(style.as_ref()?.file.to_lowercase());
    let scene = class.scene.as_ref().map(|scene| scene.to_lowercase());
    (class.parent, [scene, file(&class.floor), file(&class.wall)])
}

fn suite(entry: &Entry) -> Suite {
    entry.variant.task.suite()
}

/// Parses a field of a line of the data; the ids are assigned by [`inventory`].
fn parse_entry([suite, task, kind]: [Option<&str>; 3], field: &str) -> Option<Entry> {
    let task = TaskRef::new(suite?.parse().ok()?, task?.parse().ok()?).ok()?;
    let mut parts = field.split(':');
    let (name, difficulty, alias) = (parts.next()?, parts.next()?, parts.next());
    let number = |text: &str| text.parse::<u8>().ok();
    let change = match kind? {
        "camera" => {
            let numbers = name.split('_').map(|part| part.parse().ok());
            Change::Camera(View::from_numbers(&numbers.collect::<Option<Vec<u16>>>()?)?)
        }
        "robot" => Change::Robot(name.parse().ok()?),
        "noise" => Change::Noise(number(name)?),
        "language" => Change::Language(number(name)?),
        "light" => Change::Light(number(name)?),
        "table" => Change::Table(number(name)?),
        "tb" => Change::TableAndBackground(number(name)?),
        "add" => Change::Added(number(name)?),
        "level" => {
            let (level, sample) = name.split_once('_')?;
            Change::Level { level: number(level)?, sample: number(sample)? }
        }
        _ => return None,
    };
    let class = alias.map(|alias| class_of(task, kind?, alias));
    Some(Entry {
        variant: Variant { task, change },
        id: 0,
        difficulty: number(difficulty),
        class: match class {
            Some(class) => Some(class?),
            None => None,
        },
    })
}

/// Returns the problem class that `data/plus.txt` abbreviates by an alias.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_lower_case_have_the_files_of_the_benchmark() {
        let floor = "libero_floor_manipulation_floorcarbonfiber001_col_6k";
        let class = problem_class(floor).expect("a class");
        let file = class.floor.map(|style| style.file);
        assert_eq!(file.as_deref(), Some("CarbonFiber001_COL_6K.png"));
        let mut scenes = 0;
        for entry in inventory() {
            let Some(class) = &entry.class else { continue };
            if let Some(scene) = class.scene.as_deref().filter(|_| class.wall.is_none()) {
                let stem = scene.rsplit('/').next().and_then(|file| file.strip_suffix(".xml"));
                let name = format!("{}_{}", class.parent, stem.expect("a scene"));
                let found = problem_class(&name.to_lowercase()).expect("a class");
                assert_eq!(found.scene.as_deref(), Some(scene));
                scenes += 1;
            }
        }
        assert!(scenes > 1000, "{scenes}");
    }

    #[test]
    fn a_scene_with_a_wall_of_the_archive_needs_its_texture() {
        let has_scenes = |file: &str| file.starts_with("scenes/");
        let all = inventory().iter().filter(|entry| entry.assets() == Assets::Scenes);
        let (composable, lacking): (Vec<&Entry>, Vec<&Entry>) =
            all.partition(|entry| entry.is_composable(has_scenes));
        // The wall `cream` is the only one that is not LIBERO's.
        assert_eq!((composable.len(), lacking.len()), (812, 16));
        let has_wall = |file: &str| has_scenes(file) || file == "textures/cream_plaster.png";
        assert!(lacking.iter().all(|entry| entry.is_composable(has_wall)));
    }
}
