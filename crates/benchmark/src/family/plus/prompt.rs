//! Prompt of the policy. LIBERO-Plus derives the prompt from the name of the variant's BDDL file,
//! which reveals the change to the policy; harnesses correct this in different ways.

use std::fmt;
use std::str::FromStr;

use crate::UnknownName;

use super::variant::{Change, Variant};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Prompt {
    /// As in the released code: the file's name including the description of the change, or
    /// the BDDL file's sentence for language variants and LIBERO-Para, or LIBERO's prompt of the
    /// unperturbed task for LIBERO-PRO.
    Released,
    /// The file's name without the description of the change: LIBERO's prompt of the task.
    Stripped,
    Bddl,
}

impl Prompt {
    pub const ALL: [Self; 3] = [Self::Released, Self::Stripped, Self::Bddl];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Released => "released",
            Self::Stripped => "stripped",
            Self::Bddl => "bddl",
        }
    }

    /// Returns a variant's prompt, which is always `sentence` for a language variant. `sentence` is
    /// that of the variant's BDDL file, in lower case.
    pub fn of(self, variant: &Variant, sentence: &str) -> String {
        if self == Self::Bddl || matches!(variant.change, Change::Language(_)) {
            return sentence.to_owned();
        }
        let instruction = variant.task.instruction();
        match self {
            Self::Stripped => instruction,
            _ => {
                let name = variant.to_string();
                let suffix = &name[variant.task.name().len()..];
                format!("{instruction}{}", suffix.replace('_', " "))
            }
        }
    }
}

impl fmt::Display for Prompt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Prompt {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        Self::ALL.into_iter().find(|prompt| prompt.name() == text).ok_or_else(|| UnknownName {
            kind: "prompt",
            given: text.to_owned(),
            valid: Self::ALL.map(Self::name).join(", "),
        })
    }
}
