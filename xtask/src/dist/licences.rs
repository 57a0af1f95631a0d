//! Collects the licences of everything in the archive into one text.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result, ensure};

use super::components::Component;
use super::crates::Crate;

/// Prefixes of the names of licence files, in lower case.
const NAMES: [&str; 6] = ["license", "licence", "copying", "notice", "unlicense", "copyright"];

/// Depth to which a crate's folder is searched for licence files, since C libraries inside a crate
/// have their own licence files.
const DEPTH: usize = 3;

/// Separator between licence texts.
const RULE: &str = "\n-----------------------------------------------------------------------\n";

/// Lists all parts with their licence texts. A text that several parts share appears once.
pub(super) fn text(root: &Path, crates: &[Crate], components: &[Component]) -> Result<String> {
    let mut text = "rollout is licensed under MIT or Apache-2.0, at your option. This archive \
                    contains, beside it:\n\n"
        .to_owned();
    let mut texts: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for part in components {
        let name = format!("{} {}", part.name, part.version);
        let _ = writeln!(text, "{name}: {}", part.licence);
        for text in &part.texts {
            texts.entry(text.clone()).or_default().push(name.clone());
        }
    }
    for part in crates {
        let name = format!("{} {}", part.name, part.version);
        ensure!(!part.licence.is_empty(), "pack {name}: it declares no licence");
        let _ = writeln!(text, "{name}: {}", part.licence);
        let mut found = files(&part.folder, 0)?;
        if found.is_empty() {
            // MIT requires the authors' names, which are in the manifest.
            let authors = match part.authors.as_slice() {
                [] => format!("the authors of {}", part.name),
                authors => authors.join(", "),
            };
            found.push(format!("Copyright {authors}\n\n{}", standard_text(root, &part.licence)?));
        }
        for text in found {
            texts.entry(text).or_default().push(name.clone());
        }
    }
    for (licence, mut names) in texts {
        names.dedup();
        let _ = write!(text, "{RULE}{}{RULE}\n{licence}\n", names.join(", "));
    }
    Ok(text)
}

/// Returns the licence texts in a folder.
fn files(folder: &Path, depth: usize) -> Result<Vec<String>> {
    let mut found = Vec::new();
    let entries = std::fs::read_dir(folder);
    let entries = entries.with_context(|| format!("read {}", folder.display()))?;
    let mut paths: Vec<_> = entries.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
    paths.sort();
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let name = name.to_lowercase();
        if path.is_dir() {
            if depth < DEPTH {
                found.extend(files(&path, depth + 1)?);
            }
        } else if NAMES.iter().any(|prefix| name.starts_with(prefix)) && !name.ends_with(".rs") {
            let bytes = std::fs::read(&path)?;
            found.push(String::from_utf8_lossy(&bytes).trim().replace('\r', ""));
        }
    }
    Ok(found)
}

/// Returns the standard text of a licence that a crate names but does not include.
fn standard_text(root: &Path, licence: &str) -> Result<String> {
    let file = match licence {
        expression if expression.contains("MIT") => "LICENSE-MIT",
        expression if expression.contains("Apache-2.0") => "LICENSE-APACHE",
        "BSD-2-Clause" => return Ok(BSD_2_CLAUSE.to_owned()),
        _ => anyhow::bail!("find the text of {licence}: add it to xtask/src/dist/licences.rs"),
    };
    let text = std::fs::read_to_string(root.join(file))?;
    // Leaves out this project's own copyright line.
    let lines = text.lines().filter(|line| !line.starts_with("Copyright (c)"));
    Ok(lines.collect::<Vec<_>>().join("\n"))
}

/// Licence text from SPDX, without the copyright line.
const BSD_2_CLAUSE: &str = "\
Redistribution and use in source and binary forms, with or without modification, are \
permitted provided that the following conditions are met:

1. Redistributions of source code must retain the above copyright notice, this list of \
conditions and the following disclaimer.

2. Redistributions in binary form must reproduce the above copyright notice, this list of \
conditions and the following disclaimer in the documentation and/or other materials provided \
with the distribution.

THIS SOFTWARE IS PROVIDED BY THE COPYRIGHT HOLDERS AND CONTRIBUTORS \"AS IS\" AND ANY EXPRESS \
OR IMPLIED WARRANTIES, INCLUDING, BUT NOT LIMITED TO, THE IMPLIED WARRANTIES OF \
MERCHANTABILITY AND FITNESS FOR A PARTICULAR PURPOSE ARE DISCLAIMED. IN NO EVENT SHALL THE \
COPYRIGHT HOLDER OR CONTRIBUTORS BE LIABLE FOR ANY DIRECT, INDIRECT, INCIDENTAL, SPECIAL, \
EXEMPLARY, OR CONSEQUENTIAL DAMAGES (INCLUDING, BUT NOT LIMITED TO, PROCUREMENT OF SUBSTITUTE \
GOODS OR SERVICES; LOSS OF USE, DATA, OR PROFITS; OR BUSINESS INTERRUPTION) HOWEVER CAUSED AND \
ON ANY THEORY OF LIABILITY, WHETHER IN CONTRACT, STRICT LIABILITY, OR TORT (INCLUDING \
NEGLIGENCE OR OTHERWISE) ARISING IN ANY WAY OUT OF THE USE OF THIS SOFTWARE, EVEN IF ADVISED OF \
THE POSSIBILITY OF SUCH DAMAGE.
";
