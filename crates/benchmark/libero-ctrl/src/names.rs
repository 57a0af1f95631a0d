//! Error for unknown names: quotes the name and lists the valid names.

/// Error: the name is unknown.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("read {kind}{}: valid are {valid}", quoted(given))]
pub struct UnknownName {
    /// Kind of name expected: "suite", "task", "axis", ...
    pub kind: &'static str,
    /// Name given, verbatim.
    pub given: String,
    /// Valid names, formatted for the message.
    pub valid: String,
}

/// Quotes the name for the message, after the kind of name expected.
fn quoted(given: &str) -> String {
    match given {
        "" => ", which is empty".to_owned(),
        given => format!(" `{given}`"),
    }
}

impl UnknownName {
    pub(crate) fn new(kind: &'static str, given: &str, valid: &[&str]) -> Self {
        Self { kind, given: given.to_owned(), valid: valid.join(", ") }
    }
}

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
