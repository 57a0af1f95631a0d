//! The benchmark's 4,092 paraphrases without their sentences: task, type and the two similarities
//! of each. `data/para.py` generates the data from a checkout.

use std::collections::HashMap;
use std::fmt;
use std::str::FromStr;
use std::sync::OnceLock;

use crate::{Suite, TaskRef, UnknownName};

use super::kind::Kind;

const FIGURES: &str = include_str!("../../../data/para.txt");

/// A sentence for a task of `libero_goal`. Displays as the benchmark's name, such as
/// `act_pragmatical_hint_eval3_ver1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paraphrase {
    pub task: TaskRef,
    /// Index of the task, from 0, in the alphabetical order of the suite's task names: `eval` of
    /// the benchmark.
    pub eval: u8,
    pub kind: Kind,
    /// Number within task and type, 0 to 10, with gaps: `ver` of the benchmark.
    pub number: u8,
    /// Similarity of content words, about 0 to 1: `keyword_similarity` of the metadata.
    pub keywords: f64,
    /// Similarity of structure, 0 to 1: `structural_similarity` of the metadata.
    pub structure: f64,
}

// The similarities are numbers that the data file holds, never NaN.
impl Eq for Paraphrase {}

impl Paraphrase {
    /// Returns the path of the BDDL file below `libero/libero` of a checkout, and below the folder
    /// that `worker assets fetch` fills.
    pub fn bddl_file(&self) -> String {
        format!("bddl_files/libero_para/{self}.bddl")
    }

    pub(crate) fn label(&self) -> String {
        format!("{}_{}", self.kind.label(), self.number)
    }
}

impl fmt::Display for Paraphrase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}_eval{}_ver{}", self.kind, self.eval, self.number)
    }
}

/// Returns the SHA-256, in hex, of the lines that `sha256sum` prints for the benchmark's BDDL files
/// and metadata, in the order of their paths.
pub fn digest() -> &'static str {
    FIGURES.lines().next().unwrap_or_default()
}

pub fn inventory() -> &'static [Paraphrase] {
    static INVENTORY: OnceLock<Vec<Paraphrase>> = OnceLock::new();
    INVENTORY.get_or_init(|| {
        let mut tasks: Vec<TaskRef> = Suite::Goal.tasks().collect();
        tasks.sort_by_key(|task| task.name());
        let kinds: HashMap<[String; 3], Kind> = Kind::all()
            .map(|kind| ([kind.high().to_owned(), kind.mid(), kind.low()], kind))
            .collect();
        let mut paraphrases = Vec::new();
        for line in FIGURES.lines().skip(1) {
            let parsed = parse(line, &tasks, &kinds);
            paraphrases.extend(parsed.expect("the committed figures are well-formed"));
        }
        paraphrases.sort_by_key(|found: &Paraphrase| (found.eval, found.kind, found.number));
        paraphrases
    })
}

fn parse(
    line: &str,
    tasks: &[TaskRef],
    kinds: &HashMap<[String; 3], Kind>,
) -> Option<Vec<Paraphrase>> {
    let mut fields = line.split(' ');
    let eval: u8 = fields.next()?.parse().ok()?;
    let names = [fields.next()?, fields.next()?, fields.next()?];
    let kind = *kinds.get(&names.map(str::to_owned))?;
    let task = *tasks.get(usize::from(eval))?;
    let paraphrases = fields.map(|field| {
        let mut numbers = field.split(':');
        Some(Paraphrase {
            task,
            eval,
            kind,
            number: numbers.next()?.parse().ok()?,
            keywords: numbers.next()?.parse().ok()?,
            structure: numbers.next()?.parse().ok()?,
        })
    });
    paraphrases.collect()
}

/// Returns the paraphrase of a task by its name in rollout ids, such as `act_hint_1`; `None` if
/// there is none.
pub fn paraphrase(task: TaskRef, label: &str) -> Option<&'static Paraphrase> {
    static INDICES: OnceLock<HashMap<(TaskRef, String), usize>> = OnceLock::new();
    let indices = INDICES.get_or_init(|| {
        let keys = inventory().iter().map(|found| (found.task, found.label()));
        keys.zip(0..).collect()
    });
    let index = indices.get(&(task, label.to_owned()))?;
    inventory().get(*index)
}

/// Name of a set of paraphrases: `all`, an entry of the metadata's columns `high`, `mid` or `low`,
/// the three joined by `_`, or the name of one paraphrase.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TypeName(String);

impl TypeName {
    pub fn has(&self, paraphrase: &Paraphrase) -> bool {
        let kind = paraphrase.kind;
        self.0 == "all"
            || self.0 == kind.high()
            || self.0 == kind.mid()
            || self.0 == kind.low()
            || self.0 == kind.to_string()
            || self.0 == paraphrase.to_string()
    }
}

impl FromStr for TypeName {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let name = Self(text.to_owned());
        match inventory().iter().any(|paraphrase| name.has(paraphrase)) {
            true => Ok(name),
            false => Err(UnknownName {
                kind: "type of paraphrase",
                given: text.to_owned(),
                valid:
                    "all, obj, act, comp, and the other names in the columns high, mid and low of \
                        LIBERO-Para's metadata, such as structural, hint, lexical+pragmatical or \
                        act_pragmatical_hint, and names of sentences, such as \
                        act_pragmatical_hint_eval3_ver1"
                        .to_owned(),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};

    use super::*;

    #[test]
    fn every_task_and_type_has_the_number_of_sentences_of_the_benchmark() {
        let mut by_eval: BTreeMap<u8, usize> = BTreeMap::new();
        let mut by_high: BTreeMap<&str, usize> = BTreeMap::new();
        let mut names = BTreeSet::new();
        for found in inventory() {
            *by_eval.entry(found.eval).or_default() += 1;
            *by_high.entry(found.kind.high()).or_default() += 1;
            names.insert(found.to_string());
            assert_eq!(paraphrase(found.task, &found.label()), Some(found));
        }
        let counts: Vec<usize> = by_eval.into_values().collect();
        let expected = [416, 410, 406, 386, 403, 410, 411, 413, 423, 414];
        assert_eq!((counts, names.len()), (expected.to_vec(), 4092));
        let expected = [("act", 870), ("comp", 2963), ("obj", 259)];
        assert_eq!(by_high, BTreeMap::from(expected));
        assert_eq!(Kind::all().count(), 43);
        let stove = inventory().last().expect("paraphrases").task;
        assert_eq!(stove.name(), "turn_on_the_stove");
        assert_eq!(digest().len(), 64);
    }

    #[test]
    fn sentences_are_chosen_by_the_names_of_the_metadata() {
        for (name, expected) in [
            ("all", 4092),
            ("obj", 259),
            ("lexical", 259 + 100 + 79 + 74),
            ("structural", 98 + 75),
            ("hint", 88),
            ("lexical+structural", 100 + 100 + 100 + 99 + 97 + 94),
            ("same_polarity_habitual+hint", 98),
            ("act_pragmatical_hint", 88),
            ("act_pragmatical_hint_eval3_ver1", 1),
        ] {
            let name: TypeName = name.parse().expect("a type");
            let count = inventory().iter().filter(|found| name.has(found)).count();
            assert_eq!(count, expected, "{name:?}");
        }
        let error = "noise".parse::<TypeName>().unwrap_err().to_string();
        assert!(error.contains("obj, act, comp"), "{error}");
    }
}
