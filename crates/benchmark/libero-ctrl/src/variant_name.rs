//! Name of a variant within its task, as written in rollout ids of LIBERO's family:
//! `plus:noise_30`, `pro:swap`, `plus:unperturbed`. Only the form is checked here: `libero-family`
//! defines the variants of each benchmark.

use std::fmt;
use std::str::FromStr;

use crate::benchmark::Benchmark;
use crate::names::UnknownName;

/// Longest change, bytes.
const MAX_CHANGE_BYTES: usize = 31;

/// Benchmark and change of a variant. Stored inline, so that rollout ids remain `Copy`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VariantName {
    benchmark: Benchmark,
    /// ASCII text, padded with zeros.
    change: [u8; MAX_CHANGE_BYTES],
}

impl VariantName {
    /// Change of the unperturbed rollout of a task, which is run beside its variants.
    pub const UNPERTURBED: &'static str = "unperturbed";

    /// Creates a name from a change such as `noise_30`.
    ///
    /// # Errors
    /// If the change is empty, longer than 31 bytes, or has other characters than lower-case
    /// letters, digits and `_`.
    pub fn new(benchmark: Benchmark, change: &str) -> Result<Self, UnknownName> {
        let is_valid = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_');
        let has_valid_length = (1..=MAX_CHANGE_BYTES).contains(&change.len());
        if !has_valid_length || !change.bytes().all(is_valid) {
            return Err(unknown(change));
        }
        let mut bytes = [0; MAX_CHANGE_BYTES];
        bytes[..change.len()].copy_from_slice(change.as_bytes());
        Ok(Self {
            benchmark,
            change: bytes,
        })
    }

    /// The benchmark.
    pub const fn benchmark(&self) -> Benchmark {
        self.benchmark
    }

    /// Returns the change: `noise_30`, `swap` or [`Self::UNPERTURBED`].
    pub fn change(&self) -> &str {
        let end = self.change.iter().position(|byte| *byte == 0);
        let bytes = &self.change[..end.unwrap_or(MAX_CHANGE_BYTES)];
        str::from_utf8(bytes).expect("only ASCII is stored")
    }

    /// Returns true if nothing is changed.
    pub fn is_unperturbed(&self) -> bool {
        self.change() == Self::UNPERTURBED
    }
}

impl fmt::Display for VariantName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.benchmark.tag(), self.change())
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
        let benchmark = Benchmark::from_tag(tag).ok_or_else(|| unknown(text))?;
        Self::new(benchmark, change).map_err(|_| unknown(text))
    }
}

fn unknown(given: &str) -> UnknownName {
    let valid = "plus: or pro: and a change in at most 31 lower-case letters, digits and _, such \
                 as plus:noise_30, pro:swap or plus:unperturbed";
    UnknownName::new("variant of a rollout id", given, &[valid])
}
