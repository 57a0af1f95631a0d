//! Kinds of back-ends, and the specification of one back-end.

use std::error::Error;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use proto::policy::InferResponse;
use thiserror::Error;
use transport::{Access, AccessError};

use crate::backend::Backend;
use crate::{builtin, grpc, openpi, replay, vla_eval};

/// Every kind of back-end. A further kind is a module with a `KIND`, and an entry here: routes, all
/// commands, their help and errors, and the fuzzing of answers use this table.
pub const KINDS: [Kind; 6] =
    [grpc::KIND, openpi::KIND, vla_eval::KIND, builtin::KIND, builtin::student::KIND, replay::KIND];

pub struct Kind {
    /// Texts before the first colon of a specification.
    pub(crate) schemes: &'static [&'static str],
    /// Forms of a specification, for help and errors.
    pub(crate) form: &'static str,
    pub(crate) read: fn(&str) -> Result<BackendSpec, OwnError>,
    /// Messages of a server whose protocol is not that of policies.
    pub answers: Option<Answers>,
}

/// The answers of a protocol's servers, for tests with arbitrary messages.
pub struct Answers {
    pub read: fn(&[u8]) -> Option<InferResponse>,
    /// A valid answer, with one action.
    pub example: &'static [u8],
}

/// Error of a kind of back-end, which its module defines.
pub type OwnError = Box<dyn Error + Send + Sync>;

impl Kind {
    pub(crate) const fn new<S: Specified + FromStr<Err: Error + Send + Sync> + 'static>(
        schemes: &'static [&'static str],
        form: &'static str,
    ) -> Self {
        let read = |text: &str| Ok(BackendSpec::new(text.parse::<S>()?));
        Self { schemes, form, read, answers: None }
    }
}

/// Parsed address and options of a back-end of one kind. `Display` writes the text that `FromStr`
/// read.
pub trait Specified: fmt::Debug + fmt::Display + Send + Sync {
    /// Creates the back-end, without connecting.
    fn open(&self, access: &Access) -> Result<Arc<dyn Backend>, OwnError>;

    fn is_encrypted(&self) -> bool {
        false
    }

    /// Returns the specification that a server's error asks for.
    fn corrected(&self, _error: &str) -> Option<BackendSpec> {
        None
    }
}

/// Specification of a back-end that answers for a policy, as in [`forms`].
#[derive(Clone, Debug)]
pub struct BackendSpec(Arc<dyn Specified>);

impl BackendSpec {
    pub(crate) fn new(specified: impl Specified + 'static) -> Self {
        Self(Arc::new(specified))
    }

    pub fn is_encrypted(&self) -> bool {
        self.0.is_encrypted()
    }

    /// Returns the specification that a server's error asks for, if it names a wrong one.
    pub fn corrected(&self, error: &str) -> Option<Self> {
        self.0.corrected(error)
    }

    /// Creates the back-end, without connecting.
    pub fn open(&self, access: &Access) -> Result<Arc<dyn Backend>, UnusableBackend> {
        self.0.open(access).map_err(UnusableBackend::Own)
    }
}

impl PartialEq for BackendSpec {
    fn eq(&self, other: &Self) -> bool {
        self.to_string() == other.to_string()
    }
}

impl Eq for BackendSpec {}

impl FromStr for BackendSpec {
    type Err = BackendSpecError;

    fn from_str(text: &str) -> Result<Self, BackendSpecError> {
        let scheme = text.split_once(':').map_or("", |(scheme, _)| scheme);
        let kind = KINDS.iter().find(|kind| kind.schemes.contains(&scheme));
        let kind = kind.ok_or_else(|| BackendSpecError::Kind { text: text.to_owned() })?;
        (kind.read)(text).map_err(BackendSpecError::Own)
    }
}

impl fmt::Display for BackendSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

pub fn forms() -> String {
    KINDS.each_ref().map(|kind| kind.form).join(", ")
}

/// The text does not specify a back-end. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum BackendSpecError {
    #[error("read back-end {text:?}: write one of {}", forms())]
    Kind { text: String },
    #[error(transparent)]
    Own(OwnError),
}

/// Reason why a back-end cannot be created. The message follows "failed to …".
#[derive(Debug, Error)]
pub enum UnusableBackend {
    #[error(transparent)]
    Access(#[from] AccessError),
    #[error(transparent)]
    Own(OwnError),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_is_documented_and_its_example_is_an_answer_of_one_action() {
        let page = include_str!("../../../docs/POLICIES.md");
        for kind in &KINDS {
            for scheme in kind.schemes {
                assert!(page.contains(&format!("{scheme}:")), "{scheme}");
                assert!(kind.form.contains(&format!("{scheme}:")), "{scheme}");
            }
            if let Some(Answers { read, example }) = &kind.answers {
                assert_eq!(read(example).expect(kind.form).actions.len(), 7);
            }
        }
    }
}
