//! The commands of the documentation, run as a newcomer pastes them.
//!
//! A page is a session of one shell in a folder that looks like the checkout. Its
//! blocks marked `sh` run in their order; servers stay until the page ends. An HTML
//! comment before a block changes that:
//!
//! - `<!-- not run: REASON -->`: the block is only named,
//! - `<!-- needs: THING -->`: it is skipped where the machine lacks the thing
//!   ([`folder::Thing`]); paths to `../shared` need no comment,
//! - `<!-- file: NAME -->`: a block of another language is written into a file.

pub mod folder;
pub mod page;
pub mod session;
pub mod visit;
