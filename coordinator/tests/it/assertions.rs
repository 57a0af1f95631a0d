//! Assertions that the tests of coordinator and gateway share.

use std::fmt::Debug;

use tonic::{Code, Status};

/// Asserts that a call was refused with this code and a message that contains all `parts`.
#[track_caller]
pub(crate) fn assert_refused<T: Debug>(answer: Result<T, Status>, code: Code, parts: &[&str]) {
    let status = answer.expect_err("the call must be refused");
    assert_eq!(status.code(), code, "{status}");
    assert_contains(status.message(), parts);
}

/// Asserts that a text contains all `parts`.
#[track_caller]
pub(crate) fn assert_contains(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "no `{part}` in:\n{text}");
    }
}
