//! Pages of the workers, of the policies and their health, and of the quarantine.

use maud::{Markup, html};
use queue::clock::UnixMillis;
use queue::read::{PolicyLine, QuarantinedLine, WorkerLine};
use queue::rules::outage::PolicyState;
use terminal::counted;

use super::campaign::rollout;
use super::layout::{self, Sheet, Tab};
use super::problem::Problem;
use super::state::Page;
use crate::words::{duration_text, runs_on};

/// Most quarantined rollouts shown.
const MAX_QUARANTINED: u32 = 500;
/// Most departed workers shown.
const MAX_DEPARTED: usize = 20;

pub(super) async fn workers(page: &Page) -> Result<Sheet, Problem> {
    let mut view = page.queue.view().await?;
    let (workers, now) = (view.workers().await?, view.now);
    let (alive, departed): (Vec<_>, Vec<_>) =
        workers.into_iter().partition(|worker| worker.is_alive);
    let latest = &departed[..departed.len().min(MAX_DEPARTED)];
    let main = html! {
        h1 { "Workers" }
        @if alive.is_empty() {
            p { "No worker is alive. " code { "worker --connect" } " with this address starts one." }
        } @else {
            (workers_table("Workers that are alive", &alive, now))
        }
        @if !departed.is_empty() {
            h2 { "Departed" }
            p.muted {
                "The rollouts of departed workers are leased to others."
                @if latest.len() < departed.len() {
                    " The " (latest.len()) " of " (departed.len()) " with the latest calls:"
                }
            }
            (workers_table("Departed workers", latest, now))
        }
    };
    Ok(Sheet::new(Tab::Workers, "Workers", main))
}

pub(super) async fn policies(page: &Page) -> Result<Sheet, Problem> {
    let mut view = page.queue.view().await?;
    let (policies, now) = (view.policies().await?, view.now);
    let main = html! {
        h1 { "Policies" }
        @if policies.is_empty() { p { "No campaign has named a policy yet." } }
        @for policy in &policies { (policy_section(policy, now)) }
    };
    Ok(Sheet::new(Tab::Policies, "Policies", main))
}

/// Renders the page of the quarantined rollouts of all campaigns.
pub(super) async fn quarantine(page: &Page) -> Result<Sheet, Problem> {
    let quarantined = page.queue.view().await?.quarantine(None, MAX_QUARANTINED).await?;
    let main = html! {
        h1 { "Quarantine" }
        @if quarantined.is_empty() {
            p { "Nothing is in quarantine." }
        } @else {
            p {
                "These rollouts were charged with too many attempts that ended without an outcome \
                (through the machine, the simulator, or answers of the policy that broke the \
                protocol), took their policy or their workers down, or were skipped. Rates leave \
                them out; the report gives bounds on the measures. "
                code { "coordinator jobs CAMPAIGN ROLLOUT --retry" } " retries a rollout."
            }
            @if quarantined.len() >= MAX_QUARANTINED as usize {
                p { "The first " (MAX_QUARANTINED) " rollouts are shown." }
            }
            (quarantine_table(&quarantined))
        }
    };
    Ok(Sheet::new(Tab::Quarantine, "Quarantine", main))
}

fn workers_table(name: &str, workers: &[WorkerLine], now: UnixMillis) -> Markup {
    let columns = ["worker", "machine", "busy", "last call", ".state", ".runs on"];
    let rows = html! { @for worker in workers { (worker_row(worker, now)) } };
    layout::table(name, &columns, &rows)
}

fn worker_row(line: &WorkerLine, now: UnixMillis) -> Markup {
    let silent = now.since(line.last_call_at).as_secs_f64();
    html! {
        tr {
            th scope="row" { code { (line.worker_id) } }
            td { (line.host) }
            td {
                (line.leases) " of " (line.slots)
                @if let Some(rollouts) = line.filming { ", filming " (rollouts) }
            }
            td { (duration_text(silent)) " ago" }
            td.words {
                @match &line.stopped_reason {
                    Some(reason) => { "gets no more leases: " (reason) }
                    None if line.failures_in_a_row > 0 => {
                        (counted(line.failures_in_a_row.into(), "failure")) " in a row"
                    }
                    None if line.is_alive => "healthy",
                    None if line.has_signed_off => "ended",
                    None => "gone",
                }
            }
            td.words {
                (runs_on(
                    &line.asset_pack,
                    &line.mujoco_version,
                    &line.renderer,
                    &line.look,
                    &line.program_version,
                ))
            }
        }
    }
}

fn policy_section(policy: &PolicyLine, now: UnixMillis) -> Markup {
    let (class, word) = match &policy.health.state {
        PolicyState::Available if policy.health.misbehaved > 0 => ("failed", "failing"),
        PolicyState::Available => ("succeeded", "available"),
        PolicyState::Paused { .. } => ("failed", "paused"),
        PolicyState::Probing { .. } => ("running", "being tried"),
    };
    html! {
        section.campaign aria-label=(policy.name) {
            h2 { (policy.name) " " span class={ "badge " (class) } { (word) } }
            p.muted { "at " code { (policy.endpoint) } }
            @match &policy.health.state {
                PolicyState::Available => {},
                PolicyState::Paused { resume, reason } => {
                    p {
                        "Its rollouts wait. " (charges(policy.health.misbehaved)) " It is tried again "
                        @if *resume > now { "in " (duration_text(resume.since(now).as_secs_f64())) }
                        @else { "by the next rollout that a worker claims" }
                        ". Pauses since its last result: " (policy.health.outages)
                        ". Its last error: "
                    }
                    pre { (reason) }
                },
                PolicyState::Probing { reason, .. } => {
                    p { "One rollout is trying the policy; the others wait. The reason: " }
                    pre { (reason) }
                },
            }
            p {
                @if policy.campaigns.is_empty() { "No campaign measures this policy" }
                @else { "Campaigns that measure it: " }
                @for (index, campaign) in policy.campaigns.iter().enumerate() {
                    @if index > 0 { ", " }
                    a href={ "/campaigns/" (campaign) } { (campaign) }
                }
                "."
            }
        }
    }
}

/// Describes the attempts charged to a paused policy's rollouts. `misbehaved` counts the attempts
/// since its last result in which the policy broke the protocol.
fn charges(misbehaved: u32) -> String {
    match misbehaved {
        0 => "An attempt that cannot reach the policy is not charged.".to_owned(),
        attempts => format!(
            "Its answers broke the protocol in {} since its last result, each of which is charged \
             to its rollout; an attempt that cannot reach the policy is not charged.",
            counted(attempts.into(), "attempt")
        ),
    }
}

fn quarantine_table(lines: &[QuarantinedLine]) -> Markup {
    let rows = html! {
        @for line in lines {
            tr {
                th scope="row" { (rollout(line.campaign.as_str(), &line.rollout_id, line.replicate)) }
                td.words { a href={ "/campaigns/" (line.campaign) } { (line.campaign) } }
                td { (line.charged_attempts) }
                td.words { pre { (line.last_error) } }
            }
        }
    };
    let columns = ["rollout", ".campaign", "charges", ".last error"];
    layout::table("Quarantined rollouts", &columns, &rows)
}
