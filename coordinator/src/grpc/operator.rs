//! The operator's gRPC service.

use std::sync::Arc;

use proto::coordinator::operator_service_server::OperatorService;
use proto::coordinator::{
    self as wire, AlterCampaignRequest, AppendRowsRequest, ArchiveCampaignRequest, BackupRequest,
    ChangeCampaignRequest, CreateCampaignRequest, DeleteCampaignRequest, ExportRequest,
    ForecastRequest, GetCampaignRequest, GetJobRequest, ListCampaignsRequest, ListJobsRequest,
    ListWorkersRequest, ReportRequest, RetryJobsRequest, SkipJobsRequest,
};
use queue::Queue;
use queue::clock::UnixMillis;
use queue::expand::NewCampaign;
use queue::ids::CampaignName;
use queue::read::{Campaign, View};
use serde::Serialize;
use tokio_stream::{Stream, StreamExt};
use tonic::{Request, Response, Status, Streaming};
use transport::chain;

use super::backup;
use super::detached::Detached;
use super::failure::{Answer, check_room, failed, invalid};
use super::streams::{Large, Turns};
use super::{archives, read};
use crate::export;
use crate::storage::Storage;
use crate::subject;

/// Size of each message of a report or a specification, bytes.
const PART_BYTES: usize = 1 << 20;

/// Space that a job takes in the database, bytes, rounded up, and the space that a campaign may take
/// while the disk is nearly full.
const JOB_BYTES: u64 = 1 << 10;
const SMALL_BYTES: u64 = 1 << 20;

#[derive(Debug)]
pub(super) struct OperatorApi {
    pub(super) queue: Arc<Queue>,
    /// Changes in progress; they are completed even if the client disconnects.
    pub(super) changes: Detached,
    pub(super) storage: Option<Arc<Storage>>,
    /// Limits how many large answers are made at a time. An export takes no turn: it keeps nothing
    /// between its pages.
    pub(super) turns: Turns,
    pub(super) min_free_bytes: u64,
}

impl OperatorApi {
    async fn view(&self) -> Result<View, Status> {
        self.queue.view().await.map_err(failed)
    }

    /// Expands a specification, and checks that a large campaign leaves room for results.
    async fn expand(&self, spec: String) -> Result<NewCampaign, Status> {
        let expanded = tokio::task::spawn_blocking(move || NewCampaign::from_json(&spec)).await;
        let expanded = expanded.map_err(|error| Status::internal(error.to_string()))?;
        let campaign = expanded.map_err(|error| invalid(chain(&error)))?;
        let bytes = campaign.jobs.len() as u64 * JOB_BYTES;
        if bytes > SMALL_BYTES {
            let needed = self.min_free_bytes.saturating_add(bytes);
            check_room(self.queue.store().folder(), needed, "add the campaign's rollouts")?;
        }
        Ok(campaign)
    }

    /// Looks a campaign up by name. The caller reads all further data of its response from the
    /// returned view, so that the response is consistent.
    async fn campaign(&self, name: &str) -> Result<(View, Campaign), Status> {
        let name = campaign_name(name)?;
        let mut view = self.view().await?;
        let campaign = view.campaign(&name).await.map_err(failed)?;
        Ok((view, campaign))
    }
}

#[tonic::async_trait]
impl OperatorService for OperatorApi {
    type ArchiveCampaignStream = Large<wire::ArchiveChunk>;
    type GetSpecificationStream = Large<wire::ReportPart>;
    type BackupStream = Large<wire::BackupChunk>;
    type ReportStream = Large<wire::ReportPart>;
    type ExportStream = Large<wire::ExportLine>;

    async fn create_campaign(
        &self,
        request: Request<CreateCampaignRequest>,
    ) -> Answer<wire::Answer> {
        let request = request.into_inner();
        let priority = read::priority(request.priority)?;
        let campaign = NewCampaign { priority, ..self.expand(request.spec).await? };
        let queue = self.queue.clone();
        let created = async move { queue.create_campaign(&campaign).await };
        answer(self.queue.now(), &self.changes.run(created).await?.map_err(failed)?)
    }

    async fn append_rows(&self, request: Request<AppendRowsRequest>) -> Answer<wire::Answer> {
        let request = request.into_inner();
        let name = campaign_name(&request.campaign)?;
        let queue = self.queue.clone();
        if !request.spec.is_empty() && !request.rows.is_empty() {
            return Err(invalid("append to a campaign: give rows or a specification, not both"));
        }
        let rows = read::rows(request.rows)?;
        let extended = match request.spec.is_empty() {
            true => None,
            false => Some(self.expand(request.spec).await?),
        };
        let appended = async move {
            match extended {
                Some(extended) => queue.extend_campaign(&name, extended).await,
                None => queue.append_rows(&name, rows).await,
            }
        };
        answer(self.queue.now(), &self.changes.run(appended).await?.map_err(failed)?)
    }

    async fn list_campaigns(&self, _: Request<ListCampaignsRequest>) -> Answer<wire::Answer> {
        let mut view = self.view().await?;
        answer(view.now, &view.statuses().await.map_err(failed)?)
    }

    async fn get_campaign(&self, request: Request<GetCampaignRequest>) -> Answer<wire::Answer> {
        let (mut view, campaign) = self.campaign(&request.into_inner().campaign).await?;
        answer(view.now, &view.status(campaign).await.map_err(failed)?)
    }

    async fn get_specification(
        &self,
        request: Request<GetCampaignRequest>,
    ) -> Result<Response<Self::GetSpecificationStream>, Status> {
        let turn = self.turns.wait().await?;
        let (mut view, campaign) = self.campaign(&request.into_inner().campaign).await?;
        let spec = view.current_spec(&campaign).await.map_err(failed)?;
        Ok(Response::new(turn.send(parts(spec.into_bytes()))))
    }

    async fn change_campaign(
        &self,
        request: Request<ChangeCampaignRequest>,
    ) -> Answer<wire::Answer> {
        let request = request.into_inner();
        let name = campaign_name(&request.campaign)?;
        let change = read::change(request.change)?;
        let queue = self.queue.clone();
        let changed = async move { queue.change_campaign(&name, change).await };
        answer(self.queue.now(), &self.changes.run(changed).await?.map_err(failed)?)
    }

    async fn delete_campaign(
        &self,
        request: Request<DeleteCampaignRequest>,
    ) -> Answer<wire::Answer> {
        let request = request.into_inner();
        let name = campaign_name(&request.campaign)?;
        if request.confirm != request.campaign {
            return Err(invalid(format!(
                "delete campaign `{name}`: `confirm` must repeat the name"
            )));
        }
        let queue = self.queue.clone();
        let deleted = async move { queue.delete_campaign(&name).await };
        answer(self.queue.now(), &self.changes.run(deleted).await?.map_err(failed)?)
    }

    async fn list_jobs(&self, request: Request<ListJobsRequest>) -> Answer<wire::Answer> {
        let request = request.into_inner();
        let filter = read::job_filter(&request)?;
        let (mut view, campaign) = self.campaign(&request.campaign).await?;
        answer(view.now, &view.jobs(&campaign, filter).await.map_err(failed)?)
    }

    async fn get_job(&self, request: Request<GetJobRequest>) -> Answer<wire::Answer> {
        let request = request.into_inner();
        let job = read::job_name(request.job.unwrap_or_default())?;
        let (mut view, campaign) = self.campaign(&request.campaign).await?;
        answer(view.now, &view.job_details(&campaign, &job).await.map_err(failed)?)
    }

    async fn retry_jobs(&self, request: Request<RetryJobsRequest>) -> Answer<wire::Answer> {
        let request = request.into_inner();
        let name = campaign_name(&request.campaign)?;
        let retry = read::retry(request.jobs, request.all)?;
        let queue = self.queue.clone();
        let retried = async move { queue.retry_jobs(&name, &retry).await };
        answer(self.queue.now(), &self.changes.run(retried).await?.map_err(failed)?)
    }

    async fn skip_jobs(&self, request: Request<SkipJobsRequest>) -> Answer<wire::Answer> {
        let request = request.into_inner();
        let name = campaign_name(&request.campaign)?;
        let names = read::job_names(request.jobs)?;
        let queue = self.queue.clone();
        let skipped = async move { queue.skip_jobs(&name, &names).await };
        answer(self.queue.now(), &self.changes.run(skipped).await?.map_err(failed)?)
    }

    async fn list_workers(&self, _: Request<ListWorkersRequest>) -> Answer<wire::Answer> {
        let mut view = self.view().await?;
        answer(view.now, &view.workers().await.map_err(failed)?)
    }

    async fn backup(
        &self,
        _: Request<BackupRequest>,
    ) -> Result<Response<Self::BackupStream>, Status> {
        let turn = self.turns.wait().await?;
        let backup = self.queue.backup().await.map_err(failed)?;
        Ok(Response::new(turn.send(backup::chunks(backup).await?)))
    }

    async fn report(
        &self,
        request: Request<ReportRequest>,
    ) -> Result<Response<Self::ReportStream>, Status> {
        let turn = self.turns.wait().await?;
        let (mut view, campaign) = self.campaign(&request.into_inner().campaign).await?;
        let mut subject = subject::read(&mut view, &campaign).await.map_err(failed)?;
        let setups = subject::setups(&mut view, &campaign).await;
        subject.setups = setups.map_err(failed)?;
        drop(view);
        let json = tokio::task::spawn_blocking(move || serde_json::to_vec(&subject)).await;
        let json = json.map_err(|error| Status::internal(error.to_string()))?;
        let json = json.map_err(|error| Status::internal(error.to_string()))?;
        Ok(Response::new(turn.send(parts(json))))
    }

    async fn export(
        &self,
        request: Request<ExportRequest>,
    ) -> Result<Response<Self::ExportStream>, Status> {
        let name = campaign_name(&request.into_inner().campaign)?;
        let lines = export::lines(self.queue.clone(), &name).await;
        let lines = lines.map_err(failed)?.map(|line| {
            let json = line.map_err(failed)?;
            Ok(wire::ExportLine { json })
        });
        Ok(Response::new(Box::pin(lines)))
    }

    async fn archive_campaign(
        &self,
        request: Request<ArchiveCampaignRequest>,
    ) -> Result<Response<Self::ArchiveCampaignStream>, Status> {
        let name = campaign_name(&request.into_inner().campaign)?;
        let turn = self.turns.wait().await?;
        let chunks = archives::archive(&self.queue, self.storage.as_deref(), &name).await?;
        Ok(Response::new(turn.send(chunks)))
    }

    async fn import_campaign(
        &self,
        request: Request<Streaming<wire::ImportChunk>>,
    ) -> Answer<wire::Answer> {
        let imported =
            archives::import(&self.queue, &self.changes, request.into_inner(), self.min_free_bytes);
        answer(self.queue.now(), &imported.await?)
    }

    async fn alter_campaign(&self, request: Request<AlterCampaignRequest>) -> Answer<wire::Answer> {
        let request = request.into_inner();
        let name = campaign_name(&request.campaign)?;
        let alteration = read::alteration(request)?;
        let renamed = alteration.name.clone().unwrap_or_else(|| name.clone());
        let queue = self.queue.clone();
        let altered = async move { queue.alter_campaign(&name, &alteration).await };
        let taken_back = self.changes.run(altered).await?.map_err(failed)?;
        let name = renamed;
        let (mut view, campaign) = self.campaign(name.as_str()).await?;
        let status = view.status(campaign).await.map_err(failed)?;
        answer(view.now, &(status, taken_back))
    }

    async fn forecast(&self, request: Request<ForecastRequest>) -> Answer<wire::Answer> {
        let request = request.into_inner();
        let rollouts = read::rollouts_by_suite(request.rollouts)?;
        let mut view = self.view().await?;
        let forecast = view.forecast(&request.policy, &rollouts).await.map_err(failed)?;
        answer(view.now, &forecast)
    }
}

fn answer(now: UnixMillis, value: &impl Serialize) -> Answer<wire::Answer> {
    let json = serde_json::to_string(value);
    let json = json.map_err(|error| Status::internal(error.to_string()))?;
    Ok(Response::new(wire::Answer { json, now_unix_ms: now.0 }))
}

/// Divides JSON into messages.
fn parts(json: Vec<u8>) -> impl Stream<Item = Result<wire::ReportPart, Status>> {
    tokio_stream::iter((0..json.len()).step_by(PART_BYTES).map(move |start| {
        let end = json.len().min(start + PART_BYTES);
        Ok(wire::ReportPart { json: json[start..end].to_vec() })
    }))
}

pub(super) fn campaign_name(name: &str) -> Result<CampaignName, Status> {
    CampaignName::parse(name).map_err(invalid)
}
