//! Disk space and worker time that recording a campaign takes, estimated before it runs.

use queue::expand::NewCampaign;

use crate::words::duration_text;

/// Video size per control step, bytes. Measured: 1.2 to 2.3 thousand in four rollouts of 78 to 111
/// steps (two tasks, the real assets and the built-in ones).
const VIDEO_BYTES_PER_STEP: f64 = 2_300.0;
/// Time to simulate, draw and encode a control step of a video on one core, s: the longest in
/// docs/dev/PERFORMANCE.md, "What a film costs", which is that of sensor corruption.
const FILMING_SECS_PER_STEP: f64 = 0.045;
/// Size of a stored action, bytes: seven 32-bit numbers.
const ACTION_BYTES_PER_STEP: f64 = 28.0;
/// Fraction of configurations whose outcome simultaneous perturbation changed in the paper: 1,417
/// of 8,400 over seven policies and three levels (table of paired outcomes, b + c).
const PAPER_CHANGED_SHARE: f64 = 0.17;
/// Largest fraction of such configurations for one policy at one level: 134 of 400.
const PAPER_MAX_CHANGED_SHARE: f64 = 0.34;

/// Describes the disk space and time of a campaign's videos; `None` if the campaign records no
/// videos.
pub fn describe(campaign: &NewCampaign) -> Option<String> {
    let steps = campaign.step_budget as f64;
    let videos = |share: f64| {
        let secs = steps * share * FILMING_SECS_PER_STEP;
        let bytes = size(steps * share * VIDEO_BYTES_PER_STEP);
        format!("{bytes} and {} of one core", duration_text(secs))
    };
    match campaign.record {
        "none" => None,
        "transitions" => Some(format!(
            "videos of configurations whose outcome changes: up to\n  {} if {:.0} % change, \
             as in the paper;\n  {} if {:.0} % do, the largest share there;\nuntil they \
             are filmed, up to {} of actions",
            videos(PAPER_CHANGED_SHARE),
            PAPER_CHANGED_SHARE * 100.0,
            videos(PAPER_MAX_CHANGED_SHARE),
            PAPER_MAX_CHANGED_SHARE * 100.0,
            size(steps * ACTION_BYTES_PER_STEP),
        )),
        record => Some(format!(
            "videos of {}: up to {},\nless for rollouts that reach their goal",
            record.replace("all", "all rollouts"),
            videos(1.0)
        )),
    }
}

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
        assert_eq!(describe(&campaign).as_deref(), expected);
    }

    #[test]
    fn sizes_and_times_follow_from_the_step_budget() {
        // 12 rollouts of at most 280 steps.
        check("none", None);
        check(
            "all",
            Some(
                "videos of all rollouts: up to 8 MB and 2m31s of one core,\n\
                 less for rollouts that reach their goal",
            ),
        );
        check(
            "transitions",
            Some(
                "videos of configurations whose outcome changes: up to\n  \
                 1 MB and 26s of one core if 17 % change, as in the paper;\n  \
                 3 MB and 51s of one core if 34 % do, the largest share there;\n\
                 until they are filmed, up to 1 MB of actions",
            ),
        );
    }
}
