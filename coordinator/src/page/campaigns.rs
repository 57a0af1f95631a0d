//! Start page: every campaign with its progress, and the reason if it makes no progress.

use maud::{Markup, html};
use queue::read::CampaignStatus;
use queue::rules::campaign::CampaignState;

use super::bar::{bar, describe, legend};
use super::compare;
use super::layout::{Sheet, Tab};
use super::problem::Problem;
use super::state::Page;
use crate::words::{duration_text, rate_text};

pub(super) async fn sheet(page: &Page) -> Result<Sheet, Problem> {
    let mut campaigns = page.queue.view().await?.statuses().await?;
    // Newest first, since visitors usually want the campaign that was created last.
    campaigns.reverse();
    let names = campaigns.iter().map(|status| status.campaign.name.to_string());
    let names: Vec<String> = names.collect();
    let main = html! {
        h1 { "Campaigns" }
        (compare::form(&names, [None, None]))
        @if campaigns.is_empty() {
            p {
                "No campaigns yet. " code { "coordinator campaign create" } " makes one: it names \
                a policy, tasks, axes and levels."
            }
        }
        @for status in &campaigns {
            section.campaign aria-label=(status.campaign.name) {
                h2 { a href={ "/campaigns/" (status.campaign.name) } { (status.campaign.name) } }
                (progress(status))
            }
        }
    };
    Ok(Sheet::new(Tab::Campaigns, "Campaigns", main))
}

/// Renders the progress of one campaign: pace, bar, counts, and notes on the reasons why it makes
/// no progress.
pub(super) fn progress(status: &CampaignStatus) -> Markup {
    let counts = &status.counts;
    let done = counts.committed;
    let percent = (done * 100).checked_div(counts.total()).unwrap_or(0);
    html! {
        p.pace {
            strong { (percent) " %" }
            " " (done) " of " (counts.total()) " rollouts"
            " · " (describe_pace(status))
        }
        (bar(counts, &describe(counts)))
        (legend(counts))
        p.muted {
            "Policy " strong { (status.campaign.policy) } " at " code { (status.campaign.endpoint) }
            @if unfinished(status) > 0 { " · " (suitable_workers(status.live_workers)) }
        }
        // Live region for screen readers. The percentage is rounded down to tens, so that they
        // announce few changes.
        p.unseen role="status" { (status.campaign.name) ": " (percent / 10 * 10) " % done" }
        (notes(status))
    }
}

/// Renders notes on the reasons why a campaign makes no progress, and on rollouts in quarantine.
fn notes(status: &CampaignStatus) -> Markup {
    let quarantined = status.counts.quarantined;
    let is_over = status.campaign.state.is_over();
    html! {
        @if !is_over && (status.policy_pause_reason.is_some() || !status.waiting_reason.is_empty()
            || quarantined > 0)
        {
            ul.notes {
                @if let Some(reason) = &status.policy_pause_reason {
                    li {
                        "Policy " (status.campaign.policy) " is paused, and its rollouts wait: "
                        (reason) ". " a href="/policies" { "Policies" } "."
                    }
                } @else if !status.waiting_reason.is_empty() {
                    li { "Nothing is running: " (status.waiting_reason) "." }
                }
                @if quarantined > 0 {
                    li {
                        (quarantined)
                        @if quarantined == 1 { " rollout is" } @else { " rollouts are" }
                        " in quarantine (failed too often, or skipped): "
                        a href={ "/campaigns/" (status.campaign.name) "/rollouts?state=quarantined" } {
                            "list with the errors"
                        }
                        "."
                    }
                }
            }
        }
    }
}

fn describe_pace(status: &CampaignStatus) -> String {
    match status.campaign.state {
        CampaignState::Cancelled { .. } => "cancelled".to_owned(),
        CampaignState::Stopped { .. } => describe_early_stop(status),
        _ if unfinished(status) == 0 && status.counts.quarantined > 0 => {
            format!("finished but for {} in quarantine", status.counts.quarantined)
        }
        _ if unfinished(status) == 0 => "finished".to_owned(),
        CampaignState::Paused { .. } => "paused by its operator".to_owned(),
        CampaignState::Running { .. } => match (status.rate_per_sec, status.eta_secs) {
            (Some(rate), Some(eta)) => {
                format!("{}, {} left at that pace", rate_text(rate), duration_text(eta))
            }
            _ => "no recent result to measure the pace by".to_owned(),
        },
    }
}

/// Describes an early stop and the rollouts that it saved.
fn describe_early_stop(status: &CampaignStatus) -> String {
    let early = status.stop.as_ref();
    let Some((early, used)) = early.and_then(|early| Some((early, early.used?))) else {
        return "stopped early".to_owned();
    };
    let configurations = [used.into(), early.configurations.into()];
    let rollouts = [status.counts.queued, status.counts.total()];
    ::report::describe_early_stop(configurations, &early.stop.rule.to_string(), rollouts)
}

/// Returns the number of queued and leased rollouts.
fn unfinished(status: &CampaignStatus) -> u64 {
    status.counts.queued + status.counts.leased
}

fn suitable_workers(live: u32) -> String {
    match live {
        0 => "no suitable worker".to_owned(),
        1 => "1 suitable worker".to_owned(),
        live => format!("{live} suitable workers"),
    }
}
