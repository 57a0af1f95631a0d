//! Tests of reports in all of their output formats.

mod comparisons;
mod explanations;
mod family;
mod forms;
mod import;
mod rendered;
mod stops;
mod subjects;
mod tables;
mod thresholds;
mod words;

fn assert_fits_a_terminal(text: &str) {
    for line in text.lines() {
        assert!(line.chars().count() <= 80, "{line}");
    }
}
