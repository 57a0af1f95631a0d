//! Fingerprints as workers send them: which texts are one. What they must agree
//! with is `pairing`'s business.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use protocol::Axis;

use crate::ids::shortened;

/// Most of a text that is no fingerprint that an error repeats, bytes.
const MAX_QUOTED_BYTES: usize = 80;

/// Whether a text is a SHA-256 in lower-case hex.
pub fn is_sha256(text: &str) -> bool {
    let is_hex = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
    text.len() == 64 && text.bytes().all(is_hex)
}

/// What was realised of a rollout's perturbation: a SHA-256 for each perturbed
/// axis, over its parameters and what became of them.
///
/// As text `camera:HEX,sensor:HEX`, in the protocol's order of the axes; of a
/// nominal rollout the empty text. Language has no parameters and no digest.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AxisDigests(BTreeMap<Axis, String>);

/// A text that is no [`AxisDigests`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "read the digests of perturbed axes at `{part}`: each is AXIS:SHA-256 in lower-case hex, the \
     axes with numbers each at most once, in the protocol's order, with commas between"
)]
pub struct AxisDigestsError {
    /// Where it goes wrong, shortened.
    pub part: String,
}

impl AxisDigests {
    /// The perturbed axes, in the protocol's order.
    pub fn axes(&self) -> impl Iterator<Item = Axis> {
        self.0.keys().copied()
    }

    /// The digest of one axis, if it is perturbed.
    pub fn of(&self, axis: Axis) -> Option<&str> {
        self.0.get(&axis).map(String::as_str)
    }
}

impl fmt::Display for AxisDigests {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, (axis, digest)) in self.0.iter().enumerate() {
            let comma = if i > 0 { "," } else { "" };
            write!(f, "{comma}{axis}:{digest}")?;
        }
        Ok(())
    }
}

impl FromStr for AxisDigests {
    type Err = AxisDigestsError;

    fn from_str(text: &str) -> Result<Self, AxisDigestsError> {
        let mut digests = BTreeMap::new();
        if text.is_empty() {
            return Ok(Self(digests));
        }
        for part in text.split(',') {
            let bad = || AxisDigestsError {
                part: shortened(part, MAX_QUOTED_BYTES).to_owned(),
            };
            let (axis, digest) = part.split_once(':').ok_or_else(bad)?;
            let axis: Axis = axis.parse().map_err(|_| bad())?;
            let follows = digests
                .last_key_value()
                .is_none_or(|(last, _)| *last < axis);
            if !follows || !Axis::METRIC.contains(&axis) || !is_sha256(digest) {
                return Err(bad());
            }
            digests.insert(axis, digest.to_owned());
        }
        Ok(Self(digests))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_digests_read_back_from_their_text() {
        let (one, other) = ("1".repeat(64), "f".repeat(64));
        for text in [
            String::new(),
            format!("robot:{one}"),
            format!("camera:{one},sensor:{other}"),
        ] {
            let digests: AxisDigests = text.parse().expect("digests");
            assert_eq!(digests.to_string(), text);
        }
        let digests: AxisDigests = format!("camera:{one},sensor:{other}").parse().expect("two");
        assert_eq!(digests.of(Axis::Sensor), Some(other.as_str()));
        assert_eq!(digests.of(Axis::Robot), None);
        assert!(digests.axes().eq([Axis::Camera, Axis::Sensor]));
    }

    #[test]
    fn what_is_no_axis_digest_is_refused_where_it_goes_wrong() {
        let hex = "0".repeat(64);
        for (text, word) in [
            (hex.clone(), "`0000"),
            ("camera:".to_owned(), "`camera:`"),
            (format!("camera:{}", "G".repeat(64)), "camera:GG"),
            (format!("colour:{hex}"), "colour"),
            (format!("language:{hex}"), "language"),
            (format!("camera:{hex},"), "``"),
            (format!("camera:{hex},camera:{hex}"), "camera"),
            (format!("sensor:{hex},camera:{hex}"), "`camera:0"),
        ] {
            let error = text.parse::<AxisDigests>().expect_err(&text).to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}
