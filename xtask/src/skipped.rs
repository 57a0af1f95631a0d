//! Reports tests that were skipped because this machine lacks reference data or a tool.
//!
//! A skipped test passes after printing a line that begins with `skipped`, in upper or lower case,
//! to standard output or standard error. A test of documented commands prints a line that begins
//! with `not run` for each command that no test runs. Nextest hides the output of passed tests but
//! keeps it in its report.

use std::path::Path;

use anyhow::{Context, Result, ensure};

/// Start of the line that a skipped test prints.
const MARK: &str = "skipped";

/// Start of the line for a documented command that no test runs.
const NOT_RUN: &str = "not run";

/// Part of every path to the reference data, from any checkout.
const REFERENCE: &str = "/shared/";

/// Prints, from nextest's JUnit report, the documented commands that no test runs, and the skipped
/// tests with their reasons and number.
pub(crate) fn check(report: &Path, shared: &Path) -> Result<()> {
    let text = std::fs::read_to_string(report)
        .with_context(|| format!("read nextest's report {}", report.display()))?;
    let read = |mark| {
        marked_lines(&text, mark)
            .with_context(|| format!("read nextest's report {}", report.display()))
    };
    let not_run = read(NOT_RUN)?;
    if !not_run.is_empty() {
        println!("Documented commands that no test runs:");
    }
    for (_, reason) in &not_run {
        println!("  {reason}");
    }
    let skipped = read(MARK)?;
    for (test, reason) in &skipped {
        println!("  {test}: {reason}");
    }
    match skipped.len() {
        0 => println!("No test was skipped."),
        1 => println!(
            "1 test, or a part of it, was skipped because this machine lacks a requirement."
        ),
        n => println!(
            "{n} tests, or parts of them, were skipped because this machine lacks requirements."
        ),
    }
    let missing_reference: Vec<&str> = skipped
        .iter()
        .filter(|(_, reason)| shared.exists() && reason.contains(REFERENCE))
        .map(|(test, _)| test.as_str())
        .collect();
    ensure!(
        missing_reference.is_empty(),
        "run every test on the reference data: {} exists, but these tests did not find their \
         part of it: {}",
        shared.display(),
        missing_reference.join(", ")
    );
    Ok(())
}

/// Returns the tests' lines that begin with `mark`, each with the test's name, sorted.
fn marked_lines(report: &str, mark: &str) -> Result<Vec<(String, String)>> {
    let document = roxmltree::Document::parse(report)?;
    let tests = document.descendants().filter(|n| n.has_tag_name("testcase"));
    let mut skipped: Vec<(String, String)> = tests
        .flat_map(|test| {
            let name = test.attribute("name").unwrap_or_default();
            let outputs = test.children().filter_map(|output| output.text());
            let lines = outputs.flat_map(str::lines).map(str::trim);
            lines.filter(|line| begins_with(line, mark)).map(move |line| {
                let reason = line.split_once(": ").map_or(line, |(_, reason)| reason);
                (name.to_owned(), reason.to_owned())
            })
        })
        .collect();
    skipped.sort();
    Ok(skipped)
}

/// Returns true if a line begins with `mark`, ignoring case.
fn begins_with(line: &str, mark: &str) -> bool {
    let beginning = line.get(..mark.len());
    beginning.is_some_and(|beginning| beginning.eq_ignore_ascii_case(mark))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skipped_tests_are_listed_with_the_reason() {
        let report = "<testsuites><testsuite name='scene'>
            <testcase name='b_is_held'><system-out>running 1 test
                skipped b_is_held: no reference data at ../shared
                not run: A.md:7: needs a GPU
                </system-out><system-err>SKIPPED b_is_held: no npm
                </system-err></testcase>
            <testcase name='a_holds'><system-out>nothing is skipped here</system-out></testcase>
            </testsuite></testsuites>";
        let test_b = |reason: &str| ("b_is_held".to_owned(), reason.to_owned());
        let skipped = [test_b("no npm"), test_b("no reference data at ../shared")];
        assert_eq!(marked_lines(report, MARK).expect("XML"), skipped);
        let not_run = [test_b("A.md:7: needs a GPU")];
        assert_eq!(marked_lines(report, NOT_RUN).expect("XML"), not_run);
    }

    #[test]
    fn a_test_that_misses_existing_reference_data_fails_the_run() {
        let folder = tempfile::tempdir().expect("a folder");
        let report = folder.path().join("junit.xml");
        let write = |reason: &str| {
            let text = format!(
                "<testsuites><testcase name='a'><system-out>skipped{reason}</system-out></testcase>\
                 <testcase name='b'><system-out>skipped b: no chromium</system-out></testcase>\
                 </testsuites>"
            );
            std::fs::write(&report, text).expect("a report");
        };
        let (existing, absent) = (folder.path(), folder.path().join("absent"));
        for reason in [
            " a: no reference data at /elsewhere/tests/../../shared/oracle/tasks",
            ": /here/crates/paired/../../../shared/libero-ctrl-v0.1 is not here",
        ] {
            write(reason);
            let error = check(&report, existing).expect_err(reason).to_string();
            assert!(error.ends_with("did not find their part of it: a"), "{error}");
            check(&report, &absent).expect(reason);
        }
        write(" a: no chromium");
        check(&report, existing).expect("a missing tool is no failure");
    }
}
