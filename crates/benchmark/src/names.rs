//! Error for unknown names: quotes the name and lists the valid names.

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("read {kind}{}: valid are {valid}", quoted(given))]
pub struct UnknownName {
    /// Kind of name, such as `suite` or `axis`.
    pub kind: &'static str,
    pub given: String,
    pub valid: String,
}

fn quoted(given: &str) -> String {
    match given {
        "" => ", which is empty".to_owned(),
        given => format!(" `{given}`"),
    }
}

impl UnknownName {
    pub(crate) fn new(kind: &'static str, given: &str, valid: &[&str]) -> Self {
        let meant = MEANT.iter().find(|(name, _)| given.split('/').next() == Some(*name));
        let meant = meant.map(|(_, meant)| *meant);
        let meant = meant.or_else(|| valid.iter().copied().find(|v| v.eq_ignore_ascii_case(given)));
        let meant = meant.map_or_else(String::new, |meant| format!("; did you mean {meant}?"));
        Self { kind, given: given.to_owned(), valid: valid.join(", ") + &meant }
    }
}

/// Names that other tools use, or that look like a name here, and what to write instead.
const MEANT: [(&str, &str); 7] = [
    ("libero_long", "libero_10"),
    ("libero_90", "`--suite-file examples/suites/libero_90.json`"),
    ("1", "L1"),
    ("2", "L2"),
    ("3", "L3"),
    ("L1..L3", "L1,L2,L3"),
    ("L1-L3", "L1,L2,L3"),
];

/// Serialises a type as the text of its `Display` and `FromStr`.
macro_rules! serde_as_text {
    ($type:ty) => {
        impl serde::Serialize for $type {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> serde::Deserialize<'de> for $type {
            fn deserialize<D: serde::Deserializer<'de>>(source: D) -> Result<Self, D::Error> {
                let text = String::deserialize(source)?;
                text.parse().map_err(serde::de::Error::custom)
            }
        }
    };
}

pub(crate) use serde_as_text;

#[cfg(test)]
mod tests {
    use crate::{Level, Suite, TaskRef};

    #[test]
    fn names_of_other_tools_and_near_names_get_a_suggestion() {
        let error = |text: &str| {
            let of_level = text.parse::<Level>().expect_err("no level").to_string();
            let of_suite = text.parse::<Suite>().expect_err("no suite").to_string();
            [of_level, of_suite, text.parse::<TaskRef>().expect_err("no task").to_string()]
        };
        for (text, meant) in [
            ("l2", "did you mean L2?"),
            ("2", "did you mean L2?"),
            ("L1..L3", "did you mean L1,L2,L3?"),
            ("libero_long", "did you mean libero_10?"),
            ("libero_90/0", "did you mean `--suite-file examples/suites/libero_90.json`?"),
        ] {
            assert!(error(text).iter().any(|error| error.ends_with(meant)), "{:?}", error(text));
        }
        assert!(!error("camera").concat().contains("did you mean"));
    }
}
