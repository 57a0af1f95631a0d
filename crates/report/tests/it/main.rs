//! Reports as their readers and programs meet them.

mod comparisons;
mod forms;
mod import;
mod stops;
mod subjects;
mod tables;
mod words;
