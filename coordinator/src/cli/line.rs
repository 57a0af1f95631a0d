//! Status of a campaign in one line of at most 79 columns, and notes on faults that need the
//! operator.

use coordinator::words::{duration_text, rate_text};
use queue::ids::shortened;
use queue::read::{CampaignStatus, Stage};

/// Width of a line, and greatest width of its progress bar, columns.
const LINE_COLUMNS: usize = 79;
const BAR_COLUMNS: usize = 16;
/// Longest campaign name in a line, bytes.
const NAME_BYTES: usize = 18;

/// Formats name, progress bar, counts, rate and ETA in one line. The bar takes the columns that the
/// text leaves free. Progress counts committed rollouts, not those in quarantine.
pub(super) fn line(status: &CampaignStatus) -> String {
    let rollouts = &status.rollouts;
    let (done, total, running) = (rollouts.committed, rollouts.total(), rollouts.leased);
    let percent = (done * 100).checked_div(total).unwrap_or(0);
    let state_text = if status.state == Stage::Cancelled {
        "cancelled".to_owned()
    } else if status.state == Stage::Stopped {
        "stopped early".to_owned()
    } else if status.is_finished && rollouts.quarantined > 0 {
        format!("finished but for {} in quarantine", rollouts.quarantined)
    } else if total == 0 {
        "no rollouts yet".to_owned()
    } else if status.is_finished {
        "finished".to_owned()
    } else if status.state == Stage::Paused {
        format!("paused, {running} running")
    } else {
        let rate = status.rate_per_sec.map_or("–/s".to_owned(), rate_text);
        let eta = status.remaining_secs.map_or("–".to_owned(), duration_text);
        format!("{running} running  {rate}  ETA {eta}")
    };
    let name = shortened(&status.name, NAME_BYTES);
    let counts = format!("{done}/{total} {percent}%  {state_text}");
    let used_columns = name.chars().count() + counts.chars().count() + 2;
    let bar_columns = LINE_COLUMNS.saturating_sub(used_columns).min(BAR_COLUMNS) as u64;
    let filled = (done * bar_columns).checked_div(total).unwrap_or(0);
    let bar: String =
        (0..bar_columns).map(|column| if column < filled { '█' } else { '░' }).collect();
    format!("{name} {bar} {counts}")
}

/// Describes an early stop and the rollouts that it saved; `None` if the campaign did not stop
/// early.
fn describe_early_stop(status: &CampaignStatus) -> Option<String> {
    let early = status.early_stop.as_ref()?;
    let configurations = [early.used?.into(), early.configurations.into()];
    let rollouts = [status.rollouts.queued, status.rollouts.total()];
    Some(report::describe_early_stop(configurations, &early.stop.rule.to_string(), rollouts))
}

/// Describes the reasons why a campaign makes no progress, an early stop, and faults that need the
/// operator's attention; `None` if there is nothing to describe.
pub(super) fn operator_notes(status: &CampaignStatus) -> Option<String> {
    let mut notes = Vec::new();
    match &status.policy_outage {
        Some(reason) => {
            notes.push(format!("policy `{}` is paused, its rollouts wait: {reason}", status.policy))
        }
        None => notes.extend(status.waiting_reason.clone()),
    }
    notes.extend(describe_early_stop(status));
    notes.extend(status.mixed_fingerprints.clone());
    if status.rollouts.quarantined > 0 {
        notes.push(format!(
            "{} in quarantine (failed too often, or skipped): \
             `coordinator jobs {} --state quarantined`",
            status.rollouts.quarantined, status.name
        ));
    }
    (!notes.is_empty()).then(|| notes.join("; "))
}

#[cfg(test)]
mod tests {
    use benchmark::{Stop, Strata};
    use queue::read::{Counts, EarlyStop};

    use super::*;

    fn running(committed: u64, total: u64) -> CampaignStatus {
        let queued = total - committed - 2;
        CampaignStatus {
            name: "demo".to_owned(),
            rollouts: Counts { committed, leased: 2, queued, ..Counts::default() },
            rate_per_sec: Some(0.42),
            remaining_secs: Some(268.0),
            ..CampaignStatus::default()
        }
    }

    #[test]
    fn a_line_shows_bar_counts_rate_and_eta() {
        assert_eq!(
            line(&running(57, 140)),
            "demo ██████░░░░░░░░░░ 57/140 40%  2 running  25.2/min  ETA 4m28s"
        );
    }

    #[test]
    fn a_line_with_large_numbers_fits_eighty_columns() {
        let mut status = CampaignStatus {
            name: "a-very-long-campaign-name-that-goes-on-and-on".to_owned(),
            rate_per_sec: Some(1_234.5),
            remaining_secs: Some(9e6),
            ..running(123_456, 998_002)
        };
        status.rollouts.leased = 2_000;
        let columns = line(&status).chars().count();
        assert!(columns <= 80, "{columns}: {}", line(&status));
    }

    #[test]
    fn a_paused_or_cancelled_campaign_shows_no_eta() {
        let with = |state| CampaignStatus { state, ..running(57, 140) };
        assert!(line(&with(Stage::Paused)).ends_with("40%  paused, 2 running"));
        assert!(line(&with(Stage::Cancelled)).ends_with("40%  cancelled"));
    }

    #[test]
    fn the_note_of_an_early_stop_gives_configurations_rule_and_saved_rollouts() {
        let rule = "width(I) < 0.2".parse().expect("a rule");
        let stopped = CampaignStatus {
            state: Stage::Stopped,
            rollouts: Counts { committed: 57, queued: 83, ..Counts::default() },
            early_stop: Some(EarlyStop {
                stop: Stop { rule, seed: 0, strata: Strata::Suites },
                configurations: 20,
                used: Some(8),
                saved: Some(83),
            }),
            ..CampaignStatus::default()
        };
        assert!(line(&stopped).ends_with("40%  stopped early"));
        assert_eq!(
            operator_notes(&stopped).expect("a note"),
            "stopped early after 8 of 20 configurations: width(I) < 0.2; saved 83 rollouts (59 %)"
        );
    }

    /// Regression: with 137 of 140 rollouts committed and three in quarantine, the line read
    /// "140/140 100%  finished".
    #[test]
    fn quarantined_rollouts_are_not_progress_and_are_named_at_the_end() {
        let status = CampaignStatus {
            name: "demo".to_owned(),
            is_finished: true,
            rollouts: Counts { committed: 137, quarantined: 3, ..Counts::default() },
            ..CampaignStatus::default()
        };
        assert_eq!(
            line(&status),
            "demo ███████████████░ 137/140 97%  finished but for 3 in quarantine"
        );
        let note = operator_notes(&status).expect("a note");
        assert!(note.contains("coordinator jobs demo --state quarantined"));
    }

    #[test]
    fn the_line_of_a_campaign_without_jobs_shows_0_percent() {
        let empty = CampaignStatus::default();
        assert!(line(&empty).ends_with("0/0 0%  no rollouts yet"));
    }
}
