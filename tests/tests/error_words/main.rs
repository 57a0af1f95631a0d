//! Prints every variant of every error with its whole chain of causes: no message has a raw phrase
//! of a library, a missing part or a repeated word. A list that lacks a variant of its error does
//! not compile, and a test searches the sources for errors without a list.

mod gateway;
mod simulation;
mod storage;
mod student;
mod transport_and_protocol;

use std::collections::BTreeSet;
use std::error::Error;
use std::io;
use std::path::{Path, PathBuf};

use tests::phrases::raw_phrase;

/// Errors that are not listed by themselves: three occur only inside listed errors, and `Outer`
/// belongs to a unit test.
const PRIVATE: [&str; 4] = ["FilmingError", "TextError", "Outer", "MissingInput"];

/// Errors whose messages are complete sentences; the messages of all others follow "failed to …".
const SENTENCES: [&str; 13] = [
    "TooLate",
    "ConnectError",
    "BackendError",
    "ActionFault",
    "DescriptionFault",
    "AnswerError",
    "RouteError",
    "PolicyError",
    "LineProblem",
    "Unexplained",
    "NotMeasurable",
    "WeightsError",
    "QueryError",
];

/// Messages of errors, each with the name of its type.
#[derive(Default)]
pub(crate) struct Messages {
    types: BTreeSet<String>,
    texts: Vec<(String, String)>,
}

impl Messages {
    /// Adds an error as programs print it.
    pub(crate) fn add(&mut self, path: &str, error: impl Error + Send + Sync + 'static) {
        let name = path.rsplit("::").next().unwrap_or(path);
        self.types.insert(name.trim().to_owned());
        let logged = transport::chain(&error);
        let start = match SENTENCES.contains(&name) {
            true => "",
            false => "failed to ",
        };
        let printed = format!("{start}{:#}", anyhow::Error::from(error));
        for text in [logged, printed] {
            self.texts.push((name.to_owned(), text));
        }
    }
}

/// Adds every variant of an enum, given as a complete list of patterns, each with a value.
#[macro_export]
macro_rules! variants {
    ($messages:expr, $name:path, $($pattern:pat => $value:expr,)+) => {{
        fn is_complete(error: &$name) {
            match error {
                $($pattern => {})+
            }
        }
        $({
            let error: $name = $value;
            assert!(matches!(&error, $pattern), "{error:?} is another variant");
            is_complete(&error);
            $messages.add(stringify!($name), error);
        })+
    }};
}

/// Returns an error of the operating system, with its description.
pub(crate) fn io_error() -> io::Error {
    io::Error::from(io::ErrorKind::PermissionDenied)
}

/// Error of parsing JSON that lacks a field.
pub(crate) fn json_error() -> libero_ctrl::JsonError {
    #[derive(Debug, serde::Deserialize)]
    struct Counted {
        #[expect(dead_code, reason = "only deserialised")]
        count: u32,
    }
    let error = serde_json::from_str::<Counted>("{}").expect_err("no count");
    error.into()
}

pub(crate) fn path() -> PathBuf {
    PathBuf::from("/data/some/file")
}

/// Returns an arbitrary text, as from a user or another program.
pub(crate) fn text() -> String {
    "pi05".to_owned()
}

fn all() -> Messages {
    let mut messages = Messages::default();
    transport_and_protocol::add(&mut messages);
    simulation::add(&mut messages);
    storage::add(&mut messages);
    gateway::add(&mut messages);
    student::add(&mut messages);
    messages
}

#[test]
fn no_error_has_a_raw_library_phrase() {
    let messages = all();
    let raw: Vec<String> = messages
        .texts
        .iter()
        .filter_map(|(name, text)| Some(format!("{name}: {} in {text:?}", raw_phrase(text)?)))
        .collect();
    assert!(raw.is_empty(), "{}", raw.join("\n"));
}

/// Collects the names of the types in a file that derive an error trait.
fn errors_in(file: &Path, names: &mut BTreeSet<String>) {
    let text = std::fs::read_to_string(file).expect("a source");
    let mut is_error = false;
    for line in text.lines().map(str::trim) {
        if line.starts_with("#[derive(") {
            is_error = line.contains("thiserror::Error") || line.contains(" Error)");
        }
        let declared = [
            "pub enum ",
            "pub struct ",
            "pub(crate) enum ",
            "pub(super) enum ",
            "enum ",
            "struct ",
        ];
        let name = declared.iter().find_map(|start| line.strip_prefix(start));
        if let Some(name) = name {
            if is_error {
                let end = name.find(|c: char| !c.is_alphanumeric()).unwrap_or(name.len());
                names.insert(name[..end].to_owned());
            }
            is_error = false;
        }
    }
}

fn walk(folder: &Path, names: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten() {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            walk(&path, names);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            errors_in(&path, names);
        }
    }
}

#[test]
fn every_error_in_the_sources_is_listed() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let mut names = BTreeSet::new();
    for package in ["coordinator", "worker", "policy-gateway", "proto"] {
        walk(&root.join(package).join("src"), &mut names);
    }
    for group in std::fs::read_dir(root.join("crates")).expect("groups of crates") {
        for package in std::fs::read_dir(group.expect("a group").path()).expect("crates") {
            walk(&package.expect("a crate").path().join("src"), &mut names);
        }
    }
    assert!(names.len() > 40, "few errors were found: {names:?}");
    let listed = all().types;
    let missing: Vec<&String> = names
        .iter()
        .filter(|name| !listed.contains(*name) && !PRIVATE.contains(&name.as_str()))
        .collect();
    assert!(missing.is_empty(), "not listed: {missing:?}");
}
