//! Derived campaigns, whose rollouts follow from the outcomes of another campaign: lookup,
//! creation and progress, shared by `explain` and `thresholds`.

use std::mem::discriminant;
use std::time::Duration;

use anyhow::anyhow;
use clap::Args;
use coordinator::client::{Client, Service};
use libero_ctrl::{CampaignSpec, PolicyRoute, Realisation, Record, Rollouts, Wanted};
use proto::coordinator::campaign_status::State;
use proto::coordinator::{CampaignStatus, CreateCampaignRequest, GetCampaignRequest};
use report::{Prospect, Subject};
use terminal::counted;

use super::command::{CommandError, failure, print_line, usage};
use super::forecast;

/// Interval between two fetches of the findings.
const POLL_INTERVAL: Duration = Duration::from_secs(2);

/// Derived campaign to be shown, proposed or created.
pub(super) struct DerivedCampaign<'a> {
    /// Name of the source campaign, from whose outcomes the rollouts follow.
    pub(super) source: &'a str,
    pub(super) name: &'a str,
    /// Subcommand that creates and shows the campaign.
    pub(super) command: &'a str,
    /// Singular noun for the items that the campaign explains or measures: `transition` or
    /// `threshold`.
    pub(super) subject: &'a str,
    pub(super) rollouts: Rollouts,
    /// Rollouts to film; `None` stands for the setting of the source campaign.
    pub(super) record: Option<Record>,
    /// True if flags were given that apply only to a campaign to be created.
    pub(super) has_creation_flags: bool,
    /// True if a missing campaign is an error unless a flag requests its creation or a dry run.
    pub(super) must_exist: bool,
}

/// Flags that determine whether the campaign is created.
#[derive(Args, Clone, Copy, Debug)]
pub(super) struct CreateFlags {
    /// Create the campaign that runs the rollouts, unless it exists.
    #[arg(long)]
    create: bool,
    /// Print the rollouts and the time that the campaign would take, and create nothing.
    #[arg(long, conflicts_with = "create")]
    dry_run: bool,
}

impl DerivedCampaign<'_> {
    /// Creates or proposes the campaign as the flags request; `prospect` computes the campaign's
    /// size from the source's results. Returns false if the campaign was only proposed, so that
    /// there are no findings to show.
    pub(super) async fn create_or_propose(
        &self,
        client: &Client,
        flags: CreateFlags,
        prospect: impl FnOnce(&Subject) -> Result<Prospect, CommandError>,
    ) -> Result<bool, CommandError> {
        let exists = self.exists(client).await?;
        let command = format!("coordinator {} {}", self.command, self.source);
        if !flags.create && !flags.dry_run {
            if self.has_creation_flags {
                return Err(usage(anyhow!(
                    "read `{command}`: flags for a campaign to be created need --create, or \
                     --dry-run to print its size"
                )));
            }
            if exists {
                return Ok(true);
            }
            if self.must_exist {
                return Err(failure(anyhow!(
                    "show the results of `{command}`: there is no such campaign yet; \
                     `{command} --create` creates it"
                )));
            }
        }
        if !exists && let Some(first) = spec(client, self.source).await?.rollouts.source() {
            return Err(failure(anyhow!(
                "derive a campaign from `{0}`: `{0}` is itself derived from `{first}`; name \
                 `{first}`",
                self.source
            )));
        }
        let source = client.campaign_status(self.source).await?;
        let prospect = prospect(&client.report(self.source).await?)?;
        let proposal = self.proposal(client, &source, &prospect).await;
        if !flags.create {
            let hint = format!("nothing was created; `{command} --create` creates the campaign");
            print_line(&format!("{proposal}\n{hint}"))?;
            return Ok(false);
        }
        self.create(client, &source).await?;
        if !exists {
            eprintln!("{proposal}");
        }
        Ok(true)
    }

    /// Returns true if a campaign of this name, of the same kind and with the same source exists.
    async fn exists(&self, client: &Client) -> Result<bool, CommandError> {
        let campaigns = client.list_campaigns().await?;
        if !campaigns.iter().any(|status| status.campaign == self.name) {
            return Ok(false);
        }
        let rollouts = spec(client, self.name).await?.rollouts;
        let is_same_kind = discriminant(&rollouts) == discriminant(&self.rollouts);
        Ok(is_same_kind && rollouts.source() == Some(self.source))
    }

    /// Creates the campaign, unless it exists with the same specification.
    async fn create(&self, client: &Client, source: &CampaignStatus) -> Result<(), CommandError> {
        let CampaignSpec { record, execution, .. } = spec(client, self.source).await?;
        let spec = CampaignSpec {
            name: self.name.to_owned(),
            policy: PolicyRoute {
                name: source.policy.clone(),
                endpoint: source.policy_endpoint.clone(),
            },
            rollouts: self.rollouts.clone(),
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
        let open = source.queued + source.leased;
        if open > 0 && source.state() != State::Stopped {
            eprintln!(
                "campaign {} has {} without an outcome; {} starts when {0} is finished",
                source.campaign,
                counted(open, "rollout"),
                self.name
            );
        }
        Ok(())
    }

    /// Describes the number of rollouts and a forecast of their duration.
    async fn proposal(
        &self,
        client: &Client,
        source: &CampaignStatus,
        prospect: &Prospect,
    ) -> String {
        let rollouts = prospect.most_rollouts.iter();
        let rollouts = rollouts.map(|(suite, rollouts)| (suite.name(), *rollouts));
        let forecast = forecast::request_for_suites(client, &source.policy, rollouts, None).await;
        let open = match source.queued + source.leased {
            0 => String::new(),
            open => format!(
                ", and more may follow from {} of {} without an outcome",
                counted(open, "rollout"),
                source.campaign
            ),
        };
        let size = format!(
            "campaign {} takes at most {} for {}{open}",
            self.name,
            counted(prospect.rollouts(), "rollout"),
            counted(prospect.subjects, self.subject)
        );
        let size = terminal::wrapped("", 2, &size);
        format!("{size}\n{}", forecast::describe(&forecast, &source.policy))
    }
}

/// Returns the specification of a campaign.
async fn spec(client: &Client, name: &str) -> Result<CampaignSpec, CommandError> {
    let request = GetCampaignRequest { campaign: name.to_owned() };
    let answer = client.call(request, Service::get_campaign).await?;
    CampaignSpec::from_json(&answer.spec).map_err(usage)
}

/// Fetches the findings once or, with `until_complete`, polls until they are complete. Prints the
/// first line of their text to standard error whenever it changes.
pub(super) async fn poll_findings<T>(
    until_complete: bool,
    fetch: impl AsyncFn() -> Result<T, CommandError>,
    is_complete: impl Fn(&T) -> bool,
    text: impl Fn(&T) -> String,
) -> Result<T, CommandError> {
    let mut printed = String::new();
    loop {
        let findings = fetch().await?;
        if !until_complete || is_complete(&findings) {
            return Ok(findings);
        }
        let text = text(&findings);
        let summary = text.lines().next().unwrap_or_default();
        if summary != printed {
            eprintln!("{summary}");
            summary.clone_into(&mut printed);
        }
        tokio::time::sleep(POLL_INTERVAL).await;
    }
}
