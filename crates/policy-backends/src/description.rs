//! Batch size that a description permits, and the differences between two descriptions. Pure
//! functions. `proto::checks` checks descriptions and answers.

use std::collections::BTreeSet;

use benchmark::attempt::CONNECTED_SINCE;
use proto::policy::{DescribeResponse, Language, StateField};
use serde::Serialize;

pub const MAX_BATCH_QUERIES: usize = 64;

/// Returns the batch size for a policy, limited by its description and by the largest message.
pub fn batch_size(described: &DescribeResponse) -> usize {
    let cameras = described.cameras.iter();
    let pixels = cameras.map(|camera| u64::from(camera.width) * u64::from(camera.height));
    // Frames may fill half of a message; the other half is more than enough for the readings.
    let query_bytes = 3 * pixels.sum::<u64>().max(1);
    let fitting = proto::MAX_MESSAGE_BYTES as u64 / 2 / query_bytes;
    let declared = u64::from(described.max_batch).min(MAX_BATCH_QUERIES as u64);
    declared.min(fitting).max(1) as usize
}

/// Field or setting of which two descriptions have different values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DescriptionDifference {
    /// Name of the field or setting, for example "cameras".
    pub what: String,
    pub a: String,
    pub b: String,
}

/// Returns the differences between two descriptions. Ignores the protocol version, batching and the
/// time of connection, which may differ between replicas.
pub fn differences(a: &DescribeResponse, b: &DescribeResponse) -> Vec<DescriptionDifference> {
    let setting = |described: &DescribeResponse, name: &str| {
        let named = described.settings.iter().find(|setting| setting.name == name);
        named.map_or_else(|| "not declared".to_owned(), |setting| setting.value.clone())
    };
    let names = a.settings.iter().chain(&b.settings).map(|setting| setting.name.as_str());
    let names: BTreeSet<&str> = names.filter(|name| *name != CONNECTED_SINCE).collect();
    let settings = names.into_iter().map(|name| (name, setting(a, name), setting(b, name)));
    let fields = fields(a).into_iter().zip(fields(b)).map(|((name, a), (_, b))| (name, a, b));
    let all = fields.chain(settings).filter(|(_, a, b)| a != b);
    all.map(|(what, a, b)| DescriptionDifference { what: what.to_owned(), a, b }).collect()
}

/// Describes the first difference of a description from the expected description; `None` if there
/// is none.
pub fn difference(expected: &DescribeResponse, given: &DescribeResponse) -> Option<String> {
    let DescriptionDifference { what, a, b } = differences(expected, given).into_iter().next()?;
    Some(format!("its {what} is {b:?}, not {a:?}"))
}

fn fields(described: &DescribeResponse) -> [(&'static str, String); 14] {
    let cameras = described.cameras.iter();
    let cameras =
        cameras.map(|camera| format!("{} {} × {}", camera.name, camera.width, camera.height));
    let state = described.state.iter().map(|&field| match StateField::try_from(field) {
        Ok(field) => field.as_str_name().trim_start_matches("STATE_FIELD_").to_owned(),
        Err(_) => field.to_string(),
    });
    let list = |items: Vec<String>| match items.is_empty() {
        true => "none".to_owned(),
        false => items.join(", "),
    };
    let language = match Language::try_from(described.language) {
        Ok(language) => language.as_str_name().trim_start_matches("LANGUAGE_").to_owned(),
        Err(_) => described.language.to_string(),
    };
    [
        ("name", described.name.clone()),
        ("checkpoint digest", described.checkpoint_digest.clone()),
        ("checkpoint", described.checkpoint.clone()),
        ("parameter count", described.parameters.to_string()),
        ("cameras", list(cameras.collect())),
        ("state", list(state.collect())),
        ("horizon", described.horizon.to_string()),
        ("execute", described.execute.to_string()),
        ("language", language),
        ("stateful", described.stateful.to_string()),
        ("stochastic", described.stochastic.to_string()),
        ("seeding", (!described.unseeded).to_string()),
        ("privileged", described.privileged.to_string()),
        ("real-time chunking", described.real_time_chunking.to_string()),
    ]
}

#[cfg(test)]
mod tests {
    use proto::policy::{CameraRequest, Setting};

    use super::*;

    #[test]
    fn every_difference_is_reported_with_both_values() {
        let a = DescribeResponse { horizon: 8, execute: 8, ..DescribeResponse::default() };
        assert_eq!(differences(&a, &a), []);
        let camera = CameraRequest { name: "agentview".to_owned(), width: 224, height: 224 };
        let setting = |name: &str| Setting { name: name.to_owned(), value: "libero".to_owned() };
        let b = DescribeResponse {
            cameras: vec![camera],
            state: vec![StateField::EefPos.into()],
            settings: ["statistics", CONNECTED_SINCE].map(setting).into(),
            execute: 5,
            ..a.clone()
        };
        let found = differences(&a, &b);
        let texts: Vec<String> = found
            .iter()
            .map(|difference| format!("{}: {} / {}", difference.what, difference.a, difference.b))
            .collect();
        let expected = [
            "cameras: none / agentview 224 × 224",
            "state: none / EEF_POS",
            "execute: 8 / 5",
            "statistics: not declared / libero",
        ];
        assert_eq!(texts, expected);
    }
}
