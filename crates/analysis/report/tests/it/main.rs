//! Tests of reports in all of their output formats.

mod comparisons;
mod explanations;
mod family;
mod forms;
mod how_far;
mod import;
mod stops;
mod subjects;
mod tables;
mod words;
