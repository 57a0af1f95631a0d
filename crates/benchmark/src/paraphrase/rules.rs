//! Serialised form of `data/paraphrases.json`: words, structures, frames and tasks.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use serde::Deserialize;
use serde::de::IgnoredAny;

use crate::presets::PRESETS;
use crate::suite::TaskRef;

/// Variants per task and level: one for each configuration.
pub(super) const VARIANTS: usize = PRESETS as usize;

/// Returns the embedded file, parsed once. Tests ensure that it parses and that all names
/// in it are defined.
pub(super) fn rules() -> &'static Rules {
    static RULES: LazyLock<Rules> = LazyLock::new(|| {
        serde_json::from_str(include_str!("../../data/paraphrases.json"))
            .expect("the embedded paraphrases are valid")
    });
    &RULES
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Rules {
    #[serde(rename = "about")]
    _about: IgnoredAny,
    pub(super) frames: [Frame; VARIANTS],
    pub(super) numbers: BTreeMap<Number, BTreeMap<String, String>>,
    pub(super) constructions: BTreeMap<String, Construction>,
    pub(super) verbs: BTreeMap<String, Entries>,
    pub(super) words: BTreeMap<String, Entries>,
    pub(super) tasks: BTreeMap<TaskRef, Task>,
}

/// Frame of a sentence at L3: words that stand before the body of a structure, and after its lead
/// if the structure has one. `Construction::structures` holds leads and bodies.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Frame {
    pub(super) before: String,
    pub(super) form: Form,
}

#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Number {
    #[default]
    Singular,
    Plural,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Construction {
    /// Default values of slots that a task does not fill.
    #[serde(default)]
    pub(super) defaults: BTreeMap<String, String>,
    pub(super) plain: String,
    /// Structures of L2 and L3 by variant: a body, or a lead, `|` and a body.
    pub(super) structures: [String; VARIANTS],
}

/// Entries of a list, by variant.
#[derive(Deserialize)]
#[serde(untagged)]
pub(super) enum Entries {
    Same(String),
    ByVariant(Box<[String; VARIANTS]>),
}

impl Entries {
    pub(super) fn entry(&self, variant: usize) -> &str {
        match self {
            Self::Same(entry) => entry,
            Self::ByVariant(entries) => &entries[variant],
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Task {
    pub(super) construction: String,
    #[serde(default)]
    pub(super) number: Number,
    /// Name of the list of verbs for `<put>`, which depends on the destination.
    pub(super) put: Option<String>,
    pub(super) slots: BTreeMap<String, String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub(super) enum Form {
    /// "grab"
    #[serde(rename = "base")]
    Base,
    /// "grabbing"
    #[serde(rename = "ing")]
    Gerund,
    /// "grabbed"
    #[serde(rename = "ed")]
    Participle,
}
