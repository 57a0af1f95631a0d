//! `coordinator campaign list` and `coordinator campaign status`: how campaigns
//! stand, in words and bars. Every line fits 80 columns. Following them live is
//! `watch`'s business.

use clap::Args;
use coordinator::client::{CampaignStatus, State};
use coordinator::ids::shortened;
use coordinator::words::{duration_text, rate_text};

use super::watch::watch;
use super::{CommandError, Connection, print_line};

/// What is said where there are none.
const NO_CAMPAIGNS: &str = "no campaigns yet; `coordinator campaign create` makes one";
/// Width of a line, and of its progress bar where there is room, columns.
const LINE_COLUMNS: usize = 79;
const BAR_COLUMNS: usize = 16;
/// Longest campaign name in a line, bytes.
const NAME_BYTES: usize = 18;

#[derive(Args, Debug)]
pub(super) struct ListArguments {
    #[command(flatten)]
    connection: Connection,
}

#[derive(Args, Debug)]
pub(super) struct StatusArguments {
    /// Name of the campaign; all campaigns without it.
    campaign: Option<String>,
    /// Follow until everything is finished.
    #[arg(long)]
    watch: bool,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn list(arguments: ListArguments) -> Result<(), CommandError> {
    let campaigns = arguments.connection.client()?.list_campaigns().await?;
    if campaigns.is_empty() {
        return Ok(print_line(NO_CAMPAIGNS)?);
    }
    let text: Vec<String> = campaigns
        .iter()
        .map(|status| match attention(status) {
            Some(note) => format!("{}\n  {note}", line(status)),
            None => line(status),
        })
        .collect();
    Ok(print_line(&text.join("\n"))?)
}

pub(super) async fn status(arguments: StatusArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let name = arguments.campaign.as_deref();
    let campaigns = match (arguments.watch, name) {
        (true, name) => watch(&client, name).await?,
        (false, Some(name)) => vec![client.campaign_status(name).await?],
        (false, None) => client.list_campaigns().await?,
    };
    if campaigns.is_empty() {
        return Ok(print_line(NO_CAMPAIGNS)?);
    }
    let text: Vec<String> = campaigns.iter().map(details).collect();
    Ok(print_line(&text.join("\n"))?)
}

/// Whether nothing more will happen by itself.
pub(super) fn is_finished(status: &CampaignStatus) -> bool {
    status.state() == State::Cancelled || status.committed + status.quarantined == status.total
}

/// One line: name, bar, counts, rate, ETA. The bar gets what the rest leaves.
pub(super) fn line(status: &CampaignStatus) -> String {
    let done = status.committed + status.quarantined;
    let percent = (done * 100).checked_div(status.total).unwrap_or(0);
    let pace = if status.state() == State::Cancelled {
        "cancelled".to_owned()
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
    let counts = format!("{done}/{} {percent}%  {pace}", status.total);
    let taken = name.chars().count() + counts.chars().count() + 2;
    let bar_columns = LINE_COLUMNS.saturating_sub(taken).min(BAR_COLUMNS) as u64;
    let filled = (done * bar_columns).checked_div(status.total).unwrap_or(0);
    let bar: String = (0..bar_columns)
        .map(|column| if column < filled { '█' } else { '░' })
        .collect();
    format!("{name} {bar} {counts}")
}

/// What keeps a campaign from going on, or wants to be looked at.
pub(super) fn attention(status: &CampaignStatus) -> Option<String> {
    let mut notes = Vec::new();
    if status.policy_paused {
        notes.push(format!(
            "policy {} is down, its rollouts wait: {}",
            status.policy, status.policy_pause_reason
        ));
    } else if !status.waiting_reason.is_empty() {
        notes.push(status.waiting_reason.clone());
    }
    if !status.mixed_fingerprints.is_empty() {
        notes.push(status.mixed_fingerprints.clone());
    }
    if status.quarantined > 0 {
        notes.push(format!(
            "{} set aside after failing too often: `coordinator jobs list {} --state quarantined`",
            status.quarantined, status.campaign
        ));
    }
    (!notes.is_empty()).then(|| notes.join("; "))
}

/// The whole of it, line by line.
fn details(status: &CampaignStatus) -> String {
    let mut lines = vec![
        line(status),
        format!(
            "  policy       {} at {}",
            status.policy, status.policy_endpoint
        ),
        format!("  committed    {:>7}", status.committed),
        format!("  succeeded    {:>7}", status.succeeded),
        format!("  running      {:>7}", status.leased),
        format!("  waiting      {:>7}", status.queued),
        format!("  set aside    {:>7}", status.quarantined),
        format!("  live workers {:>7}", status.live_workers),
    ];
    lines.extend(attention(status).map(|note| format!("  note         {note}")));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn a_line_fits_eighty_columns_whatever_the_numbers() {
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
        let with = |state: State| CampaignStatus {
            state: state.into(),
            ..running(57, 140)
        };
        assert!(line(&with(State::Paused)).ends_with("40%  paused, 2 running"));
        assert!(line(&with(State::Cancelled)).ends_with("40%  cancelled"));
        assert!(is_finished(&with(State::Cancelled)) && !is_finished(&with(State::Paused)));
    }

    #[test]
    fn a_campaign_without_jobs_divides_by_nothing() {
        let empty = CampaignStatus::default();
        assert!(line(&empty).contains("0/0 0%"));
    }
}
