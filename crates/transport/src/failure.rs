//! Description and classification of failed calls.

use std::error::Error;

use tonic::{Code, Status};

/// Formats an error and its causes in one line, without the causes whose text is already in it.
pub fn chain(error: &(dyn Error + 'static)) -> String {
    let mut text = error_text(error);
    let mut cause = error.source();
    while let Some(source) = cause {
        let next = error_text(source);
        if !text.contains(&next) {
            text = format!("{text}: {next}");
        }
        cause = source.source();
    }
    text
}

/// Returns the message of the last error in a chain, which names the cause.
pub fn innermost(error: &(dyn Error + 'static)) -> String {
    let mut innermost = error;
    while let Some(source) = innermost.source() {
        innermost = source;
    }
    error_text(innermost)
}

/// Formats one error. A gRPC status is reduced to its message, since its `Display` adds the code
/// and the raw details.
fn error_text(error: &(dyn Error + 'static)) -> String {
    match error.downcast_ref::<Status>() {
        Some(status) => status_text(status),
        None => error.to_string(),
    }
}

/// Returns the message of a status, or its code if the server gave no message.
pub fn status_text(status: &Status) -> String {
    match status.message() {
        "" => format!("gRPC status {:?}, without a reason", status.code()),
        message => message.to_owned(),
    }
}

/// Returns true if a status code means a fault of the server or the network, rather than of the
/// request.
pub fn is_outage_code(code: Code) -> bool {
    matches!(
        code,
        Code::Unavailable | Code::DeadlineExceeded | Code::ResourceExhausted | Code::Cancelled
    )
}

/// Returns true if a call failed because of the server or the network, rather than because of the
/// request. INTERNAL is not an outage: the policy answered, and failed on this observation.
pub fn is_outage(status: &Status) -> bool {
    // A status that this side created for a broken connection has a source; a status from the
    // server has none.
    is_outage_code(status.code()) || status.source().is_some()
}

/// Returns true if the same call may succeed later, that is, for every code except those of a
/// refusal. INTERNAL is retried: a coordinator returns it when its disk is full.
pub fn may_succeed_later(status: &Status) -> bool {
    !matches!(
        status.code(),
        Code::InvalidArgument
            | Code::NotFound
            | Code::AlreadyExists
            | Code::PermissionDenied
            | Code::FailedPrecondition
            | Code::Aborted
            | Code::OutOfRange
            | Code::Unimplemented
            | Code::DataLoss
            | Code::Unauthenticated
    )
}

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("ask the policy")]
    struct Outer(#[source] Status);

    #[test]
    fn a_chain_names_every_cause_once() {
        let broken = io::Error::new(io::ErrorKind::ConnectionReset, "peer went away");
        let mut status = Status::unavailable("transport error");
        status.set_source(std::sync::Arc::new(broken));
        let text = chain(&Outer(status));
        assert_eq!(text, "ask the policy: transport error: peer went away");
        let twice = io::Error::other(io::Error::other("disk full"));
        assert_eq!(chain(&twice), "disk full");
    }

    #[test]
    fn a_status_without_a_message_is_named_by_its_code() {
        let silent = Status::unimplemented("");
        assert_eq!(chain(&silent), "gRPC status Unimplemented, without a reason");
    }

    #[test]
    fn server_errors_are_distinguished_from_network_errors() {
        assert!(is_outage(&Status::unavailable("warming up")));
        assert!(is_outage(&Status::resource_exhausted("queue full")));
        assert!(!is_outage(&Status::internal("shape mismatch")));
        assert!(!is_outage(&Status::unknown("Exception in infer")));
        let broken = io::Error::from(io::ErrorKind::ConnectionReset);
        assert!(is_outage(&Status::from_error(Box::new(broken))));
    }

    #[test]
    fn a_refusal_is_not_retried() {
        assert!(!may_succeed_later(&Status::failed_precondition("another version")));
        assert!(!may_succeed_later(&Status::not_found("no such job")));
        assert!(may_succeed_later(&Status::unavailable("connection refused")));
        assert!(may_succeed_later(&Status::internal("disk full")));
        assert!(may_succeed_later(&Status::deadline_exceeded("no answer")));
    }
}
