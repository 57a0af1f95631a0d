//! Status of a campaign in one line of at most 79 columns, and notes on faults that need the
//! operator.

use coordinator::words::{duration_text, rate_text};
use proto::coordinator::CampaignStatus;
use proto::coordinator::campaign_status::State;
use queue::ids::shortened;

/// Width of a line, and greatest width of its progress bar, columns.
const LINE_COLUMNS: usize = 79;
const BAR_COLUMNS: usize = 16;
/// Longest campaign name in a line, bytes.
const NAME_BYTES: usize = 18;

/// Returns true if the campaign is cancelled or stopped early, or if every rollout is committed or
/// in quarantine.
pub(super) fn is_finished(status: &CampaignStatus) -> bool {
    let is_over = matches!(status.state(), State::Cancelled | State::Stopped);
    is_over || status.committed + status.quarantined >= status.total
}

/// Formats name, progress bar, counts, rate and ETA in one line. The bar takes the columns that the
/// text leaves free. Progress counts committed rollouts, not those in quarantine.
pub(super) fn line(status: &CampaignStatus) -> String {
    let done = status.committed;
    let percent = (done * 100).checked_div(status.total).unwrap_or(0);
    let state_text = if status.state() == State::Cancelled {
        "cancelled".to_owned()
    } else if status.state() == State::Stopped {
        "stopped early".to_owned()
    } else if is_finished(status) && status.quarantined > 0 {
        format!("finished but for {} in quarantine", status.quarantined)
    } else if status.total == 0 {
        "no rollouts yet".to_owned()
    } else if is_finished(status) {
        "finished".to_owned()
    } else if status.state() == State::Paused {
        format!("paused, {} running", status.leased)
    } else {
        let rate = status.rate_per_sec.map_or("–/s".to_owned(), rate_text);
        let eta = status.eta_secs.map_or("–".to_owned(), duration_text);
        format!("{} running  {rate}  ETA {eta}", status.leased)
    };
    let name = shortened(&status.campaign, NAME_BYTES);
    let counts = format!("{done}/{} {percent}%  {state_text}", status.total);
    let used_columns = name.chars().count() + counts.chars().count() + 2;
    let bar_columns = LINE_COLUMNS.saturating_sub(used_columns).min(BAR_COLUMNS) as u64;
    let filled = (done * bar_columns).checked_div(status.total).unwrap_or(0);
    let bar: String =
        (0..bar_columns).map(|column| if column < filled { '█' } else { '░' }).collect();
    format!("{name} {bar} {counts}")
}

/// Describes an early stop and the rollouts that it saved; `None` if the campaign did not stop
/// early.
fn describe_early_stop(status: &CampaignStatus) -> Option<String> {
    let early = status.early_stop.as_ref()?;
    let configurations = [early.used?.into(), early.configurations.into()];
    let rollouts = [status.queued, status.total];
    Some(report::describe_early_stop(configurations, &early.rule, rollouts))
}

/// Describes the reasons why a campaign makes no progress, an early stop, and faults that need the
/// operator's attention; `None` if there is nothing to describe.
pub(super) fn operator_notes(status: &CampaignStatus) -> Option<String> {
    let mut notes = Vec::new();
    if status.policy_paused {
        notes.push(format!(
            "policy `{}` is paused, its rollouts wait: {}",
            status.policy, status.policy_pause_reason
        ));
    } else if !status.waiting_reason.is_empty() {
        notes.push(status.waiting_reason.clone());
    }
    notes.extend(describe_early_stop(status));
    if !status.mixed_fingerprints.is_empty() {
        notes.push(status.mixed_fingerprints.clone());
    }
    if status.quarantined > 0 {
        notes.push(format!(
            "{} in quarantine (failed too often, or skipped): \
             `coordinator jobs list {} --state quarantined`",
            status.quarantined, status.campaign
        ));
    }
    (!notes.is_empty()).then(|| notes.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::coordinator::campaign_status::EarlyStop;

    fn running(committed: u64, total: u64) -> CampaignStatus {
        CampaignStatus {
            campaign: "demo".to_owned(),
            total,
            committed,
            leased: 2,
            queued: total - committed - 2,
            rate_per_sec: Some(0.42),
            eta_secs: Some(268.0),
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
        let status = CampaignStatus {
            campaign: "a-very-long-campaign-name-that-goes-on-and-on".to_owned(),
            leased: 2_000,
            rate_per_sec: Some(1_234.5),
            eta_secs: Some(9e6),
            ..running(123_456, 1_000_000)
        };
        let columns = line(&status).chars().count();
        assert!(columns <= 80, "{columns}: {}", line(&status));
    }

    #[test]
    fn a_paused_or_cancelled_campaign_shows_no_eta() {
        let with = |state: State| CampaignStatus { state: state.into(), ..running(57, 140) };
        assert!(line(&with(State::Paused)).ends_with("40%  paused, 2 running"));
        assert!(line(&with(State::Cancelled)).ends_with("40%  cancelled"));
        assert!(is_finished(&with(State::Cancelled)) && !is_finished(&with(State::Paused)));
    }

    #[test]
    fn the_note_of_an_early_stop_gives_configurations_rule_and_saved_rollouts() {
        let stopped = CampaignStatus {
            state: State::Stopped.into(),
            leased: 0,
            queued: 83,
            early_stop: Some(EarlyStop {
                rule: "width(I) < 0.2".to_owned(),
                configurations: 20,
                used: Some(8),
                ..EarlyStop::default()
            }),
            ..running(57, 140)
        };
        assert!(is_finished(&stopped));
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
            campaign: "demo".to_owned(),
            total: 140,
            committed: 137,
            quarantined: 3,
            ..CampaignStatus::default()
        };
        assert!(is_finished(&status));
        assert_eq!(
            line(&status),
            "demo ███████████████░ 137/140 97%  finished but for 3 in quarantine"
        );
        let note = operator_notes(&status).expect("a note");
        assert!(note.contains("coordinator jobs list demo --state quarantined"));
    }

    #[test]
    fn the_line_of_a_campaign_without_jobs_shows_0_percent() {
        let empty = CampaignStatus::default();
        assert!(line(&empty).ends_with("0/0 0%  no rollouts yet"));
    }
}
