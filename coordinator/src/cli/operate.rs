//! `coordinator campaign pause|resume|cancel|delete`.

use std::io::{IsTerminal, Write};

use anyhow::{Context, anyhow};
use clap::Args;
use coordinator::client::Service;
use proto::coordinator::change_campaign_request::Change;
use proto::coordinator::{ChangeCampaignRequest, DeleteCampaignRequest};
use queue::read::CampaignStatus;
use queue::rules::campaign::CampaignState;
use terminal::counted;

use super::command::{CommandError, Connection, print_line, usage};

#[derive(Args, Debug)]
pub(super) struct ChangeArguments {
    /// Name of the campaign.
    campaign: String,
    #[command(flatten)]
    connection: Connection,
}

#[derive(Args, Debug)]
pub(super) struct DeleteArguments {
    /// Name of the campaign.
    campaign: String,
    /// The campaign's name again, to confirm; if omitted, the command prompts for it.
    #[arg(long, value_name = "NAME")]
    confirm: Option<String>,
    #[command(flatten)]
    connection: Connection,
}

pub(super) async fn change(arguments: ChangeArguments, change: Change) -> Result<(), CommandError> {
    let name = &arguments.campaign;
    let client = arguments.connection.client()?;
    let request = ChangeCampaignRequest { campaign: name.clone(), change: change.into() };
    let text = match client.ask(request, Service::change_campaign).await? {
        CampaignState::Running { .. } => "running",
        CampaignState::Paused { .. } => "paused; running attempts may still be committed",
        CampaignState::Cancelled { .. } => "cancelled; its results stay",
        CampaignState::Stopped { .. } => "stopped early; its results stay",
    };
    Ok(print_line(&format!("campaign {name} is {text}"))?)
}

pub(super) async fn delete(arguments: DeleteArguments) -> Result<(), CommandError> {
    let name = &arguments.campaign;
    let confirmed = match &arguments.confirm {
        Some(confirmed) => confirmed.clone(),
        None => prompt(name)?,
    };
    if confirmed != *name {
        let error = anyhow!("`{confirmed}` is not the campaign's name; nothing was deleted");
        return Err(usage(error.context(format!("delete campaign `{name}`"))));
    }
    let client = arguments.connection.client()?;
    let before = client.campaign_status(name).await?;
    let request = DeleteCampaignRequest { campaign: name.clone(), confirm: confirmed };
    let deleted = match client.ask(request, Service::delete_campaign).await {
        Ok(deleted) => deleted,
        Err(error) => {
            let exists = |status: &CampaignStatus| status.name == *name;
            if client.list_campaigns().await?.iter().any(exists) {
                return Err(error.into());
            }
            // An earlier try deleted the campaign, and its answer was lost.
            before.rollouts
        }
    };
    Ok(print_line(&format!(
        "campaign {name} deleted: {}, {} and their files",
        counted(deleted.total(), "rollout"),
        counted(deleted.committed, "result")
    ))?)
}

fn prompt(name: &str) -> Result<String, CommandError> {
    if !std::io::stdin().is_terminal() {
        let error = anyhow!("pass --confirm {name} to delete its results and files for good");
        return Err(usage(error.context(format!("delete campaign `{name}`"))));
    }
    let mut stderr = std::io::stderr().lock();
    write!(
        stderr,
        "This deletes the results and files of campaign {name} for good. Type its name: "
    )
    .and_then(|()| stderr.flush())
    .context("ask for the campaign's name")?;
    let mut answer = String::new();
    std::io::stdin().read_line(&mut answer).context("read the campaign's name")?;
    Ok(answer.trim().to_owned())
}
