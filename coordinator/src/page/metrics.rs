//! The state of everything in Prometheus' text format, version 0.0.4. However
//! many ask, it is read from the database at most once a second. No series is
//! for a job: campaigns and policies are the finest there is, and bounded.

use std::fmt::Write;
use std::sync::Arc;

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::problem::Problem;
use super::{PAGE_AGE, Page};
use crate::disk::Room;
use crate::outage::PolicyState;
use crate::queue::CampaignStatus;
use crate::store::page::{self as stored, PolicyLine};

/// Campaigns with series of their own: those that were created last.
pub(super) const MAX_CAMPAIGNS: usize = 200;
/// Policies with series of their own.
const MAX_POLICIES: usize = 200;

/// The metrics.
pub(super) async fn get(State(page): State<Arc<Page>>) -> Response {
    let made = page
        .metrics
        .get("", |made| made.at.elapsed() < PAGE_AGE, collect(&page));
    let headers = [
        (
            header::CONTENT_TYPE,
            "text/plain; version=0.0.4; charset=utf-8",
        ),
        (header::CACHE_CONTROL, "no-store"),
    ];
    match made.await {
        Ok(text) => (headers, text.to_string()).into_response(),
        Err(problem) => problem.into_response(),
    }
}

async fn collect(page: &Page) -> Result<Arc<str>, Problem> {
    let queue = &page.queue;
    let campaigns = queue.list_campaigns().await?;
    let workers = queue.list_workers().await?;
    let mut view = queue.store().read().await?;
    let policies = stored::policies(&mut view).await?;
    let endings = stored::endings(&mut view).await?;
    drop(view);
    let mut text = Exposition::default();
    of_campaigns(&mut text, &campaigns);
    of_policies(&mut text, &policies);
    let committed: u64 = campaigns.iter().map(|status| status.counts.committed).sum();
    text.family(
        "rollout_attempts_ended_total",
        Kind::Counter,
        "Attempts that ended, by how.",
    );
    text.sample(
        "rollout_attempts_ended_total",
        &[("ending", "committed")],
        committed as f64,
    );
    for (ending, count) in &endings {
        text.sample(
            "rollout_attempts_ended_total",
            &[("ending", ending)],
            *count as f64,
        );
    }
    let leased: u64 = campaigns.iter().map(|status| status.counts.leased).sum();
    text.alone(
        "rollout_leases_held",
        "Rollouts that workers hold.",
        leased as f64,
    );
    let claims = page.gauges.claims() as f64;
    text.alone(
        "rollout_claims_waiting",
        "Claims of workers that are not answered yet.",
        claims,
    );
    let alive = workers.iter().filter(|worker| worker.is_alive);
    let slots: u32 = alive.clone().map(|worker| worker.line.slots).sum();
    text.alone(
        "rollout_workers_alive",
        "Workers heard of lately.",
        alive.count() as f64,
    );
    text.alone(
        "rollout_worker_slots_alive",
        "Slots of these workers.",
        f64::from(slots),
    );
    let sizes = queue.store().sizes();
    let free = Room::look(queue.store().folder(), 0).free_bytes;
    text.alone(
        "rollout_database_bytes",
        "Size of the database.",
        sizes.database as f64,
    );
    let log = "Size of the database's write-ahead log.";
    text.alone("rollout_database_wal_bytes", log, sizes.log as f64);
    text.alone(
        "rollout_disk_free_bytes",
        "Free on the data folder's disk.",
        free as f64,
    );
    let held = f64::from(queue.held().is_some());
    text.alone(
        "rollout_leasing_held",
        "1 while nothing is leased for want of disk.",
        held,
    );
    let streams = page.changes.streams() as f64;
    text.alone(
        "rollout_page_streams",
        "Browsers that follow the live page.",
        streams,
    );
    text.family(
        "rollout_build_info",
        Kind::Gauge,
        "The program; its value is 1.",
    );
    text.sample(
        "rollout_build_info",
        &[("version", env!("CARGO_PKG_VERSION"))],
        1.0,
    );
    Ok(text.0.into())
}

fn of_campaigns(text: &mut Exposition, campaigns: &[CampaignStatus]) {
    text.alone(
        "rollout_campaigns",
        "Campaigns that there are.",
        campaigns.len() as f64,
    );
    let shown = &campaigns[campaigns.len().saturating_sub(MAX_CAMPAIGNS)..];
    text.family(
        "rollout_jobs",
        Kind::Gauge,
        "Rollouts of a campaign, by state.",
    );
    for status in shown {
        let counts = &status.counts;
        for (state, count) in [
            ("queued", counts.queued),
            ("leased", counts.leased),
            ("committed", counts.committed),
            ("quarantined", counts.quarantined),
        ] {
            let labels = [("campaign", status.name.as_str()), ("state", state)];
            text.sample("rollout_jobs", &labels, count as f64);
        }
    }
    text.family(
        "rollout_commits_total",
        Kind::Counter,
        "Committed outcomes of a campaign.",
    );
    for status in shown {
        let failed = status
            .counts
            .committed
            .saturating_sub(status.counts.succeeded);
        for (outcome, count) in [("success", status.counts.succeeded), ("failure", failed)] {
            let labels = [("campaign", status.name.as_str()), ("outcome", outcome)];
            text.sample("rollout_commits_total", &labels, count as f64);
        }
    }
}

fn of_policies(text: &mut Exposition, policies: &[PolicyLine]) {
    let help = "1 for the state that a policy is in: available, paused by an outage, probing.";
    text.family("rollout_policy_state", Kind::Gauge, help);
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

/// What a series can do.
#[derive(Clone, Copy)]
enum Kind {
    Gauge,
    Counter,
}

/// The text, family by family.
#[derive(Default)]
struct Exposition(String);

impl Exposition {
    /// Begins a family; its samples follow.
    fn family(&mut self, name: &str, kind: Kind, help: &str) {
        let kind = match kind {
            Kind::Gauge => "gauge",
            Kind::Counter => "counter",
        };
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

    /// A gauge with one sample.
    fn alone(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, Kind::Gauge, help);
        self.sample(name, &[], value);
    }
}

/// The value of a label.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\")
        .replace('"', "\\\"")
        .replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_cannot_break_out_of_its_line() {
        let mut text = Exposition::default();
        text.family("a_total", Kind::Counter, "What.");
        text.sample("a_total", &[("b", "x\"} 1\nevil \\"), ("c", "d")], 3.0);
        text.alone("e_bytes", "Size.", 1e12);
        assert_eq!(
            text.0,
            "# HELP a_total What.\n# TYPE a_total counter\n\
             a_total{b=\"x\\\"} 1\\nevil \\\\\",c=\"d\"} 3\n\
             # HELP e_bytes Size.\n# TYPE e_bytes gauge\ne_bytes 1000000000000\n"
        );
    }
}
