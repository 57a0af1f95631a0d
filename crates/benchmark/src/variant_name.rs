//! Name of a variant within its task, as written in rollout ids of LIBERO's family:
//! `plus:noise_30`, `pro:swap`, `para:act_hint_1`, `plus:unperturbed`; or `own:NAME` for a task of
//! suite `NAME` of a suite file. Only the form is checked here: `family` defines the
//! variants of each benchmark.

use std::fmt;
use std::str::FromStr;

use crate::benchmark::Benchmark;
use crate::names::UnknownName;

/// Length limit of the name of a change, bytes.
pub(crate) const MAX_CHANGE_BYTES: usize = 31;
/// Text in place of a benchmark's tag in the ids of a suite file's rollouts.
const OWN: &str = "own";

/// Benchmark and change of a variant. Stored inline, so that rollout ids remain `Copy`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VariantName {
    /// The benchmark; `None` for a suite of a suite file.
    benchmark: Option<Benchmark>,
    /// ASCII text, padded with zeros.
    change: [u8; MAX_CHANGE_BYTES],
}

impl VariantName {
    /// Change of the unperturbed rollout of a task, which is run beside its variants.
    pub const UNPERTURBED: &'static str = "unperturbed";

    pub fn new(benchmark: Benchmark, change: &str) -> Result<Self, UnknownName> {
        Self::checked(Some(benchmark), change)
    }

    pub fn own(suite: &str) -> Result<Self, UnknownName> {
        match suite {
            Self::UNPERTURBED => Err(unknown(suite)),
            suite => Self::checked(None, suite),
        }
    }

    fn checked(benchmark: Option<Benchmark>, change: &str) -> Result<Self, UnknownName> {
        let is_valid = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_');
        let has_valid_length = (1..=MAX_CHANGE_BYTES).contains(&change.len());
        if !has_valid_length || !change.bytes().all(is_valid) {
            return Err(unknown(change));
        }
        let mut bytes = [0; MAX_CHANGE_BYTES];
        bytes[..change.len()].copy_from_slice(change.as_bytes());
        Ok(Self { benchmark, change: bytes })
    }

    pub const fn benchmark(&self) -> Option<Benchmark> {
        self.benchmark
    }

    /// Returns the change: `noise_30`, `swap` or [`Self::UNPERTURBED`]; or the name of a suite of a
    /// suite file.
    pub fn change(&self) -> &str {
        let end = self.change.iter().position(|byte| *byte == 0);
        let bytes = &self.change[..end.unwrap_or(MAX_CHANGE_BYTES)];
        str::from_utf8(bytes).expect("only ASCII is stored")
    }

    pub fn is_unperturbed(&self) -> bool {
        self.change() == Self::UNPERTURBED
    }
}

impl fmt::Display for VariantName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tag = self.benchmark.map_or(OWN, Benchmark::tag);
        write!(f, "{tag}:{}", self.change())
    }
}

impl fmt::Debug for VariantName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl FromStr for VariantName {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let (tag, change) = text.split_once(':').ok_or_else(|| unknown(text))?;
        let name = match Benchmark::from_tag(tag) {
            Some(benchmark) => Self::new(benchmark, change),
            None if tag == OWN => Self::own(change),
            None => return Err(unknown(text)),
        };
        name.map_err(|_| unknown(text))
    }
}

fn unknown(given: &str) -> UnknownName {
    let valid = "plus:, pro:, para: or own: and a change in at most 31 lower-case letters, digits \
                 and _, such as plus:noise_30, pro:swap, para:act_hint_1, plus:unperturbed or \
                 own:libero_90";
    UnknownName::new("variant of a rollout id", given, &[valid])
}
