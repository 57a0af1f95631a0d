//! Which tests did not run because something is not on this machine: the
//! reference data, a tool. Such a test passes after saying so in a line that
//! begins with `skipped`, and nobody sees what a passed test says; nextest's
//! report keeps it.

use std::path::Path;

use anyhow::{Context, Result};

/// How the line begins.
const MARK: &str = "skipped";

/// Reads nextest's JUnit report and prints who was skipped, why, and how many.
pub(crate) fn print(report: &Path) -> Result<()> {
    let text = std::fs::read_to_string(report)
        .with_context(|| format!("read nextest's report {}", report.display()))?;
    let skipped =
        list(&text).with_context(|| format!("read nextest's report {}", report.display()))?;
    for (test, why) in &skipped {
        println!("  {test}: {why}");
    }
    match skipped.len() {
        0 => println!("No test was skipped for what this machine lacks."),
        1 => println!("1 test was skipped for what this machine lacks."),
        n => println!("{n} tests were skipped for what this machine lacks."),
    }
    Ok(())
}

/// Tests by name, and the line in which each says that it was skipped.
fn list(report: &str) -> Result<Vec<(String, String)>> {
    let document = roxmltree::Document::parse(report)?;
    let tests = document
        .descendants()
        .filter(|n| n.has_tag_name("testcase"));
    let mut skipped: Vec<(String, String)> = tests
        .filter_map(|test| {
            let name = test.attribute("name")?;
            let said = test.children().filter_map(|output| output.text());
            let line = said
                .flat_map(str::lines)
                .map(str::trim)
                .find(|line| line.starts_with(MARK))?;
            let why = line.split_once(": ").map_or(line, |(_, why)| why);
            Some((name.to_owned(), why.to_owned()))
        })
        .collect();
    skipped.sort();
    Ok(skipped)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_says_so_is_listed_with_the_reason() {
        let report = "<testsuites><testsuite name='scene'>
            <testcase name='b_is_held'><system-out>running 1 test
                skipped b_is_held: no reference data at ../shared
                </system-out></testcase>
            <testcase name='a_holds'><system-out>nothing is skipped here</system-out></testcase>
            </testsuite></testsuites>";
        let expected = ("b_is_held", "no reference data at ../shared");
        let expected = (expected.0.to_owned(), expected.1.to_owned());
        assert_eq!(list(report).expect("XML"), [expected]);
    }
}
