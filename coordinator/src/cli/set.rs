//! `coordinator campaign set`.

use clap::{ArgGroup, Args};
use coordinator::client::Service;
use proto::coordinator::AlterCampaignRequest;
use queue::read::CampaignStatus;
use queue::rules::campaign::PRIORITIES;
use terminal::{counted, number};

use super::command::{CommandError, Connection, print_line};

#[derive(Args, Debug)]
#[command(group = ArgGroup::new("which").required(true).args(["campaign", "at"]))]
#[command(group = ArgGroup::new("changes").required(true).multiple(true))]
pub(super) struct SetArguments {
    /// Name of the campaign.
    campaign: Option<String>,
    /// Every unfinished campaign whose policy is at this URL, instead of one campaign.
    #[arg(long, value_name = "URL", conflicts_with_all = ["policy", "name"])]
    at: Option<String>,
    /// Priority from -100 to 100: campaigns with a higher priority are leased first, and campaigns
    /// with equal priorities share the workers. A new campaign has priority 0 by default.
    #[arg(long, group = "changes", value_name = "N", allow_negative_numbers = true,
        value_parser = number(PRIORITIES, ""))]
    priority: Option<i32>,
    /// URL of the gateway, or of the policy itself.
    #[arg(long, group = "changes", value_name = "URL")]
    endpoint: Option<String>,
    /// Name of the policy at its endpoint; allowed only while the campaign has no result.
    #[arg(long, group = "changes")]
    policy: Option<String>,
    /// New name of the campaign.
    #[arg(long, group = "changes")]
    name: Option<String>,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn set(arguments: SetArguments) -> Result<(), CommandError> {
    let client = arguments.connection.client()?;
    let campaigns = match &arguments.at {
        None => Vec::from_iter(arguments.campaign.clone()),
        Some(url) => {
            let mut campaigns = client.list_campaigns().await?;
            campaigns.retain(|status| status.endpoint == *url && !status.is_finished);
            if campaigns.is_empty() {
                let none = format!("no unfinished campaign measures a policy at {url}");
                return Ok(print_line(&none)?);
            }
            campaigns.into_iter().map(|status| status.name).collect()
        }
    };
    for campaign in campaigns {
        let request = AlterCampaignRequest {
            campaign,
            priority: arguments.priority,
            policy_endpoint: arguments.endpoint.clone(),
            policy: arguments.policy.clone(),
            name: arguments.name.clone(),
        };
        let (status, taken_back): (CampaignStatus, u64) =
            client.ask(request.clone(), Service::alter_campaign).await?;
        print_line(&describe(&request, &status, taken_back))?;
    }
    Ok(())
}

fn describe(request: &AlterCampaignRequest, status: &CampaignStatus, taken_back: u64) -> String {
    let campaign = &request.campaign;
    let mut lines = Vec::new();
    if let Some(priority) = request.priority {
        lines.push(format!("campaign {campaign} has priority {priority}"));
    }
    if request.policy_endpoint.is_some() || request.policy.is_some() {
        let CampaignStatus { policy, endpoint, .. } = status;
        lines.push(format!("campaign {campaign} measures {policy} at {endpoint}"));
    }
    if taken_back > 0 {
        lines.push(format!(
            "{} taken back without a charge: rollouts in progress at the old endpoint\n\
             run again at the new one",
            counted(taken_back, "rollout")
        ));
    }
    if let Some(name) = &request.name {
        lines.push(format!(
            "campaign {campaign} is now called {name}; the address of its page has changed, the \
             folder of its files has not"
        ));
    }
    lines.join("\n")
}
