//! Keys that commands print as JSON, and keys that docs/JSON.md documents. Shared with the gateway.

use std::collections::BTreeSet;

use serde_json::Value;

/// Returns the documented keys of a command: the first cells of its table's rows.
pub(crate) fn documented(command: &str) -> BTreeSet<String> {
    let page = include_str!("../../../docs/JSON.md");
    let title = format!("## `{command}`");
    let section = page.split("\n## ").find(|part| {
        let first = part.lines().next().unwrap_or_default();
        format!("## {first}").contains(&title)
    });
    let section = section.unwrap_or_else(|| panic!("docs/JSON.md has no section {title}"));
    let key = |line: &str| Some(line.strip_prefix("| `")?.split('`').next()?.to_owned());
    section.lines().filter_map(key).collect()
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
