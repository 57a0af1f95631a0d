//! Metrics in Prometheus' text format, version 0.0.4, read from the database at most once a second.
//! Series are per campaign or policy, never per job, so that their number stays bounded.

use std::fmt::Write;
use std::sync::Arc;

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use queue::read::{CampaignStatus, PolicyLine};
use queue::rules::outage::PolicyState;

use super::problem::Problem;
use super::state::{PAGE_AGE, Page};
use crate::disk::Room;

/// Most campaigns with series of their own; the newest are kept.
pub(super) const MAX_CAMPAIGNS: usize = 200;
/// Most policies with series of their own.
const MAX_POLICIES: usize = 200;

const GAUGE: &str = "gauge";
const COUNTER: &str = "counter";

/// Serves `/metrics`.
pub(super) async fn get(State(page): State<Arc<Page>>) -> Response {
    let cached = page.metrics.get("", |cached| cached.started.elapsed() < PAGE_AGE, collect(&page));
    let kind = "text/plain; version=0.0.4; charset=utf-8";
    let headers = [(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-store")];
    match cached.await {
        Ok(text) => (headers, text.to_string()).into_response(),
        Err(problem) => problem.into_response(),
    }
}

async fn collect(page: &Page) -> Result<Arc<str>, Problem> {
    let queue = &page.queue;
    let mut view = queue.view().await?;
    let campaigns = view.statuses().await?;
    let workers = view.workers().await?;
    let policies = view.policies().await?;
    let endings = view.endings().await?;
    drop(view);
    let mut text = Exposition::default();
    campaign_metrics(&mut text, &campaigns);
    policy_metrics(&mut text, &policies);
    let total_of = |count: fn(&CampaignStatus) -> u64| campaigns.iter().map(count).sum::<u64>();
    let ended = "rollout_attempts_ended_total";
    text.family(ended, COUNTER, "Attempts by ending.");
    let committed = total_of(|status| status.rollouts.committed);
    text.sample(ended, &[("ending", "committed")], committed as f64);
    for (ending, count) in &endings {
        text.sample(ended, &[("ending", ending)], *count as f64);
    }
    let alive = workers.iter().filter(|worker| worker.is_alive);
    let slots: u32 = alive.clone().map(|worker| worker.slots).sum();
    let sizes = queue.store().sizes();
    let free = Room::measure(queue.store().folder(), 0).free_bytes;
    let leased = total_of(|status| status.rollouts.leased) as f64;
    let waiting = page.gauges.claims() as f64;
    let is_held = f64::from(queue.held().is_some());
    let held = "1 while leasing is suspended, for lack of disk space or because the database \
                cannot be written.";
    let streams = page.changes.streams() as f64;
    // One gauge per line.
    #[rustfmt::skip]
    let gauges = [
        ("rollout_leases_held", "Leases that workers hold.", leased),
        ("rollout_claims_waiting", "Claims of workers that are not answered yet.", waiting),
        ("rollout_workers_alive", "Workers with a recent call.", alive.count() as f64),
        ("rollout_worker_slots_alive", "Slots of workers with a recent call.", f64::from(slots)),
        ("rollout_database_bytes", "Size of the database, bytes.", sizes.database as f64),
        ("rollout_database_wal_bytes", "Size of the write-ahead log, bytes.", sizes.log as f64),
        ("rollout_disk_free_bytes", "Free space on the data folder's disk, bytes.", free as f64),
        ("rollout_leasing_held", held, is_held),
        ("rollout_page_streams", "Browsers with an open event stream.", streams),
    ];
    for (name, help, value) in gauges {
        text.single_gauge(name, help, value);
    }
    let build = "rollout_build_info";
    text.family(build, GAUGE, "Version of the program; the value is always 1.");
    text.sample(build, &[("version", env!("CARGO_PKG_VERSION"))], 1.0);
    Ok(text.0.into())
}

fn campaign_metrics(text: &mut Exposition, campaigns: &[CampaignStatus]) {
    let total = campaigns.len();
    text.single_gauge("rollout_campaigns", "Number of campaigns.", total as f64);
    let shown = &campaigns[total.saturating_sub(MAX_CAMPAIGNS)..];
    let jobs = "rollout_jobs";
    text.family(jobs, GAUGE, "Rollouts of a campaign, by state.");
    for status in shown {
        let (name, counts) = (status.name.as_str(), &status.rollouts);
        // The queued jobs of a cancelled or stopped campaign will never run, so they are not
        // counted as queued.
        let (queued, not_run) = match status.state.is_over() {
            true => (0, counts.queued),
            false => (counts.queued, 0),
        };
        for (state, count) in [
            ("queued", queued),
            ("not_run", not_run),
            ("leased", counts.leased),
            ("committed", counts.committed),
            ("quarantined", counts.quarantined),
        ] {
            let labels = [("campaign", name), ("state", state)];
            text.sample(jobs, &labels, count as f64);
        }
    }
    let commits = "rollout_commits_total";
    text.family(commits, COUNTER, "Committed outcomes of a campaign.");
    for status in shown {
        let (name, succeeded) = (status.name.as_str(), status.rollouts.succeeded);
        let failed = status.rollouts.committed.saturating_sub(succeeded);
        for (outcome, count) in [("success", succeeded), ("failure", failed)] {
            let labels = [("campaign", name), ("outcome", outcome)];
            text.sample(commits, &labels, count as f64);
        }
    }
}

fn policy_metrics(text: &mut Exposition, policies: &[PolicyLine]) {
    let help = "1 for the state that a policy is in, else 0: available, paused, probing.";
    text.family("rollout_policy_state", GAUGE, help);
    for policy in policies.iter().take(MAX_POLICIES) {
        let current = match policy.health.state {
            PolicyState::Available => "available",
            PolicyState::Paused { .. } => "paused",
            PolicyState::Probing { .. } => "probing",
        };
        for state in ["available", "paused", "probing"] {
            let labels = [
                ("policy", policy.name.as_str()),
                ("endpoint", policy.endpoint.as_str()),
                ("state", state),
            ];
            text.sample("rollout_policy_state", &labels, f64::from(state == current));
        }
    }
}

/// Exposition text; each family's header precedes its samples.
#[derive(Default)]
struct Exposition(String);

impl Exposition {
    /// Writes the header of a metric family; its samples must follow.
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        self.0.push_str(name);
        for (index, (label, text)) in labels.iter().enumerate() {
            let before = if index == 0 { '{' } else { ',' };
            let _ = write!(self.0, "{before}{label}=\"{}\"", escaped(text));
        }
        let after = if labels.is_empty() { "" } else { "}" };
        let _ = writeln!(self.0, "{after} {value}");
    }

    /// Writes a gauge with a single sample.
    fn single_gauge(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, GAUGE, help);
        self.sample(name, &[], value);
    }
}

/// Escapes a label value.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn label_values_are_escaped() {
        let mut text = Exposition::default();
        text.family("a_total", COUNTER, "Help.");
        text.sample("a_total", &[("b", "x\"} 1\nevil \\"), ("c", "d")], 3.0);
        text.single_gauge("e_bytes", "Size.", 1e12);
        assert_eq!(
            text.0,
            "# HELP a_total Help.\n# TYPE a_total counter\n\
             a_total{b=\"x\\\"} 1\\nevil \\\\\",c=\"d\"} 3\n\
             # HELP e_bytes Size.\n# TYPE e_bytes gauge\ne_bytes 1000000000000\n"
        );
    }
}
