//! What commands share that find something out by a campaign of their own, whose rollouts
//! follow from the outcomes of another: finding it, creating it, following it.

use std::time::Duration;

use coordinator::client::{Client, Service};
use proto::coordinator::campaign_status::State;
use proto::coordinator::{CampaignStatus, CreateCampaignRequest, GetCampaignRequest};
use protocol::{CampaignSpec, PolicyRoute, Realisation, Record, Rollouts, Wanted};

use super::command::{CommandError, usage};

/// Between two looks at what was found.
const LOOK_AGAIN: Duration = Duration::from_secs(2);

/// The rollouts of the campaign of this name, if there is one.
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

/// The specification of a campaign.
pub(super) async fn spec(client: &Client, name: &str) -> Result<CampaignSpec, CommandError> {
    let request = GetCampaignRequest {
        campaign: name.to_owned(),
    };
    let answer = client.call(request, Service::get_campaign).await?;
    CampaignSpec::from_json(&answer.spec).map_err(usage)
}

/// Creates a campaign whose rollouts follow from those of `source`, unless it is there as
/// it would be created.
pub(super) async fn create(
    client: &Client,
    source: CampaignStatus,
    name: &str,
    rollouts: Rollouts,
    record: Record,
) -> Result<(), CommandError> {
    let is_stopped = source.state() == State::Stopped;
    let spec = CampaignSpec {
        name: name.to_owned(),
        policy: PolicyRoute {
            name: source.policy,
            endpoint: source.policy_endpoint,
        },
        rollouts,
        realisation: Realisation::Matched,
        replicates: 1,
        record,
        wanted: Wanted::default(),
        stop: None,
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
            "campaign {} has {open} rollouts without an outcome; {name} begins once it is through",
            source.campaign
        );
    }
    Ok(())
}

/// Looks at what was found: once, or until it is complete. Meanwhile it says on standard
/// error how things stand: the first line of the text.
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
