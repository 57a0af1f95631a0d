//! The sentence that a policy is told. LIBERO-Plus makes it of the file's name, and so
//! tells the policy what was changed; harnesses that mend this do so in different ways.

use std::fmt;
use std::str::FromStr;

use libero_ctrl::TaskRef;

use super::variant::{Change, Variant};

/// Source of the prompt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Prompt {
    /// As the released code: the file's name, what was changed included, except where the
    /// sentence itself is what was changed.
    Released,
    /// The same without what was changed: the prompts that policies of LIBERO know.
    Stripped,
    /// The BDDL file's sentence.
    Bddl,
}

impl Prompt {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Released, Self::Stripped, Self::Bddl];

    /// Name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Released => "released",
            Self::Stripped => "stripped",
            Self::Bddl => "bddl",
        }
    }

    /// A variant's prompt; `sentence` is what its BDDL file says, in lower case.
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

    /// A nominal task's prompt; `sentence` as above.
    pub fn of_task(self, task: TaskRef, sentence: &str) -> String {
        match self {
            Self::Bddl => sentence.to_owned(),
            _ => task.instruction(),
        }
    }
}

impl fmt::Display for Prompt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Prompt {
    type Err = UnknownPrompt;

    fn from_str(text: &str) -> Result<Self, UnknownPrompt> {
        Self::ALL
            .into_iter()
            .find(|prompt| prompt.name() == text)
            .ok_or_else(|| UnknownPrompt(text.to_owned()))
    }
}

/// No source of a prompt is called so.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("read prompt `{0}`: valid are released, stripped, bddl")]
pub struct UnknownPrompt(String);
