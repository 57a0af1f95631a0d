//! Start page: every campaign with its progress, and the reason if it makes no progress.

use maud::{Markup, html};
use queue::read::{CampaignStatus, Stage};

use super::bar::{bar, describe, legend};
use super::compare;
use super::layout::{Sheet, Tab, table};
use super::problem::Problem;
use super::state::Page;
use crate::words::{duration_text, rate_text};

pub(super) async fn sheet(page: &Page) -> Result<Sheet, Problem> {
    let mut campaigns = page.queue.view().await?.statuses().await?;
    // Newest first, since visitors usually want the campaign that was created last.
    campaigns.reverse();
    let names: Vec<String> = campaigns.iter().map(|status| status.name.clone()).collect();
    // Ended campaigns take a line each, so that a hundred of them leave the others in sight.
    let has_ended = |status: &CampaignStatus| {
        let state = status.state;
        (state.is_over() || state == Stage::Finished) && status.rollouts.quarantined == 0
    };
    let (ended, current): (Vec<_>, Vec<_>) = campaigns.iter().partition(|of| has_ended(of));
    let main = html! {
        h1 { "Campaigns" }
        (compare::form(&names, [None, None]))
        @if campaigns.is_empty() {
            p {
                "No campaigns yet. " code { "coordinator campaign create" } " makes one: it names \
                a policy, tasks, axes and levels."
            }
        }
        @for status in current {
            section.campaign aria-label=(status.name) {
                h2 { a href={ "/campaigns/" (status.name) } { (status.name) } }
                (progress(status))
            }
        }
        @if !ended.is_empty() {
            h2 { "Ended" }
            @let rows = html! { @for status in ended { (row(status)) } };
            (table("Ended campaigns", &["campaign", ".policy", "rollouts", ".state"], &rows))
        }
    };
    Ok(Sheet::new(Tab::Campaigns, "Campaigns", main))
}

/// Renders an ended campaign as a row.
fn row(status: &CampaignStatus) -> Markup {
    html! {
        tr {
            th scope="row" { a href={ "/campaigns/" (status.name) } { (status.name) } }
            td.words { (status.policy) }
            td { (status.rollouts.committed) " of " (status.rollouts.total()) }
            td.words { (describe_pace(status)) }
        }
    }
}

/// Renders the progress of one campaign: pace, bar, counts, and notes on the reasons why it makes
/// no progress.
pub(super) fn progress(status: &CampaignStatus) -> Markup {
    let counts = &status.rollouts;
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
            "Policy " strong { (status.policy) } " at " code { (status.endpoint) }
            @if unfinished(status) > 0 { " · " (suitable_workers(status.live_workers)) }
        }
        // Live region for screen readers. The percentage is rounded down to tens, so that they
        // announce few changes.
        p.unseen role="status" { (status.name) ": " (percent / 10 * 10) " % done" }
        (notes(status))
    }
}

/// Renders notes on the reasons why a campaign makes no progress, and on rollouts in quarantine.
fn notes(status: &CampaignStatus) -> Markup {
    let quarantined = status.rollouts.quarantined;
    html! {
        @if !status.state.is_over() && (status.policy_outage.is_some()
            || status.waiting_reason.is_some() || quarantined > 0)
        {
            ul.notes {
                @if let Some(reason) = &status.policy_outage {
                    li {
                        "Policy " (status.policy) " is paused, and its rollouts wait: "
                        (reason) ". " a href="/policies" { "Policies" } "."
                    }
                } @else if let Some(reason) = &status.waiting_reason {
                    li { "Nothing is running: " (reason) "." }
                }
                @if quarantined > 0 {
                    li {
                        (quarantined)
                        @if quarantined == 1 { " rollout is" } @else { " rollouts are" }
                        " in quarantine (failed too often, or skipped): "
                        a href={ "/campaigns/" (status.name) "/rollouts?state=quarantined" } {
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
    match status.state {
        Stage::Cancelled => "cancelled".to_owned(),
        Stage::Stopped => describe_early_stop(status),
        _ if unfinished(status) == 0 && status.rollouts.quarantined > 0 => {
            format!("finished but for {} in quarantine", status.rollouts.quarantined)
        }
        _ if unfinished(status) == 0 => "finished".to_owned(),
        Stage::Paused => "paused by its operator".to_owned(),
        Stage::Running | Stage::Finished => match (status.rate_per_sec, status.remaining_secs) {
            (Some(rate), Some(eta)) => {
                format!("{}, {} left at that pace", rate_text(rate), duration_text(eta))
            }
            _ => "no recent result to measure the pace by".to_owned(),
        },
    }
}

/// Describes an early stop and the rollouts that it saved.
fn describe_early_stop(status: &CampaignStatus) -> String {
    let early = status.early_stop.as_ref();
    let Some((early, used)) = early.and_then(|early| Some((early, early.used?))) else {
        return "stopped early".to_owned();
    };
    let configurations = [used.into(), early.configurations.into()];
    let rollouts = [status.rollouts.queued, status.rollouts.total()];
    report::describe_early_stop(configurations, &early.stop.rule.to_string(), rollouts)
}

/// Returns the number of queued and leased rollouts.
fn unfinished(status: &CampaignStatus) -> u64 {
    status.rollouts.queued + status.rollouts.leased
}

fn suitable_workers(live: u32) -> String {
    match live {
        0 => "no suitable worker".to_owned(),
        1 => "1 suitable worker".to_owned(),
        live => format!("{live} suitable workers"),
    }
}
