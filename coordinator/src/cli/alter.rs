//! `coordinator campaign set-priority|set-endpoint|move-endpoint|rename`.

use clap::Args;
use coordinator::client::Service;
use proto::coordinator::AlterCampaignRequest;
use queue::read::CampaignStatus;
use queue::rules::campaign::PRIORITIES;
use terminal::{counted, number};

use super::command::{CommandError, Connection, print_line};

#[derive(Args, Debug)]
pub(super) struct PriorityArguments {
    /// Name of the campaign.
    campaign: String,
    /// Priority from -100 to 100: campaigns with a higher priority are leased first, and campaigns
    /// with equal priorities share the workers. A new campaign has priority 0 by default.
    #[arg(value_name = "N", allow_negative_numbers = true, value_parser = number(PRIORITIES, ""))]
    priority: i32,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Args, Debug)]
pub(super) struct EndpointArguments {
    /// Name of the campaign.
    campaign: String,
    /// URL of the gateway, or of the policy itself.
    url: String,
    /// Name of the policy at the new endpoint, if the name changes, too; allowed only while the
    /// campaign has no result.
    #[arg(long)]
    policy: Option<String>,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Args, Debug)]
pub(super) struct MoveArguments {
    /// Current URL of the policies, as stored in their campaigns.
    from: String,
    /// New URL, of the gateway or of the policy itself.
    to: String,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Args, Debug)]
pub(super) struct RenameArguments {
    /// Current name of the campaign.
    campaign: String,
    /// New name of the campaign.
    name: String,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn set_priority(arguments: PriorityArguments) -> Result<(), CommandError> {
    let request = AlterCampaignRequest {
        campaign: arguments.campaign.clone(),
        priority: Some(arguments.priority),
        ..AlterCampaignRequest::default()
    };
    alter(&arguments.connection, request).await?;
    Ok(print_line(&format!("campaign {} has priority {}", arguments.campaign, arguments.priority))?)
}

pub(super) async fn set_endpoint(arguments: EndpointArguments) -> Result<(), CommandError> {
    let request = AlterCampaignRequest {
        campaign: arguments.campaign.clone(),
        policy_endpoint: Some(arguments.url),
        policy: arguments.policy,
        ..AlterCampaignRequest::default()
    };
    let altered = alter(&arguments.connection, request).await?;
    print_endpoint(&arguments.campaign, altered)
}

/// Moves every unfinished campaign from one policy endpoint to another.
pub(super) async fn move_endpoint(arguments: MoveArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let campaigns = client.list_campaigns().await?;
    let is_moved =
        |status: &&CampaignStatus| status.endpoint == arguments.from && !status.is_finished;
    let moved: Vec<&CampaignStatus> = campaigns.iter().filter(is_moved).collect();
    if moved.is_empty() {
        return Ok(print_line(&format!(
            "no unfinished campaign measures a policy at {}",
            arguments.from
        ))?);
    }
    for status in moved {
        let request = AlterCampaignRequest {
            campaign: status.name.clone(),
            policy_endpoint: Some(arguments.to.clone()),
            ..AlterCampaignRequest::default()
        };
        let altered = client.ask(request, Service::alter_campaign).await?;
        print_endpoint(&status.name, altered)?;
    }
    Ok(())
}

fn print_endpoint(campaign: &str, altered: (CampaignStatus, u64)) -> Result<(), CommandError> {
    let (status, taken_back) = altered;
    let mut lines =
        vec![format!("campaign {campaign} measures {} at {}", status.policy, status.endpoint)];
    if taken_back > 0 {
        lines.push(format!(
            "{} taken back without a charge: rollouts in progress at the old endpoint\n\
             run again at the new one",
            counted(taken_back, "rollout")
        ));
    }
    Ok(print_line(&lines.join("\n"))?)
}

pub(super) async fn rename(arguments: RenameArguments) -> Result<(), CommandError> {
    let request = AlterCampaignRequest {
        campaign: arguments.campaign.clone(),
        name: Some(arguments.name.clone()),
        ..AlterCampaignRequest::default()
    };
    alter(&arguments.connection, request).await?;
    Ok(print_line(&format!(
        "campaign {} is now called {}; the address of its page has changed, the folder of its \
         files has not",
        arguments.campaign, arguments.name
    ))?)
}

async fn alter(
    connection: &Connection,
    request: AlterCampaignRequest,
) -> Result<(CampaignStatus, u64), CommandError> {
    let client = connection.client()?;
    Ok(client.ask(request, Service::alter_campaign).await?)
}
