//! Keys that commands print as JSON, and keys that docs/JSON.md documents. Shared with the gateway.

use std::collections::BTreeSet;

use serde_json::Value;

/// Returns the documented keys of a command: the first cells of its table's rows and, where the
/// meaning begins with "like" another key, the keys below that one.
pub(crate) fn documented(command: &str) -> BTreeSet<String> {
    let page = include_str!("../../../docs/JSON.md");
    let title = format!("## `{command}`");
    let section = page.split("\n## ").find(|part| {
        let first = part.lines().next().unwrap_or_default();
        format!("## {first}").contains(&title)
    });
    let section = section.unwrap_or_else(|| panic!("docs/JSON.md has no section {title}"));
    let rows = |text: &'static str| {
        text.lines().filter_map(|line| line.strip_prefix("| `")?.split_once("` | "))
    };
    let mut keys = BTreeSet::new();
    for (key, meaning) in rows(section) {
        keys.insert(key.to_owned());
        let other = meaning.strip_prefix("like `").and_then(|rest| rest.split('`').next());
        if let Some(other) = other {
            let below =
                rows(page).filter_map(|(name, _)| name.strip_prefix(other)?.strip_prefix('.'));
            let below: Vec<String> = below.map(|name| format!("{key}.{name}")).collect();
            assert!(!below.is_empty(), "docs/JSON.md documents nothing below {other}");
            keys.extend(below);
        }
    }
    keys
}

/// Collects the keys of a value, including nested ones such as `campaigns[].rollouts.total`. Keys
/// of a manifest row are not collected.
pub(crate) fn keys(value: &Value, path: &str, collected: &mut BTreeSet<String>) {
    match value {
        Value::Object(fields) if path != "manifest_row" => {
            for (name, field) in fields {
                let name = match path {
                    "" => name.clone(),
                    path => format!("{path}.{name}"),
                };
                keys(field, &name, collected);
                collected.insert(name);
            }
        }
        Value::Array(items) => {
            for item in items {
                keys(item, &format!("{path}[]"), collected);
            }
        }
        _ => {}
    }
}
