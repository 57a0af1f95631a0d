//! Derived campaigns, whose rollouts follow from the outcomes of another campaign: lookup,
//! creation and progress, shared by `explain` and `thresholds`.

use std::time::Duration;

use anyhow::anyhow;
use clap::Args;
use coordinator::client::{Client, Service};
use libero_ctrl::{CampaignSpec, PolicyRoute, Realisation, Record, Rollouts, Wanted};
use proto::coordinator::campaign_status::State;
use proto::coordinator::{CampaignStatus, CreateCampaignRequest, GetCampaignRequest};
use report::Prospect;
use terminal::counted;

use super::command::{CommandError, failure, usage};
use super::forecast;

/// Interval between two fetches of the findings.
const LOOK_AGAIN: Duration = Duration::from_secs(2);

/// Returns the rollouts that a campaign's specification defines; `None` if the campaign does not
/// exist.
pub(super) async fn rollouts(
    client: &Client,
    name: &str,
) -> Result<Option<Rollouts>, CommandError> {
    let all = client.list_campaigns().await?;
    if !all.iter().any(|status| status.campaign == name) {
        return Ok(None);
    }
    Ok(Some(spec(client, name).await?.rollouts))
}

/// Returns the specification of a campaign.
pub(super) async fn spec(client: &Client, name: &str) -> Result<CampaignSpec, CommandError> {
    let request = GetCampaignRequest {
        campaign: name.to_owned(),
    };
    let answer = client.call(request, Service::get_campaign).await?;
    CampaignSpec::from_json(&answer.spec).map_err(usage)
}

/// Creates a campaign whose rollouts follow from those of `source`, unless it exists with the same
/// specification.
pub(super) async fn create(
    client: &Client,
    source: &CampaignStatus,
    name: &str,
    rollouts: Rollouts,
    record: Record,
) -> Result<(), CommandError> {
    let is_stopped = source.state() == State::Stopped;
    let execution = self::spec(client, &source.campaign).await?.execution;
    let spec = CampaignSpec {
        name: name.to_owned(),
        policy: PolicyRoute {
            name: source.policy.clone(),
            endpoint: source.policy_endpoint.clone(),
        },
        rollouts,
        realisation: Realisation::Matched,
        replicates: 1,
        record,
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
    if open > 0 && !is_stopped {
        eprintln!(
            "campaign {} has {open} rollouts without an outcome; {name} begins once it is finished",
            source.campaign
        );
    }
    Ok(())
}

/// The flags that say whether a campaign is created.
#[derive(Args, Clone, Copy, Debug)]
pub(super) struct CreateFlags {
    /// Create the campaign that runs the rollouts, unless it is there.
    #[arg(long)]
    create: bool,
    /// Print what creating it would take, and create nothing.
    #[arg(long, conflicts_with = "create")]
    dry_run: bool,
}

/// Action on a derived campaign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// Create the campaign, unless it exists with the same specification.
    Create,
    /// Print the number of rollouts and the forecast, and create nothing.
    Propose,
    /// Show the findings of the existing campaign.
    Show,
}

impl CreateFlags {
    /// Returns the action that the flags request. `has_how_flags` is true if flags were given that
    /// apply only to a campaign to be created, `needs_it` if the campaign must exist already.
    pub(super) fn action(
        self,
        is_there: bool,
        has_how_flags: bool,
        needs_it: bool,
        command: &str,
    ) -> Result<Action, CommandError> {
        match (self.create, self.dry_run) {
            (true, _) => Ok(Action::Create),
            (_, true) => Ok(Action::Propose),
            _ if has_how_flags => Err(usage(anyhow!(
                "read `{command}`: the flags that say how to run it need --create, or --dry-run to \
                 see what it would take"
            ))),
            _ if is_there => Ok(Action::Show),
            _ if needs_it => Err(failure(anyhow!(
                "show the results of `{command}`: there is no such campaign yet; \
                 `{command} --create` creates it"
            ))),
            _ => Ok(Action::Propose),
        }
    }
}

/// Campaign that may be created, and the rollouts that it would take.
pub(super) struct Proposal<'a> {
    pub(super) name: &'a str,
    pub(super) source: &'a CampaignStatus,
    /// Singular noun for a subject of the campaign: `transition` or `threshold`.
    pub(super) subject: &'a str,
    pub(super) prospect: &'a Prospect,
}

impl Proposal<'_> {
    /// Describes the number of rollouts and a forecast of their duration.
    pub(super) async fn in_words(&self, client: &Client) -> String {
        let Self {
            name,
            source,
            subject,
            prospect,
        } = self;
        let rollouts = prospect.most_rollouts.iter();
        let rollouts = rollouts.map(|(suite, rollouts)| (suite.name(), *rollouts));
        let forecast = forecast::ask_of(client, &source.policy, rollouts, None).await;
        let open = match source.queued + source.leased {
            0 => String::new(),
            open => format!(
                ", and more may follow from {} of {} without an outcome",
                counted(open, "rollout"),
                source.campaign
            ),
        };
        let first = format!(
            "campaign {name} takes at most {} for {}{open}",
            counted(prospect.rollouts(), "rollout"),
            counted(prospect.subjects, subject)
        );
        let first = terminal::wrapped("", 2, &first);
        format!("{first}\n{}", forecast::in_words(&forecast, &source.policy))
    }
}

/// Fetches the findings once or, with `until_complete`, polls until they are complete. Prints the
/// first line of their text to standard error whenever it changes.
pub(super) async fn look<T>(
    until_complete: bool,
    found: impl AsyncFn() -> Result<T, CommandError>,
    is_complete: impl Fn(&T) -> bool,
    text: impl Fn(&T) -> String,
) -> Result<T, CommandError> {
    let mut told = String::new();
    loop {
        let found = found().await?;
        if !until_complete || is_complete(&found) {
            return Ok(found);
        }
        let text = text(&found);
        let standing = text.lines().next().unwrap_or_default();
        if standing != told {
            eprintln!("{standing}");
            standing.clone_into(&mut told);
        }
        tokio::time::sleep(LOOK_AGAIN).await;
    }
}
