//! What people call.

use std::pin::Pin;
use std::sync::Arc;

use proto::coordinator as wire;
use proto::coordinator::operator_service_server::OperatorService;
use tokio_stream::{Stream, StreamExt};
use tonic::{Request, Response, Status};

use super::{chain, export_failed, queue_failed, report_failed};
use crate::expand::NewCampaign;
use crate::export::Export;
use crate::ids::CampaignName;
use crate::queue::{CampaignStatus, Queue};
use crate::report;

/// The operator service on a queue.
#[derive(Debug)]
pub(super) struct OperatorApi {
    queue: Arc<Queue>,
}

impl OperatorApi {
    pub(super) fn new(queue: Arc<Queue>) -> OperatorApi {
        OperatorApi { queue }
    }
}

#[tonic::async_trait]
impl OperatorService for OperatorApi {
    type ExportStream = Pin<Box<dyn Stream<Item = Result<wire::ExportLine, Status>> + Send>>;

    async fn create_campaign(
        &self,
        request: Request<wire::CreateCampaignRequest>,
    ) -> Result<Response<wire::CreateCampaignResponse>, Status> {
        let campaign = NewCampaign::from_json(&request.into_inner().spec)
            .map_err(|error| Status::invalid_argument(chain(&error)))?;
        let created = self.queue.create_campaign(&campaign).await;
        let created = created.map_err(queue_failed)?;
        Ok(Response::new(wire::CreateCampaignResponse {
            jobs_added: created.jobs_added,
            jobs_total: created.jobs_total,
        }))
    }

    async fn list_campaigns(
        &self,
        _: Request<wire::ListCampaignsRequest>,
    ) -> Result<Response<wire::ListCampaignsResponse>, Status> {
        let campaigns = self.queue.list_campaigns().await.map_err(queue_failed)?;
        Ok(Response::new(wire::ListCampaignsResponse {
            campaigns: campaigns.into_iter().map(write_status).collect(),
        }))
    }

    async fn get_campaign(
        &self,
        request: Request<wire::GetCampaignRequest>,
    ) -> Result<Response<wire::GetCampaignResponse>, Status> {
        let name = campaign_name(&request.into_inner().campaign)?;
        let status = self.queue.campaign_status(&name).await;
        let status = status.map_err(queue_failed)?;
        Ok(Response::new(wire::GetCampaignResponse {
            spec: status.spec.clone(),
            status: Some(write_status(status)),
        }))
    }

    async fn report(
        &self,
        request: Request<wire::ReportRequest>,
    ) -> Result<Response<wire::ReportResponse>, Status> {
        let name = campaign_name(&request.into_inner().campaign)?;
        let report = report::of_campaign(&self.queue, &name).await;
        let report = report.map_err(report_failed)?;
        Ok(Response::new(wire::ReportResponse {
            json: report.json,
            table: report.table,
        }))
    }

    async fn export(
        &self,
        request: Request<wire::ExportRequest>,
    ) -> Result<Response<Self::ExportStream>, Status> {
        let name = campaign_name(&request.into_inner().campaign)?;
        let export = Export::begin(self.queue.clone(), &name).await;
        let lines = export.map_err(queue_failed)?.map(|line| {
            line.map(|json| wire::ExportLine { json })
                .map_err(export_failed)
        });
        Ok(Response::new(Box::pin(lines)))
    }
}

fn campaign_name(name: &str) -> Result<CampaignName, Status> {
    CampaignName::parse(name).map_err(|error| Status::invalid_argument(error.to_string()))
}

fn write_status(status: CampaignStatus) -> wire::CampaignStatus {
    let counts = status.counts;
    wire::CampaignStatus {
        campaign: status.name.as_str().to_owned(),
        policy: status.policy,
        total: counts.total(),
        queued: counts.queued,
        leased: counts.leased,
        committed: counts.committed,
        quarantined: counts.quarantined,
        succeeded: counts.succeeded,
        policy_paused: status.policy_pause_reason.is_some(),
        policy_pause_reason: status.policy_pause_reason.unwrap_or_default(),
        rate_per_sec: status.rate_per_sec,
        eta_secs: status.eta_secs,
        live_workers: status.live_workers,
        waiting_reason: status.waiting_reason,
    }
}
