//! Bill of materials of the archive, as CycloneDX JSON.

use serde_json::{Value, json};

use super::components::Component;
use super::crates::Crate;
use super::release::VERSION;

/// Lists all third-party parts of the archive with version, licence and, for crates, the SHA-256 of
/// the source archive. The list has neither time nor serial number, so that it is reproducible from
/// the commit.
pub(super) fn cyclonedx(crates: &[Crate], components: &[Component]) -> Value {
    let crates = crates.iter().map(|part| {
        let version = part.version.replace('+', "%2B");
        let purl = format!("pkg:cargo/{}@{version}", part.name);
        let mut entry = json!({
            "type": "library", "bom-ref": purl, "name": part.name, "version": part.version,
            "licenses": licence(&part.licence), "purl": purl,
        });
        if let Some(checksum) = &part.checksum {
            entry["hashes"] = json!([{ "alg": "SHA-256", "content": checksum }]);
        }
        entry
    });
    let components: Vec<Value> = components.iter().map(entry).chain(crates).collect();
    json!({
        "$schema": "http://cyclonedx.org/schema/bom-1.5.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": { "component": {
            "type": "application", "bom-ref": "rollout", "name": "rollout", "version": VERSION,
            "licenses": licence("MIT OR Apache-2.0"),
        } },
        "components": components,
    })
}

/// Adds a component to a bill of materials.
pub(super) fn add(bill: &mut Value, component: &Component) {
    if let Some(listed) = bill["components"].as_array_mut() {
        listed.push(entry(component));
    }
}

/// Returns the names of a bill's components.
pub(super) fn names(bill: &Value) -> Vec<&str> {
    let listed = bill["components"].as_array();
    let listed = listed.into_iter().flatten();
    listed.filter_map(|component| component["name"].as_str()).collect()
}

fn entry(part: &Component) -> Value {
    json!({
        "type": "library", "bom-ref": format!("{}@{}", part.name, part.version),
        "name": part.name, "version": part.version, "licenses": licence(part.licence),
    })
}

fn licence(expression: &str) -> Value {
    json!([{ "expression": expression }])
}
