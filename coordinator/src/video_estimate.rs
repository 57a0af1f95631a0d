//! What recording a campaign takes on the disk, estimated before it runs.

use queue::expand::NewCampaign;

/// A control step of a video, bytes: 1.2 to 2.3 thousand in four rollouts of 78
/// to 111 steps (two tasks, the real assets and the built-in ones).
const VIDEO_BYTES_PER_STEP: u64 = 2_300;
/// A control step's action as it is kept, bytes: seven 32-bit numbers.
const ACTION_BYTES_PER_STEP: u64 = 28;
/// Configurations that simultaneous perturbation changed in the paper: 1,417 of 8,400,
/// over seven policies and three levels (table of paired outcomes, b + c).
const CHANGED_IN_THE_PAPER: f64 = 0.17;
/// The most of one policy at one level: 134 of 400.
const MOST_CHANGED_IN_THE_PAPER: f64 = 0.34;

/// What a campaign's videos take, in words; nothing if there are none.
pub fn in_words(campaign: &NewCampaign) -> Option<String> {
    let most = campaign.step_budget * VIDEO_BYTES_PER_STEP;
    match campaign.record {
        "none" => None,
        "transitions" => Some(format!(
            "videos of changed configurations: {} if as many change as in the paper ({:.0} %), {} \
             with the most that changed there; until then up to {} of actions",
            size(most as f64 * CHANGED_IN_THE_PAPER),
            CHANGED_IN_THE_PAPER * 100.0,
            size(most as f64 * MOST_CHANGED_IN_THE_PAPER),
            size((campaign.step_budget * ACTION_BYTES_PER_STEP) as f64),
        )),
        which => Some(format!(
            "videos of {}: up to {}, less for rollouts that reach their goal",
            which.replace("all", "all rollouts"),
            size(most as f64)
        )),
    }
}

/// Bytes, for people.
fn size(bytes: f64) -> String {
    match bytes {
        1e9.. => format!("{:.1} GB", bytes / 1e9),
        _ => format!("{:.0} MB", (bytes / 1e6).max(1.0)),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn check(record: &str, expected: Option<&str>) {
        let spec = json!({
            "name": "filmed",
            "policy": {"name": "p", "endpoint": "http://127.0.0.1:1"},
            "tasks": ["libero_object/0"],
            "axes": ["camera", "sensor"],
            "levels": ["L1"],
            "configs": [0, 1, 2],
            "nominal": "eval",
            "record": record,
        });
        let campaign = NewCampaign::from_json(&spec.to_string()).expect("a campaign");
        assert_eq!(in_words(&campaign).as_deref(), expected);
    }

    #[test]
    fn sizes_follow_from_the_step_budget() {
        // 12 rollouts of at most 280 steps.
        check("none", None);
        check(
            "all",
            Some("videos of all rollouts: up to 8 MB, less for rollouts that reach their goal"),
        );
        check(
            "transitions",
            Some(
                "videos of changed configurations: 1 MB if as many change as in the paper (17 %), \
                 3 MB with the most that changed there; until then up to 1 MB of actions",
            ),
        );
    }
}
