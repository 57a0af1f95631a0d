//! Searches, shared by `explain` and `thresholds`: campaigns whose next rollouts follow from their
//! outcomes and those of another campaign. This command computes and adds them; it stores nothing,
//! so that it goes on where it was when it is run again.

use std::mem::discriminant;
use std::time::{Duration, Instant};

use anyhow::anyhow;
use benchmark::{
    CampaignSpec, ManifestRow, PolicyRoute, Purpose, Realisation, Record, Rollouts, Wanted,
};
use clap::Args;
use coordinator::client::{Client, Service};
use paired::Outcome;
use proto::coordinator::{AppendRowsRequest, AppendedRow, CreateCampaignRequest};
use queue::read::{CampaignStatus, Stage};
use report::{Prospect, Subject};
use terminal::counted;

use super::command::{CommandError, failure, print_line, usage};
use super::forecast;
use super::line::{line, operator_notes};
use super::watch::LOG_PERIOD;

/// Interval between two requests of a campaign's status.
pub(super) const POLL_INTERVAL: Duration = Duration::from_millis(500);
/// Pause after computing the next rollouts, as a multiple of the time that this took.
pub(super) const PAUSE_PER_COST: u32 = 4;
/// Rows after which a request to add some ends, at the next configuration: the rollouts of a
/// configuration are added together, since its next ones follow from all of them.
const ROWS_PER_REQUEST: usize = 500;

/// A row to be added, and its replicates.
pub(super) type NextRow = (ManifestRow, Vec<u32>);

/// A search to be shown, proposed or run.
pub(super) struct Search<'a> {
    /// Name of the source campaign, from whose outcomes the rollouts follow.
    pub(super) source: &'a str,
    pub(super) name: &'a str,
    /// Subcommand that creates and shows the campaign.
    pub(super) command: &'a str,
    /// Noun for what is sought: `transition` or `threshold`.
    pub(super) sought: &'a str,
    pub(super) purpose: Purpose,
    /// Rollouts to film; `None` stands for the setting of the source campaign.
    pub(super) record: Option<Record>,
    /// True if a missing campaign is an error unless a flag requests its creation or a dry run.
    pub(super) must_exist: bool,
}

/// Flags that determine whether the search is run. Those for a campaign to be created require
/// either of them by the name of this type.
#[derive(Args, Clone, Copy, Debug)]
pub(super) struct CreateFlags {
    /// Create the campaign that runs the rollouts, unless it exists, and add rollouts until nothing
    /// is left to find. If this command is killed, run it again.
    #[arg(long)]
    create: bool,
    /// Print the rollouts and the time that the campaign would take, and create nothing.
    #[arg(long, conflicts_with = "create")]
    dry_run: bool,
}

impl Search<'_> {
    /// Runs or proposes the search as the flags request. `prospect` computes its size from the
    /// source's results, and `next` its next rollouts, from the results so far, the source's
    /// specification and the search's. Returns the results to show; `None` if the search was only
    /// proposed.
    pub(super) async fn run_or_propose(
        &self,
        client: &Client,
        flags: CreateFlags,
        prospect: impl FnOnce(&Subject) -> Result<Prospect, CommandError>,
        next: impl Fn(&Subject, &CampaignSpec) -> anyhow::Result<Vec<NextRow>>,
    ) -> Result<Option<Subject>, CommandError> {
        let exists = self.exists(client).await?;
        let command = format!("coordinator {} {}", self.command, self.source);
        if !flags.create && !flags.dry_run {
            if exists {
                return Ok(Some(client.report(self.name).await?));
            }
            if self.must_exist {
                return Err(failure(anyhow!(
                    "show the results of `{command}`: there is no such campaign yet; \
                     `{command} --create` creates it"
                )));
            }
        }
        if !exists {
            let problem = self.problem(&client.specification(self.source).await?);
            if let Some(problem) = problem {
                return Err(usage(anyhow!("search campaign `{}`: {problem}", self.source)));
            }
        }
        let source = client.campaign_status(self.source).await?;
        let prospect = prospect(&client.report(self.source).await?)?;
        let proposal = self.proposal(client, &source, &prospect).await;
        if !flags.create {
            let hint = format!("nothing was created; `{command} --create` creates the campaign");
            print_line(&format!("{proposal}\n{hint}"))?;
            return Ok(None);
        }
        self.create(client, &source).await?;
        if !exists {
            eprintln!("{proposal}");
        }
        Ok(Some(self.run(client, next).await?))
    }

    /// Returns the reason why the source allows no such search, and the remedy.
    fn problem(&self, source: &CampaignSpec) -> Option<String> {
        if let Some(protocol) = source.rollouts.protocol() {
            return Some(format!(
                "its rows are of protocol {protocol}, which has no axes to explain and no \
                 thresholds; name a campaign of LIBERO-CTRL"
            ));
        }
        // Its outcomes are not final, since it may get further rollouts.
        if let Some(campaign) = source.purpose.as_ref().map(Purpose::source) {
            return Some(format!("it is itself derived from `{campaign}`; name `{campaign}`"));
        }
        let Purpose::Thresholds(thresholds) = &self.purpose else { return None };
        thresholds.check_measurable(&source.rollouts).err().map(|error| error.to_string())
    }

    /// Waits until every rollout of the source that will ever have an outcome has one: only then
    /// are transitions and known radii final. Returns the source's status.
    async fn settled_source(&self, client: &Client) -> Result<CampaignStatus, CommandError> {
        let mut is_reported = false;
        loop {
            let source = client.campaign_status(self.source).await?;
            let (name, open) = (self.source, source.rollouts.queued + source.rollouts.leased);
            let rollouts = counted(open, "rollout");
            match source.state {
                Stage::Stopped => return Ok(source),
                _ if open == 0 => return Ok(source),
                Stage::Cancelled => {
                    return Err(failure(anyhow!(
                        "run `coordinator {} {name}`: campaign {name} was cancelled with \
                         {rollouts} left; name a campaign that is finished",
                        self.command
                    )));
                }
                _ if !is_reported => eprintln!(
                    "campaign {name} has {rollouts} without an outcome; {} starts when it is \
                     finished",
                    self.name
                ),
                _ => {}
            }
            is_reported = true;
            tokio::time::sleep(POLL_INTERVAL).await;
        }
    }

    /// Adds the next rollouts as outcomes arrive, until none is left. Returns the results.
    async fn run(
        &self,
        client: &Client,
        next: impl Fn(&Subject, &CampaignSpec) -> anyhow::Result<Vec<NextRow>>,
    ) -> Result<Subject, CommandError> {
        let source_spec = client.specification(self.source).await?;
        let (mut evaluated, mut shown) = (None, None);
        loop {
            let source = self.settled_source(client).await?;
            let status = client.campaign_status(self.name).await?;
            if status.state == Stage::Cancelled {
                let name = self.name;
                return Err(failure(anyhow!(
                    "add rollouts to campaign `{name}`: it is cancelled, which is final; choose \
                     another name with --name"
                )));
            }
            if shown.is_none_or(|shown: Instant| shown.elapsed() >= LOG_PERIOD) {
                let notes = operator_notes(&status).map_or_else(String::new, |notes| notes + "\n");
                eprintln!("{notes}{}", line(&status));
                shown = Some(Instant::now());
            }
            let settled =
                |status: &CampaignStatus| (status.rollouts.committed, status.rollouts.quarantined);
            let counts = (settled(&source), settled(&status), status.rollouts.total());
            let began = Instant::now();
            if evaluated.replace(counts) != Some(counts) {
                let subject = client.report(self.name).await?;
                let mut of_source = subject.derived.iter().flat_map(|derived| &derived.records);
                let is_open = |record: &paired::Record| record.outcome == Outcome::Missing;
                // A rollout of the source may have been retried meanwhile.
                if !of_source.any(is_open) {
                    let rows = next(&subject, &source_spec)?;
                    if rows.is_empty() && !subject.records.iter().any(is_open) {
                        return Ok(subject);
                    }
                    self.add(client, rows).await?;
                }
            }
            tokio::time::sleep(POLL_INTERVAL.max(began.elapsed() * PAUSE_PER_COST)).await;
        }
    }

    /// Adds rollouts to the campaign, those of one configuration in one request.
    async fn add(&self, client: &Client, rows: Vec<NextRow>) -> Result<(), CommandError> {
        let configuration = |(row, _): &NextRow| (row.id.task(), row.id.number());
        let mut configurations =
            rows.chunk_by(|one, other| configuration(one) == configuration(other)).peekable();
        let mut request =
            AppendRowsRequest { campaign: self.name.to_owned(), ..AppendRowsRequest::default() };
        while let Some(rows) = configurations.next() {
            for (row, replicates) in rows {
                request.rows.push(AppendedRow {
                    manifest_row: serde_json::to_string(row).map_err(anyhow::Error::from)?,
                    replicates: replicates.clone(),
                });
            }
            if request.rows.len() >= ROWS_PER_REQUEST || configurations.peek().is_none() {
                client.call(request.clone(), Service::append_rows).await?;
                request.rows.clear();
            }
        }
        Ok(())
    }

    /// Returns true if a campaign of this name, of the same kind and with the same source exists.
    async fn exists(&self, client: &Client) -> Result<bool, CommandError> {
        let campaigns = client.list_campaigns().await?;
        if !campaigns.iter().any(|status| status.name == self.name) {
            return Ok(false);
        }
        let purpose = client.specification(self.name).await?.purpose;
        Ok(purpose.is_some_and(|purpose| {
            discriminant(&purpose) == discriminant(&self.purpose) && purpose.source() == self.source
        }))
    }

    /// Creates the campaign, unless it exists with the same specification.
    async fn create(&self, client: &Client, source: &CampaignStatus) -> Result<(), CommandError> {
        let CampaignSpec { record, execution, .. } = client.specification(self.source).await?;
        let spec = CampaignSpec {
            name: self.name.to_owned(),
            policy: PolicyRoute { name: source.policy.clone(), endpoint: source.endpoint.clone() },
            rollouts: Rollouts::Rows(Vec::new()),
            purpose: Some(self.purpose.clone()),
            realisation: Realisation::Matched,
            replicates: 1,
            record: self.record.unwrap_or(record),
            wanted: Wanted::default(),
            stop: None,
            execution,
        };
        spec.check().map_err(usage)?;
        let request = CreateCampaignRequest {
            spec: serde_json::to_string(&spec).map_err(anyhow::Error::from)?,
            priority: source.priority,
        };
        client.call(request, Service::create_campaign).await?;
        Ok(())
    }

    async fn proposal(
        &self,
        client: &Client,
        source: &CampaignStatus,
        prospect: &Prospect,
    ) -> String {
        let rollouts = prospect.most_rollouts.iter();
        let rollouts = rollouts.map(|(suite, rollouts)| (suite.name(), *rollouts));
        let forecast = forecast::request_for_suites(client, &source.policy, rollouts).await;
        let open = match source.rollouts.queued + source.rollouts.leased {
            0 => String::new(),
            open => format!(
                ", and more may follow from {} of {} without an outcome",
                counted(open, "rollout"),
                source.name
            ),
        };
        let size = format!(
            "campaign {} takes at most {} for {}{open}",
            self.name,
            counted(prospect.rollouts(), "rollout"),
            counted(prospect.sought, self.sought)
        );
        let size = terminal::wrapped("", 2, &size);
        format!("{size}\n{}", forecast::describe(&forecast, &source.policy))
    }
}
