//! Terminal conventions of all programs: log, output, manual pages, options from the environment,
//! and parsers of option values.

#![forbid(unsafe_code)]

mod environment;
mod manual;
mod output;
mod parent;
mod printable;
mod values;

pub use environment::{cache_folder, parse, read, with_variables};
pub use manual::write_manual;
pub use output::{clear_lines, complain, counted, log, print, print_line, reader_is_gone, wrapped};
pub use parent::{PARENT_VARIABLE, end_with_parent};
pub use printable::printable;
pub use values::{address, decimal, number, number_from, seconds};
