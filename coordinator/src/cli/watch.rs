//! `coordinator campaign status --watch`: live progress bar, rate and ETA of each campaign.

use std::io::IsTerminal;
use std::time::Duration;

use anyhow::Context;
use coordinator::client::Client;
use queue::read::{CampaignStatus, RATE_WINDOW};

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
    let period = if screen.is_terminal { TERMINAL_PERIOD } else { LOG_PERIOD };
    screen.print(&format!(
        "ETA: rollouts left divided by the rate of the last {} minutes, or of the time\n\
         since the first rollout or the last resume, if that is shorter.",
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
        let mut table: Vec<String> = campaigns.iter().map(line).collect();
        table.extend(describe_filming(filming));
        self.print(&table.join("\n"))?;
        self.lines = table.len();
        Ok(())
    }
}
