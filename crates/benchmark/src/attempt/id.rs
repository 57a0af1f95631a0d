//! Id of an attempt.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Globally unique id of an attempt at a rollout: 128 random bits, drawn when its lease is granted.
/// As text, 32 digits of lower-case hex.
///
/// Job numbers, attempt numbers and worker names do not identify an attempt, since two coordinators
/// may assign equal numbers and names.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct AttemptId(u128);

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("read an attempt id: the text must be 32 digits of lower-case hex")]
pub struct AttemptIdError;

impl AttemptId {
    pub fn from_random(bits: [u8; 16]) -> AttemptId {
        AttemptId(u128::from_be_bytes(bits))
    }
}

impl fmt::Display for AttemptId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:032x}", self.0)
    }
}

impl fmt::Debug for AttemptId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl FromStr for AttemptId {
    type Err = AttemptIdError;

    fn from_str(text: &str) -> Result<AttemptId, AttemptIdError> {
        let is_digit = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
        if text.len() != 32 || !text.bytes().all(is_digit) {
            return Err(AttemptIdError);
        }
        u128::from_str_radix(text, 16).map(AttemptId).map_err(|_| AttemptIdError)
    }
}

impl TryFrom<String> for AttemptId {
    type Error = AttemptIdError;

    fn try_from(text: String) -> Result<AttemptId, AttemptIdError> {
        text.parse()
    }
}

impl From<AttemptId> for String {
    fn from(id: AttemptId) -> String {
        id.to_string()
    }
}

/// Returns the longest prefix of `text` that fits in `max_bytes` and ends on a character boundary.
/// Limits text from clients before it is stored or shown.
pub fn shortened(text: &str, max_bytes: usize) -> &str {
    let end = (0..=max_bytes.min(text.len())).rev().find(|&end| text.is_char_boundary(end));
    &text[..end.unwrap_or(0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shortened_text_ends_between_characters() {
        assert_eq!(shortened("aé", 2), "a");
        assert_eq!(shortened("aé", 3), "aé");
        assert_eq!(shortened("", 5), "");
    }

    #[test]
    fn an_id_is_parsed_only_from_its_own_text() {
        let id = AttemptId::from_random([0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 255]);
        let text = id.to_string();
        assert_eq!(text, "000102030405060708090a0b0c0d0eff");
        assert_eq!(text.parse(), Ok(id));
        for invalid in ["", "0", &text[1..], &text.to_uppercase(), &format!("+{}", &text[1..])] {
            assert_eq!(invalid.parse::<AttemptId>(), Err(AttemptIdError), "{invalid}");
        }
    }
}
