//! Differences between two servers' descriptions. Pure functions.

use proto::policy::{DescribeResponse, Language};
use serde::Serialize;

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DescriptionDifference {
    /// Name of the field or setting, for example "cameras".
    pub what: String,
    pub a: String,
    pub b: String,
}

/// Returns all differences between descriptions that can affect actions.
pub(crate) fn differences(
    a: &DescribeResponse,
    b: &DescribeResponse,
) -> Vec<DescriptionDifference> {
    let sides = fields(a).into_iter().zip(fields(b));
    let mut differences: Vec<DescriptionDifference> = sides
        .filter(|((_, a), (_, b))| a != b)
        .map(|((what, a), (_, b))| DescriptionDifference { what: what.to_owned(), a, b })
        .collect();
    let setting = |described: &DescribeResponse, name: &str| {
        let setting = described.settings.iter().find(|setting| setting.name == name);
        setting.map_or_else(|| "not declared".to_owned(), |setting| setting.value.clone())
    };
    let mut names: Vec<&str> = [a, b]
        .iter()
        .flat_map(|description| description.settings.iter().map(|setting| setting.name.as_str()))
        .collect();
    names.sort_unstable();
    names.dedup();
    for name in names {
        let (a, b) = (setting(a, name), setting(b, name));
        if a != b {
            let what = name.to_owned();
            differences.push(DescriptionDifference { what, a, b });
        }
    }
    differences
}

/// Returns the names and values of the compared fields, except the settings.
fn fields(described: &DescribeResponse) -> [(&'static str, String); 9] {
    let yes_or_no = |flag: bool| if flag { "yes" } else { "no" }.to_owned();
    let cameras = described.cameras.iter();
    let cameras: Vec<String> = cameras
        .map(|camera| format!("{} {} × {}", camera.name, camera.width, camera.height))
        .collect();
    let state: Vec<&str> = described
        .state()
        .map(|field| field.as_str_name().trim_start_matches("STATE_FIELD_"))
        .collect();
    let language = match described.language() {
        Language::FreeForm => "any instruction",
        Language::CanonicalOnly => "canonical instructions only",
        Language::Ignored => "ignored",
        Language::Unspecified => "not declared",
    };
    [
        ("cameras", or_none(cameras.join(", "))),
        ("state", or_none(state.join(", "))),
        ("actions per answer", described.horizon.to_string()),
        ("actions executed per answer", described.execute.to_string()),
        ("language", language.to_owned()),
        ("keeps state within an episode", yes_or_no(described.stateful)),
        ("draws random numbers", yes_or_no(described.stochastic)),
        ("takes a seed", yes_or_no(!described.unseeded)),
        ("receives the simulator's state", yes_or_no(described.privileged)),
    ]
}

fn or_none(list: String) -> String {
    match list.is_empty() {
        true => "none".to_owned(),
        false => list,
    }
}

#[cfg(test)]
mod tests {
    use proto::policy::{CameraRequest, Setting, StateField};

    use super::*;

    #[test]
    fn every_difference_is_reported_with_both_values() {
        let a = DescribeResponse { horizon: 8, execute: 8, ..DescribeResponse::default() };
        assert_eq!(differences(&a, &a), []);
        let camera = CameraRequest { name: "agentview".to_owned(), width: 224, height: 224 };
        let setting = Setting { name: "statistics".to_owned(), value: "libero".to_owned() };
        let b = DescribeResponse {
            cameras: vec![camera],
            state: vec![StateField::EefPos.into()],
            settings: vec![setting],
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
            "actions executed per answer: 8 / 5",
            "statistics: not declared / libero",
        ];
        assert_eq!(texts, expected);
    }
}
