//! `coordinator campaign status --watch`: live progress bar, rate and ETA of each campaign, and of
//! each policy that several campaigns measure.

use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::time::Duration;

use anyhow::Context;
use coordinator::client::Client;
use queue::read::{CampaignStatus, RATE_WINDOW, Stage};

use super::command::{CommandError, print_line};
use super::line::{line, operator_notes};
use super::workers::{describe_filming, filming};

/// Refresh intervals: on a terminal, where the table is redrawn in place, and in a log, to which
/// every refresh adds lines.
const TERMINAL_PERIOD: Duration = Duration::from_secs(1);
pub(super) const LOG_PERIOD: Duration = Duration::from_secs(5);

/// Follows the named campaign, or all campaigns, until they are finished; returns their final
/// status.
pub(super) async fn watch(
    client: &Client,
    name: Option<&str>,
) -> Result<Vec<CampaignStatus>, CommandError> {
    let mut screen = Screen { is_terminal: std::io::stdout().is_terminal(), ..Screen::default() };
    let period = match screen.is_terminal {
        true => TERMINAL_PERIOD,
        false => LOG_PERIOD,
    };
    screen.print(&format!(
        "ETA: rollouts left divided by the rate of the last {} minutes, or of the time\n\
         since the first rollout or the last resume, if that is shorter. The ETA of a\n\
         policy covers all its running campaigns.",
        RATE_WINDOW.as_secs() / 60
    ))?;
    loop {
        let campaigns = match name {
            Some(name) => vec![client.campaign_status(name).await?],
            None => client.list_campaigns().await?,
        };
        screen.show(&campaigns, filming(client).await?)?;
        if campaigns.iter().all(|campaign| campaign.is_finished) {
            return Ok(campaigns);
        }
        tokio::time::sleep(period).await;
    }
}

/// Display of the followed campaigns: a table redrawn in place on a terminal, otherwise further
/// lines at each refresh.
#[derive(Default)]
struct Screen {
    is_terminal: bool,
    /// Number of table lines that the next refresh overwrites.
    lines: usize,
    /// Notes of the last refresh, which are not printed again.
    shown_notes: Vec<String>,
}

impl Screen {
    /// Erases the table and prints lines in its place; `show` draws the table again.
    fn print(&mut self, text: &str) -> anyhow::Result<()> {
        if self.is_terminal && self.lines > 0 {
            terminal::clear_lines(self.lines).context("print to standard output")?;
        }
        self.lines = 0;
        print_line(text)
    }

    /// Draws the table, preceded by the notes that the last refresh did not have.
    fn show(&mut self, campaigns: &[CampaignStatus], filming: u32) -> anyhow::Result<()> {
        let notes: Vec<String> = campaigns.iter().filter_map(operator_notes).collect();
        let shown_notes = std::mem::replace(&mut self.shown_notes, notes.clone());
        for note in notes.iter().filter(|note| !shown_notes.contains(note)) {
            self.print(note)?;
        }
        let mut table = table(campaigns);
        table.extend(describe_filming(filming));
        self.print(&table.join("\n"))?;
        self.lines = table.len();
        Ok(())
    }
}

/// Returns a line per campaign, then one per policy that several campaigns measure.
fn table(campaigns: &[CampaignStatus]) -> Vec<String> {
    let mut policies: BTreeMap<(&str, &str), Vec<&CampaignStatus>> = BTreeMap::new();
    // Cancelled and stopped campaigns never continue, so a policy's total leaves them out.
    let can_continue = |status: &&CampaignStatus| !status.state.is_over();
    for status in campaigns.iter().filter(can_continue) {
        let policy = (status.endpoint.as_str(), status.policy.as_str());
        policies.entry(policy).or_default().push(status);
    }
    let shared = policies.values().filter(|campaigns| campaigns.len() > 1);
    let totals = shared.map(|campaigns| line(&sum_policy(campaigns)));
    campaigns.iter().map(line).chain(totals).collect()
}

/// Sums the campaigns of a policy, none of them cancelled or stopped. The queued rollouts of paused
/// campaigns are left out of the ETA.
fn sum_policy(campaigns: &[&CampaignStatus]) -> CampaignStatus {
    let mut sum = CampaignStatus::default();
    let mut paused = 0;
    sum.is_finished = true;
    for status in campaigns {
        sum.name = format!("all of {}", status.policy);
        sum.is_finished &= status.is_finished;
        sum.rollouts.leased += status.rollouts.leased;
        sum.rollouts.committed += status.rollouts.committed;
        sum.rollouts.quarantined += status.rollouts.quarantined;
        sum.rollouts.queued += status.rollouts.queued;
        if status.state == Stage::Paused {
            paused += status.rollouts.queued;
        }
        if let Some(rate) = status.rate_per_sec {
            sum.rate_per_sec = Some(sum.rate_per_sec.unwrap_or(0.0) + rate);
        }
    }
    let unfinished = sum.rollouts.queued - paused + sum.rollouts.leased;
    if unfinished == 0 {
        // Any rollouts left belong to paused campaigns.
        sum.state = Stage::Paused;
    } else {
        sum.remaining_secs = sum.rate_per_sec.map(|rate| unfinished as f64 / rate);
    }
    sum
}

#[cfg(test)]
mod tests {
    use queue::read::Counts;

    use super::*;

    fn campaign(name: &str, policy: &str) -> CampaignStatus {
        CampaignStatus {
            name: name.to_owned(),
            policy: policy.to_owned(),
            rollouts: Counts { queued: 49, leased: 1, committed: 50, ..Counts::default() },
            rate_per_sec: Some(0.5),
            remaining_secs: Some(100.0),
            ..CampaignStatus::default()
        }
    }

    #[test]
    fn a_policy_of_several_campaigns_has_a_line_and_an_eta_of_its_own() {
        let table = table(&[
            campaign("one", "expert"),
            campaign("two", "expert"),
            campaign("three", "servo"),
        ]);
        assert_eq!(table.len(), 4);
        assert_eq!(
            table[3],
            "all of expert ████████░░░░░░░░ 100/200 50%  2 running  1.0/s  ETA 1m40s"
        );
    }

    /// Regression: "all of expert 2176/13875 … ETA 0s" while only cancelled campaigns had rollouts
    /// left.
    #[test]
    fn cancelled_campaigns_are_left_out_of_a_policys_total() {
        let in_state = |name: &str, state| CampaignStatus { state, ..campaign(name, "expert") };
        let cancelled = in_state("cancelled", Stage::Cancelled);
        let running = in_state("one", Stage::Running);
        assert_eq!(table(&[running.clone(), cancelled.clone()]).len(), 2);
        let lines = table(&[running.clone(), cancelled, running]);
        assert!(lines[3].contains("100/200 50%"), "{}", lines[3]);
    }

    #[test]
    fn a_policy_whose_campaigns_are_all_paused_or_finished_shows_no_eta() {
        let paused = CampaignStatus {
            state: Stage::Paused,
            rollouts: Counts { queued: 50, committed: 50, ..Counts::default() },
            rate_per_sec: None,
            remaining_secs: None,
            ..campaign("paused", "expert")
        };
        let finished = CampaignStatus {
            is_finished: true,
            rollouts: Counts { committed: 100, ..Counts::default() },
            ..campaign("finished", "expert")
        };
        let lines = table(&[paused, finished.clone()]);
        assert!(lines[2].ends_with("150/200 75%  paused, 0 running"), "{}", lines[2]);
        let lines = table(&[finished.clone(), finished]);
        assert!(lines[2].ends_with("200/200 100%  finished"), "{}", lines[2]);
    }

    #[test]
    fn queued_rollouts_count_into_a_policys_eta_unless_paused() {
        let idle = |state| CampaignStatus {
            rate_per_sec: None,
            remaining_secs: None,
            rollouts: Counts { queued: 49, committed: 50, ..Counts::default() },
            state,
            ..campaign("idle", "expert")
        };
        let eta = |other| sum_policy(&[&campaign("one", "expert"), &other]).remaining_secs;
        assert_eq!(eta(idle(Stage::Running)), Some(198.0));
        assert_eq!(eta(idle(Stage::Paused)), Some(100.0));
    }
}
