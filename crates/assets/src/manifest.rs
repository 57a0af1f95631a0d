//! What a folder of assets holds, file by file: to tell whether it still does.
//! As text: one line per file with SHA-256, size in bytes and path, sorted by
//! path.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use sha2::{Digest, Sha256};

use crate::error::AssetsError;

/// The first line of a manifest as text.
const HEADING: &str = "# Asset manifest 1: SHA-256, bytes, path";
/// Deeper nesting than any pack has; ends a loop of links.
const MAX_DEPTH: usize = 12;
/// Bytes that are hashed at a time.
const BLOCK_BYTES: usize = 1 << 16;

/// Files by their path in the folder, with `/`.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Manifest {
    files: BTreeMap<String, FileFacts>,
}

#[derive(Debug, PartialEq, Eq)]
struct FileFacts {
    bytes: u64,
    sha256: String,
}

impl Manifest {
    /// Reads a whole folder.
    ///
    /// # Errors
    /// If a file or folder cannot be read.
    pub fn of_folder(folder: &Path) -> Result<Self, AssetsError> {
        let mut files = BTreeMap::new();
        let mut folders = vec![(folder.to_owned(), 0)];
        while let Some((inner, depth)) = folders.pop() {
            let entries = fs::read_dir(&inner).map_err(|source| read_error(&inner, source))?;
            for entry in entries {
                let path = entry.map_err(|source| read_error(&inner, source))?.path();
                if path.is_dir() {
                    if depth < MAX_DEPTH {
                        folders.push((path, depth + 1));
                    }
                    continue;
                }
                let inside = path.strip_prefix(folder).expect("listed below it");
                let parts: Vec<_> = inside.iter().map(|part| part.to_string_lossy()).collect();
                let name = parts.join("/");
                let facts = FileFacts::of(&path);
                files.insert(name, facts.map_err(|source| read_error(&path, source))?);
            }
        }
        Ok(Self { files })
    }

    /// Reads a manifest that was written as text.
    ///
    /// # Errors
    /// If the file cannot be read, or is no manifest.
    pub fn read(file: &Path) -> Result<Self, AssetsError> {
        let text = fs::read_to_string(file).map_err(|source| read_error(file, source))?;
        text.parse().map_err(|problem| AssetsError::Manifest {
            path: file.to_owned(),
            problem,
        })
    }

    /// Where the manifest of a fetched pack is: beside its folder, because a file
    /// inside would be part of the pack's digest.
    pub fn beside(folder: &Path) -> PathBuf {
        let mut name = folder.file_name().unwrap_or_default().to_owned();
        name.push(".manifest.txt");
        folder.with_file_name(name)
    }

    /// How many files there are.
    pub fn count(&self) -> usize {
        self.files.len()
    }

    /// Their sizes' sum.
    pub fn total_bytes(&self) -> u64 {
        self.files.values().map(|facts| facts.bytes).sum()
    }

    /// What is otherwise in `found`, one file each.
    pub fn compare(&self, found: &Self) -> Vec<String> {
        let mut differences = Vec::new();
        for (name, expected) in &self.files {
            match found.files.get(name) {
                None => differences.push(format!("missing: {name}")),
                Some(facts) if facts.bytes != expected.bytes => differences.push(format!(
                    "altered: {name} ({} bytes instead of {})",
                    facts.bytes, expected.bytes
                )),
                Some(facts) if facts != expected => {
                    differences.push(format!("altered: {name} (another SHA-256)"));
                }
                Some(_) => {}
            }
        }
        let additional = found.files.keys();
        let additional = additional.filter(|name| !self.files.contains_key(*name));
        differences.extend(additional.map(|name| format!("additional: {name}")));
        differences
    }
}

/// SHA-256 of a file, hex.
pub(crate) fn sha256_of(path: &Path) -> io::Result<String> {
    let mut file = File::open(path)?;
    let mut hash = Sha256::new();
    let mut block = vec![0; BLOCK_BYTES];
    loop {
        match file.read(&mut block)? {
            0 => return Ok(hex(&hash.finalize())),
            read => hash.update(&block[..read]),
        }
    }
}

/// Lower-case hexadecimal.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn read_error(path: &Path, source: io::Error) -> AssetsError {
    AssetsError::Read {
        path: path.to_owned(),
        source,
    }
}

impl FileFacts {
    fn of(path: &Path) -> io::Result<Self> {
        Ok(Self {
            bytes: fs::metadata(path)?.len(),
            sha256: sha256_of(path)?,
        })
    }
}

impl fmt::Display for Manifest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{HEADING}")?;
        for (name, FileFacts { bytes, sha256 }) in &self.files {
            writeln!(f, "{sha256} {bytes} {name}")?;
        }
        Ok(())
    }
}

impl FromStr for Manifest {
    /// What is wrong, with the line.
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut lines = (1..).zip(text.lines());
        if lines.next().is_none_or(|(_, heading)| heading != HEADING) {
            return Err(format!("line 1 is not `{HEADING}`"));
        }
        let mut files = BTreeMap::new();
        for (number, line) in lines {
            let (name, facts) = read_line(line)
                .ok_or_else(|| format!("line {number} is not `SHA-256 BYTES PATH`"))?;
            files.insert(name, facts);
        }
        Ok(Self { files })
    }
}

fn read_line(line: &str) -> Option<(String, FileFacts)> {
    let (sha256, rest) = line.split_once(' ')?;
    let (bytes, name) = rest.split_once(' ')?;
    let is_digest = sha256.len() == 64 && sha256.bytes().all(|byte| byte.is_ascii_hexdigit());
    if !is_digest || name.is_empty() {
        return None;
    }
    let facts = FileFacts {
        bytes: bytes.parse().ok()?,
        sha256: sha256.to_owned(),
    };
    Some((name.to_owned(), facts))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_altered_and_additional_files_are_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        fs::create_dir_all(path("scenes/a b")).expect("makes");
        for name in ["scenes/same.xml", "scenes/a b/longer.png", "gone", "other"] {
            fs::write(path(name), name).expect("writes");
        }
        let before = Manifest::of_folder(folder.path()).expect("reads");
        let read_back: Manifest = before.to_string().parse().expect("its own text");
        assert_eq!(read_back, before);
        assert_eq!(before.compare(&read_back), Vec::<String>::new());

        fs::remove_file(path("gone")).expect("removes");
        fs::write(path("scenes/a b/longer.png"), "a longer text than before").expect("writes");
        fs::write(path("other"), "rehto").expect("writes");
        fs::write(path("new"), "").expect("writes");
        let after = Manifest::of_folder(folder.path()).expect("reads");
        assert_eq!(
            before.compare(&after),
            [
                "missing: gone",
                "altered: other (another SHA-256)",
                "altered: scenes/a b/longer.png (25 bytes instead of 21)",
                "additional: new",
            ]
        );
    }

    #[test]
    fn a_text_that_is_no_manifest_is_refused_with_its_line() {
        let check = |text: String, expected: &str| {
            let error = text.parse::<Manifest>().expect_err(expected);
            assert!(error.contains(expected), "{error}");
        };
        check(String::new(), "line 1");
        check(format!("{HEADING}\nabc 5 name"), "line 2");
        let digest = "0".repeat(64);
        check(
            format!("{HEADING}\n{digest} 5 a\n{digest} five b"),
            "line 3",
        );
    }
}
