//! Evaluations by `coordinator up`: check the policies, run a campaign of each, and print their
//! report. Campaigns have fixed names and specifications, so that the same command continues them.

use std::collections::BTreeSet;

use anyhow::{Context, ensure};
use benchmark::{
    CampaignSpec, Design, Execution, ManifestRow, PolicyRoute, Realisation, Record, Rollouts,
    SpecError, TaskRef, Wanted,
};
use clap::Args;
use coordinator::client::{Client, RETRY_FOR, Service};
use paired::{Order, Unit};
use proto::coordinator::{AlterCampaignRequest, CreateCampaignRequest};
use queue::Created;
use queue::expand::NewCampaign;
use report::Document;
use terminal::counted;
use tokio::process::Command;
use transport::Access;

use super::super::command::{CommandError, print_line, usage};
use super::super::create;
use super::super::watch::watch;
use super::{Policy, sibling};

/// `--small` runs one paired unit in this many.
const SMALL: usize = 20;

#[derive(Args, Debug, Default)]
#[command(next_help_heading = "Evaluation")]
pub(super) struct Evaluation {
    /// Run LIBERO's standard evaluation of every policy, 50 rollouts of each task, print the
    /// report and stop. The same command continues an evaluation that was interrupted.
    #[arg(long, conflicts_with_all = ["ctrl", "small"])]
    standard: bool,
    /// Run all of LIBERO-CTRL v0.1 instead: 10,400 rollouts.
    #[arg(long, conflicts_with = "small")]
    ctrl: bool,
    /// Run a random twentieth of LIBERO-CTRL v0.1 instead: of the configurations with all their
    /// conditions, and of the nominal rollouts.
    #[arg(long)]
    small: bool,
    /// Tasks of the evaluation, as for `campaign create`.
    #[arg(long, value_delimiter = ',', default_value = "all")]
    tasks: Vec<String>,
}

impl Evaluation {
    /// Returns the campaign of a policy; `None` if no evaluation is requested.
    pub(super) fn campaign(
        &self,
        policy: &str,
        gateway: &str,
    ) -> Result<Option<NewCampaign>, CommandError> {
        let kinds = [(self.standard, "standard"), (self.ctrl, "ctrl"), (self.small, "small")];
        let Some((_, kind)) = kinds.into_iter().find(|(is_given, _)| *is_given) else {
            return Ok(None);
        };
        let tasks = create::tasks(&self.tasks).map_err(usage)?;
        let mut design = Design { tasks, ..Design::v0_1() }.in_order();
        if self.standard {
            (design.axes, design.levels) = (Vec::new(), Vec::new());
        }
        let rollouts = match self.small {
            true => {
                Rollouts::Rows(twentieth(&design.expand().map_err(SpecError::from).map_err(usage)?))
            }
            false => Rollouts::Design(design),
        };
        let spec = CampaignSpec {
            name: format!("{policy}-{kind}"),
            policy: PolicyRoute { name: policy.to_owned(), endpoint: format!("http://{gateway}") },
            rollouts,
            purpose: None,
            realisation: Realisation::Matched,
            replicates: 1,
            record: Record::None,
            wanted: Wanted::default(),
            stop: None,
            execution: Execution::Wait,
        };
        spec.check().map_err(usage)?;
        NewCampaign::from_spec(&spec).map(Some).map_err(usage)
    }

    /// Runs the requested evaluation of the policies; never returns if none is requested.
    pub(super) async fn run(
        &self,
        policies: &[Policy],
        coordinator: &str,
        gateway: &str,
    ) -> Result<(), CommandError> {
        let client = Client::new(&format!("http://{coordinator}"), &Access::default(), RETRY_FOR)?;
        let url = format!("http://{gateway}");
        let mut names = Vec::new();
        for policy in policies {
            let Some(campaign) = self.campaign(&policy.name, gateway)? else {
                return std::future::pending().await;
            };
            check(&policy.name, gateway).await?;
            let name = campaign.name.to_string();
            let mut existing = client.list_campaigns().await?.into_iter();
            let existing = existing.find(|of| of.name == name && of.policy == policy.name);
            // The gateway may listen elsewhere than when the evaluation was interrupted.
            if existing.is_some_and(|of| of.endpoint != url) {
                let (campaign, policy_endpoint) = (name.clone(), Some(url.clone()));
                let moved =
                    AlterCampaignRequest { campaign, policy_endpoint, ..Default::default() };
                client.call(moved, Service::alter_campaign).await?;
            }
            let request = CreateCampaignRequest { spec: campaign.spec, priority: 0 };
            let created: Created = client.ask(request, Service::create_campaign).await?;
            let verb = if created.jobs_added == 0 { "continues" } else { "begins" };
            let total = counted(created.jobs_total, "rollout");
            print_line(&format!("campaign {name} {verb}: {total}"))?;
            names.push(name);
        }
        let mut subjects = Vec::new();
        for name in &names {
            watch(&client, Some(name)).await?;
            subjects.push(client.report(name).await?);
        }
        let document = Document::new(subjects).map_err(anyhow::Error::from)?;
        Ok(print_line(document.brief().trim_end())?)
    }
}

async fn check(policy: &str, gateway: &str) -> anyhow::Result<()> {
    let mut check = Command::new(sibling("policy-gateway")?);
    check.args(["check", &format!("grpc://{gateway}/{policy}")]).kill_on_drop(true);
    let status = check.status().await.context("start `policy-gateway check`")?;
    ensure!(status.success(), "use policy {policy}: the lines of `policy-gateway check` say why");
    Ok(())
}

/// Selects a random twentieth, at least one, of the paired units with all their rows, and of the
/// nominal rollouts besides those of the selected units: of each suite equally many.
fn twentieth(rows: &[ManifestRow]) -> Vec<ManifestRow> {
    let of_state = |row: &ManifestRow| -> Unit { (row.id.task(), row.init_id) };
    let of_config = |row: &ManifestRow| Some((row.id.task(), row.id.config()?));
    let configs = drawn(rows.iter().filter_map(of_config));
    let mut states = drawn(rows.iter().filter(|row| row.id.config().is_none()).map(of_state));
    let is_drawn = |row: &ManifestRow| of_config(row).is_some_and(|unit| configs.contains(&unit));
    states.extend(rows.iter().filter(|row| is_drawn(row)).map(of_state));
    let selected = |row: &&ManifestRow| match row.id.config() {
        Some(_) => is_drawn(row),
        None => states.contains(&of_state(row)),
    };
    rows.iter().filter(selected).cloned().collect()
}

fn drawn(units: impl Iterator<Item = Unit>) -> BTreeSet<Unit> {
    let units: BTreeSet<Unit> = units.collect();
    let count = units.len().div_ceil(SMALL);
    let order = Order::new(0, units, |(task, _): &(TaskRef, u16)| task.suite());
    order.units().take(count).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evaluations_are_the_protocols_and_a_twentieth_keeps_units_whole() {
        for (kind, rollouts) in
            [("standard", 2_000..=2_000), ("ctrl", 10_400..=10_400), ("small", 520..=540)]
        {
            let evaluation = Evaluation {
                standard: kind == "standard",
                ctrl: kind == "ctrl",
                small: kind == "small",
                tasks: vec!["all".to_owned()],
            };
            let campaign = evaluation.campaign("pi05", "127.0.0.1:7412").ok().flatten();
            let campaign = campaign.expect("a campaign");
            assert_eq!(campaign.name.to_string(), format!("pi05-{kind}"));
            assert!(rollouts.contains(&campaign.jobs.len()), "{kind}: {}", campaign.jobs.len());
        }
        let rows = twentieth(&Design::v0_1().expand().expect("rows"));
        let perturbed = rows.iter().filter(|row| row.id.config().is_some());
        let mut sizes = std::collections::BTreeMap::new();
        for row in perturbed {
            let nominal = |other: &&ManifestRow| {
                other.id.config().is_none()
                    && (other.id.task(), other.init_id) == (row.id.task(), row.init_id)
            };
            assert!(rows.iter().any(|other| nominal(&other)), "{} has its nominal", row.id);
            *sizes.entry((row.id.task(), row.id.config())).or_insert(0) += 1;
        }
        assert_eq!(sizes.len(), 20);
        assert!(sizes.values().all(|size| *size == 21), "{sizes:?}");
        for suite in benchmark::Suite::ALL {
            let of_suite = sizes.keys().filter(|(task, _)| task.suite() == suite).count();
            assert_eq!(of_suite, 5, "{suite}");
        }
    }
}
