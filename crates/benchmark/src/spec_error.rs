use crate::design::DesignError;
use crate::execution::Execution;
use crate::manifest::ManifestErrors;
use crate::stop::StopError;
use crate::wanted::MIN_DIGEST_DIGITS;

pub const MAX_REPLICATES: u32 = 100;

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SpecError {
    #[error("read campaign specification: {problem}")]
    Json { problem: String },
    #[error("read campaign specification: `{field}` is empty, {remedy}")]
    Empty { field: &'static str, remedy: &'static str },
    #[error(
        "read campaign specification: `replicates` has {given}, valid are 1 to {MAX_REPLICATES}"
    )]
    Replicates { given: u32 },
    /// The text is not quoted, since it may contain a password.
    #[error(
        "read campaign specification: `policy.endpoint` is no server's address, write \
         http://HOST:PORT or grpc://HOST:PORT, or over TLS https:// or grpcs://, without a user, a \
         password and a path; a server of openpi or vla-eval is reached through a gateway, as \
         `policy-gateway --route NAME=ws://HOST:PORT`"
    )]
    Endpoint,
    #[error(
        "read campaign specification: `assets` is `{given}`, write `primitives`, `libero` or at \
         least the first {MIN_DIGEST_DIGITS} digits of a pack's digest; the pack's folder is an \
         option of workers"
    )]
    Assets { given: String },
    #[error(
        "read campaign specification: `purpose` with `realisation` reference, in which each \
         condition perturbs an axis differently: write matched"
    )]
    Unmatched,
    #[error(
        "read campaign specification: `purpose` beside rollouts, which follow from outcomes and are \
         appended: write `rows` [] and no design"
    )]
    Purpose,
    #[error(
        "read campaign specification: `{field}` is {given}, valid are {} to {}", valid[0], valid[1]
    )]
    Radius { field: &'static str, given: f64, valid: [f64; 2] },
    #[error(
        "read campaign specification: `execution` is {given}, but its rows have \
         `{row_model}`: remove `execution` from the specification or from the rows"
    )]
    Execution { given: Execution, row_model: Execution },
    #[error(
        "read campaign specification: axis `latency` with `execution` {given}: its rollouts are \
         compared with rollouts without delay; remove `execution` or the axis"
    )]
    Latency { given: Execution },
    #[error(
        "read campaign specification: `record` with rows of other simulators, which are not \
         filmed: write none"
    )]
    Films,
    #[error("read campaign specification: {0}")]
    Stop(StopError),
    #[error("read campaign specification: {0}")]
    Design(DesignError),
    #[error(transparent)]
    Manifest(#[from] ManifestErrors),
}

// The message includes that of the inner error, which would be printed twice if the inner error
// were the source.
impl From<StopError> for SpecError {
    fn from(error: StopError) -> Self {
        Self::Stop(error)
    }
}

impl From<DesignError> for SpecError {
    fn from(error: DesignError) -> Self {
        Self::Design(error)
    }
}
