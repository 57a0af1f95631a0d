//! Reports as their readers and programs meet them.

mod comparisons;
mod explanations;
mod forms;
mod how_far;
mod import;
mod stops;
mod subjects;
mod tables;
mod words;
