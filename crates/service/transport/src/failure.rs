//! Failed calls: what they are in words, and whose fault they are.

use std::error::Error;

use tonic::{Code, Status};

/// An error and what lies behind it, in one line: what a cause repeats of the
/// error before it is said once.
pub fn chain(error: &(dyn Error + 'static)) -> String {
    let mut text = words(error);
    let mut cause = error.source();
    while let Some(source) = cause {
        let more = words(source);
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = source.source();
    }
    text
}

/// The last error of a chain, which is the one that names the cause.
pub fn innermost(error: &(dyn Error + 'static)) -> String {
    let mut innermost = error;
    while let Some(source) = innermost.source() {
        innermost = source;
    }
    words(innermost)
}

/// A status displays with its code in the library's words, and with its details,
/// which are bytes.
fn words(error: &(dyn Error + 'static)) -> String {
    match error.downcast_ref::<Status>() {
        Some(status) => answer(status),
        None => error.to_string(),
    }
}

/// Returns a server's error message, or the status code if it gave none.
pub fn answer(status: &Status) -> String {
    match status.message() {
        "" => format!("gRPC status {:?}, without a reason", status.code()),
        message => message.to_owned(),
    }
}

/// Returns true if a server's answer of this code is about the server or the way
/// to it, rather than about what was asked.
pub fn is_outage_code(code: Code) -> bool {
    matches!(
        code,
        Code::Unavailable | Code::DeadlineExceeded | Code::ResourceExhausted | Code::Cancelled
    )
}

/// Returns true if a call failed because of the server or the way to it, rather
/// than because of what was asked. INTERNAL is an answer: of a policy, that it
/// failed on this observation.
pub fn is_outage(status: &Status) -> bool {
    // A status that this side made out of a broken connection has a cause; one
    // that the server sent has none.
    is_outage_code(status.code()) || status.source().is_some()
}

/// Returns true if the same call may succeed later: everything but a refusal that
/// says why. INTERNAL is a failure to try again after: of a coordinator, that its
/// disk is full.
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
    fn an_answer_without_words_is_named_by_its_code() {
        let silent = Status::unimplemented("");
        assert_eq!(
            chain(&silent),
            "gRPC status Unimplemented, without a reason"
        );
    }

    #[test]
    fn what_the_server_says_is_told_apart_from_what_the_network_does() {
        assert!(is_outage(&Status::unavailable("warming up")));
        assert!(is_outage(&Status::resource_exhausted("queue full")));
        assert!(!is_outage(&Status::internal("shape mismatch")));
        assert!(!is_outage(&Status::unknown("Exception in infer")));
        let broken = io::Error::from(io::ErrorKind::ConnectionReset);
        assert!(is_outage(&Status::from_error(Box::new(broken))));
    }

    #[test]
    fn a_refusal_is_not_asked_again() {
        assert!(!may_succeed_later(&Status::failed_precondition(
            "another version"
        )));
        assert!(!may_succeed_later(&Status::not_found("no such job")));
        assert!(may_succeed_later(&Status::unavailable(
            "connection refused"
        )));
        assert!(may_succeed_later(&Status::internal("disk full")));
        assert!(may_succeed_later(&Status::deadline_exceeded("no answer")));
    }
}
