//! Finds import cycles among the files of a crate: sets of files that all use each
//! other, directly or transitively.
//!
//! An import is a path to another file of the crate, in a `use` or anywhere else:
//! `use crate::a::B`, `super::c()`, `child::D`. Re-exports of a file's own children
//! (`pub use child::X`) and code compiled only for tests are ignored.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use proc_macro2::{Delimiter, TokenStream, TokenTree};

/// A module by its path from the crate's root; the root's own path is empty.
type Module = Vec<String>;
/// Items imported by each module, grouped by the module that defines them.
type Imports = BTreeMap<Module, BTreeMap<Module, BTreeSet<String>>>;

/// An import cycle.
pub struct ImportCycle {
    /// Imports within the cycle: importing file, imported file, and items.
    imports: Vec<(String, String, BTreeSet<String>)>,
}

/// Writes a line per import: `a.rs uses B, c of b.rs`.
impl fmt::Display for ImportCycle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (from, to, items) in &self.imports {
            let items: Vec<&str> = items.iter().map(String::as_str).collect();
            writeln!(f, "  {from} uses {} of {to}", items.join(", "))?;
        }
        Ok(())
    }
}

/// Finds the import cycles in a crate's source folder.
///
/// # Errors
/// If a file cannot be read or is not valid Rust.
pub fn import_cycles(src: &Path) -> Result<Vec<ImportCycle>> {
    let files = modules(src)?;
    let mut imports = Imports::new();
    for (module, file) in &files {
        let text = fs::read_to_string(file).with_context(|| format!("read {}", file.display()))?;
        let tokens: TokenStream = text
            .parse()
            .map_err(|error| anyhow::anyhow!("{error}"))
            .with_context(|| format!("read {} as Rust", file.display()))?;
        let mut paths = Vec::new();
        collect(tokens, 0, &mut paths);
        for path in paths {
            let Some((target, item)) = path.resolve(module, &files) else {
                continue;
            };
            let from = imports.entry(module.clone()).or_default();
            from.entry(target).or_default().insert(item);
        }
    }
    let name = |module: &Module| {
        let file = &files[module];
        file.strip_prefix(src).unwrap_or(file).display().to_string()
    };
    Ok(components(&imports)
        .into_iter()
        .map(|members| {
            let edges = members
                .iter()
                .flat_map(|from| imports[from].iter().map(move |(to, items)| (from, to, items)));
            ImportCycle {
                imports: edges
                    .filter(|(_, to, _)| members.contains(*to))
                    .map(|(from, to, items)| (name(from), name(to), items.clone()))
                    .collect(),
            }
        })
        .collect())
}

/// Returns the files of a crate by module. Programs under `bin` are separate crates, as is
/// `main.rs` beside `lib.rs`.
fn modules(src: &Path) -> Result<BTreeMap<Module, PathBuf>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![(src.to_owned(), Module::new())];
    while let Some((folder, module)) = folders.pop() {
        let entries =
            fs::read_dir(&folder).with_context(|| format!("list {}", folder.display()))?;
        for entry in entries {
            let path = entry?.path();
            let stem = path.file_stem().unwrap_or_default().to_string_lossy();
            let child = || [&module[..], &[stem.clone().into_owned()]].concat();
            if path.is_dir() {
                if !(module.is_empty() && stem == "bin") {
                    folders.push((path.clone(), child()));
                }
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let module = match &*stem {
                    "main" if src.join("lib.rs").exists() => continue,
                    "lib" | "main" | "mod" => module.clone(),
                    _ => child(),
                };
                files.insert(module, path);
            }
        }
    }
    Ok(files)
}

/// A path as written in the source.
struct PathUse {
    segments: Vec<String>,
    /// True for a re-export (`pub use`).
    is_reexport: bool,
    /// Number of enclosing inline modules.
    depth: usize,
}

impl PathUse {
    /// Resolves the path from a module to another file and the item used; `None` if it does not
    /// lead to another file, or re-exports an item of a child.
    fn resolve(
        &self,
        module: &Module,
        files: &BTreeMap<Module, PathBuf>,
    ) -> Option<(Module, String)> {
        let supers = self.segments.iter().take_while(|segment| *segment == "super").count();
        let up = module.len().checked_sub(supers.saturating_sub(self.depth));
        let (base, rest) = match self.segments.first()?.as_str() {
            "crate" => (&[][..], &self.segments[1..]),
            "self" => (&module[..], &self.segments[1..]),
            "super" => (&module[..up?], &self.segments[supers..]),
            first => {
                let child = [&module[..], &[first.to_owned()]].concat();
                files.contains_key(&child).then_some(())?;
                (&module[..], &self.segments[..])
            }
        };
        let full_path = [base, rest].concat();
        let length =
            (0..=full_path.len()).rev().find(|length| files.contains_key(&full_path[..*length]))?;
        let target = full_path[..length].to_vec();
        let reexports_child = self.is_reexport && target.starts_with(module);
        if target == *module || reexports_child {
            return None;
        }
        let item = full_path.get(length).cloned();
        Some((target, item.unwrap_or_else(|| "the module".to_owned())))
    }
}

/// Collects the paths in the tokens of a file, inside `depth` inline modules.
fn collect(tokens: TokenStream, depth: usize, paths: &mut Vec<PathUse>) {
    let tokens: Vec<TokenTree> = tokens.into_iter().collect();
    let ident = |at: usize| match tokens.get(at) {
        Some(TokenTree::Ident(ident)) => Some(ident.to_string()),
        _ => None,
    };
    let mut is_reexport = false;
    let mut at = 0;
    while let Some(token) = tokens.get(at) {
        at += 1;
        match token {
            TokenTree::Punct(_) if is_test_only(&tokens[at - 1..]) => {
                at += 1 + item_length(&tokens[at + 1..]);
            }
            TokenTree::Group(group) => {
                let is_module = at >= 3 && ident(at - 3).is_some_and(|word| word == "mod");
                collect(group.stream(), depth + usize::from(is_module), paths);
                // Parentheses may belong to `pub(crate)`.
                is_reexport &= group.delimiter() == Delimiter::Parenthesis;
            }
            TokenTree::Ident(word) if word == "pub" => is_reexport = true,
            TokenTree::Ident(word) if word == "use" => {
                let length = tokens[at..].iter().take_while(|token| !is_punct(token, ';')).count();
                for segments in use_tree(&tokens[at..at + length]) {
                    paths.push(PathUse { segments, is_reexport, depth });
                }
                at += length;
                is_reexport = false;
            }
            TokenTree::Ident(word) => {
                let mut segments = vec![word.to_string()];
                while is_path_separator(&tokens[at..]) {
                    let Some(next) = ident(at + 2) else { break };
                    segments.push(next);
                    at += 3;
                }
                if segments.len() > 1 {
                    paths.push(PathUse { segments, is_reexport: false, depth });
                }
                is_reexport = false;
            }
            _ => is_reexport = false,
        }
    }
}

fn is_punct(token: &TokenTree, punctuation: char) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == punctuation)
}

fn is_path_separator(tokens: &[TokenTree]) -> bool {
    matches!(tokens, [first, second, ..] if is_punct(first, ':') && is_punct(second, ':'))
}

/// Returns true if the tokens start with `#[cfg(test)]`.
fn is_test_only(tokens: &[TokenTree]) -> bool {
    matches!(tokens, [hash, TokenTree::Group(group), ..]
        if is_punct(hash, '#') && group.stream().to_string().replace(' ', "") == "cfg(test)")
}

/// Returns the number of tokens up to the end of an item: its semicolon or braces.
fn item_length(tokens: &[TokenTree]) -> usize {
    let ends = |token: &TokenTree| {
        let braces =
            matches!(token, TokenTree::Group(group) if group.delimiter() == Delimiter::Brace);
        braces || is_punct(token, ';')
    };
    tokens.iter().position(ends).map_or(tokens.len(), |last| last + 1)
}

/// Expands the tokens between `use` and its semicolon to paths.
fn use_tree(tokens: &[TokenTree]) -> Vec<Vec<String>> {
    let branches = tokens.split(|token| is_punct(token, ','));
    branches
        .filter(|branch| !branch.is_empty())
        .flat_map(|branch| {
            let mut prefix = Vec::new();
            let mut inner = None;
            for token in branch {
                match token {
                    TokenTree::Ident(word) if word == "as" => break,
                    TokenTree::Ident(word) => prefix.push(word.to_string()),
                    TokenTree::Group(group) => {
                        let tokens: Vec<TokenTree> = group.stream().into_iter().collect();
                        inner = Some(use_tree(&tokens));
                    }
                    _ => {}
                }
            }
            match inner {
                None => vec![prefix],
                Some(inner) => {
                    inner.into_iter().map(|rest| [&prefix[..], &rest].concat()).collect()
                }
            }
        })
        .collect()
}

/// Returns the strongly connected components with more than one module.
fn components(imports: &Imports) -> Vec<BTreeSet<Module>> {
    let reachable = |from: &Module| {
        let mut visited = BTreeSet::new();
        let mut pending = vec![from];
        while let Some(module) = pending.pop() {
            for next in imports.get(module).into_iter().flat_map(BTreeMap::keys) {
                if visited.insert(next.clone()) {
                    pending.push(next);
                }
            }
        }
        visited
    };
    let reached: BTreeMap<&Module, BTreeSet<Module>> =
        imports.keys().map(|from| (from, reachable(from))).collect();
    let components: BTreeSet<BTreeSet<Module>> = reached
        .iter()
        .map(|(from, targets)| {
            let reaches_back =
                |to: &&Module| reached.get(to).is_some_and(|targets| targets.contains(*from));
            targets.iter().filter(reaches_back).cloned().collect()
        })
        .collect();
    components.into_iter().filter(|members: &BTreeSet<Module>| members.len() > 1).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Finds the import cycles of a crate with the given files.
    fn cycles_among(files: &[(&str, &str)]) -> Vec<String> {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, text) in files {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().expect("a parent")).expect("a folder");
            fs::write(path, text).expect("a file");
        }
        let found = import_cycles(folder.path()).expect("Rust");
        found.iter().map(ImportCycle::to_string).collect()
    }

    #[test]
    fn an_import_cycle_is_found_with_its_files_and_items() {
        let cycles = cycles_among(&[
            ("lib.rs", "mod a; mod b; mod c;\npub use a::A;"),
            ("a.rs", "use crate::b::{B, deep::{C as D, E}};\npub struct A;"),
            ("b.rs", "use super::c;"),
            ("b/deep.rs", "pub struct C; pub struct E;"),
            ("c.rs", "pub fn a() -> crate::a::A { crate::a::A }"),
        ]);
        assert_eq!(
            cycles,
            ["  a.rs uses B of b.rs\n  b.rs uses the module of c.rs\n  c.rs uses A of a.rs\n"]
        );
    }

    #[test]
    fn paths_outside_of_use_and_in_macros_count_as_imports() {
        let cycles = cycles_among(&[
            ("lib.rs", "mod a; mod b;"),
            ("a.rs", r#"fn f() { println!("{}", crate::b::g(1)); }"#),
            ("b.rs", "fn g(x: u8) -> u8 { super::a::h::<u8>(x) }"),
        ]);
        assert_eq!(cycles, ["  a.rs uses g of b.rs\n  b.rs uses h of a.rs\n"]);
    }

    #[test]
    fn a_parent_and_its_child_can_form_a_cycle() {
        let cycles = cycles_among(&[
            ("main.rs", "mod a;"),
            ("a.rs", "mod child; fn f() -> child::C { child::C }"),
            ("a/child.rs", "use super::P; pub struct C;"),
        ]);
        let lines = "  a.rs uses C of a/child.rs\n  a/child.rs uses P of a.rs\n";
        assert_eq!(cycles, [lines]);
    }

    #[test]
    fn reexports_of_children_and_test_code_are_ignored() {
        let cycles = cycles_among(&[
            ("lib.rs", "pub mod a; mod b;\npub use a::child::C;\npub(crate) use b::B;"),
            (
                "a.rs",
                "pub mod child; pub use child::{C, D};
                 // crate::b::B
                 const TEXT: &str = \"crate::b::B\";
                 #[cfg(test)] use crate::b::B;
                 #[cfg(test)] mod tests { use crate::b::B; }
                 fn after() -> other::b::B { self.b.f() }",
            ),
            ("a/child.rs", "use super::P; mod inner { use super::Own; }"),
            ("b.rs", "use crate::a::P; use std::fmt;"),
            ("bin/b.rs", "use crate::a::P;"),
        ]);
        assert_eq!(cycles, [""; 0]);
    }
}
