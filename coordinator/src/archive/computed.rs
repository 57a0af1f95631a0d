//! Members of an archive that are computed from the campaign's rows, and the comparison of such a
//! member in an imported archive with the member computed from the imported rows.

use std::collections::BTreeMap;

use benchmark::attempt::Provenance;
use queue::Portable;
use report::Document;
use serde::Serialize;
use serde_json::Value;

use super::ArchiveError;
use crate::subject;

pub(super) const SPECIFICATION: &str = "specification.json";
pub(super) const PROVENANCE: &str = "provenance.json";
pub(super) const REPORT: &str = "report.json";

/// Names and contents of the computed members.
pub(super) type Computed = [(&'static str, String); 3];

#[derive(Serialize)]
struct Origins {
    /// Machines, programs, assets and policies of the results.
    origins: Vec<Provenance>,
    /// Policy seeds by rollout, one for each replicate.
    policy_seeds: BTreeMap<String, Vec<u64>>,
}

pub(super) async fn compute(from: &Portable) -> Result<Computed, ArchiveError> {
    let mut view = from.view().await?;
    let mut subject = subject::read(&mut view, &from.campaign).await?;
    subject.setups = subject::setups(&mut view, &from.campaign).await?;
    let mut policy_seeds: BTreeMap<String, Vec<u64>> = BTreeMap::new();
    for (rollout, seed) in view.policy_seeds(from.campaign.id).await? {
        policy_seeds.entry(rollout).or_default().push(seed);
    }
    drop(view);
    let origins = Origins { origins: subject.provenances.clone(), policy_seeds };
    let origins = serde_json::to_string_pretty(&origins)
        .map_err(|error| ArchiveError::Json { member: PROVENANCE, source: error.into() })?;
    // Runs on a blocking thread, since it takes thousands of bootstrap resamplings.
    let computed = tokio::task::spawn_blocking(|| Document::new(vec![subject])?.json()).await;
    let report = computed
        .map_err(|_| ArchiveError::Panicked { archive: from.campaign.name.to_string() })??;
    Ok([(SPECIFICATION, from.spec.clone()), (PROVENANCE, origins), (REPORT, report)])
}

/// Returns the path of the first difference between an archived JSON text and a newly computed one;
/// `None` if the two agree. Keys that only the new text has are ignored, since a later release may
/// add keys.
pub(super) fn difference(archived: &str, fresh: &str) -> Option<String> {
    let read = serde_json::from_str::<Value>;
    match (read(archived), read(fresh)) {
        (Ok(archived), Ok(fresh)) => first_difference(&archived, &fresh, ""),
        _ => Some("its beginning, which is not JSON".to_owned()),
    }
}

fn first_difference(archived: &Value, fresh: &Value, place: &str) -> Option<String> {
    match (archived, fresh) {
        (Value::Object(archived), Value::Object(fresh)) => {
            archived.iter().find_map(|(key, value)| {
                let place = format!("{place}.{key}");
                match fresh.get(key) {
                    Some(fresh) => first_difference(value, fresh, &place),
                    None => Some(place),
                }
            })
        }
        (Value::Array(archived), Value::Array(fresh)) if archived.len() == fresh.len() => {
            let mut pairs = archived.iter().zip(fresh).enumerate();
            pairs.find_map(|(index, (archived, fresh))| {
                first_difference(archived, fresh, &format!("{place}[{index}]"))
            })
        }
        _ => (archived != fresh).then(|| match place {
            "" => "its beginning".to_owned(),
            place => place.to_owned(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::difference;

    #[test]
    fn a_difference_is_reported_by_path_and_an_added_key_is_ignored() {
        let archived = r#"{"a": [1, {"b": 2.5}], "c": null}"#;
        assert_eq!(difference(archived, archived), None);
        let more = r#"{"a": [1, {"b": 2.5, "new": 1}], "c": null, "d": 3}"#;
        assert_eq!(difference(archived, more), None);
        for (fresh, place) in [
            (r#"{"a": [1, {"b": 2.6}], "c": null}"#, ".a[1].b"),
            (r#"{"a": [1], "c": null}"#, ".a"),
            (r#"{"a": [1, {"b": 2.5}]}"#, ".c"),
            ("[]", "its beginning"),
            ("nonsense", "its beginning, which is not JSON"),
        ] {
            assert_eq!(difference(archived, fresh).as_deref(), Some(place), "{fresh}");
        }
    }
}
