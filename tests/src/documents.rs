//! Runs the commands of the documentation as a reader would paste them.
//!
//! A page is a session of one shell in a folder with the checkout's files. Its
//! blocks marked `sh` run in order; servers run until the page ends. An HTML
//! comment before a block changes this:
//!
//! - `<!-- not run: REASON -->`: the block is only listed,
//! - `<!-- needs: REQUIREMENT -->`: the block is skipped if the machine does not meet it
//!   ([`folder::Requirement`]); a block that names `../shared` needs `reference data`
//!   without such a comment,
//! - `<!-- file: NAME -->`: a block of another language is written to a file.

pub mod folder;
pub mod page;
pub mod session;
pub mod visit;
