//! Calls that look at jobs and workers, or change a campaign that is there.

use proto::coordinator as wire;
use tonic::Streaming;

use super::{Client, ClientError, Service};

pub use wire::change_campaign_request::Change;

impl Client {
    /// Pauses, resumes or cancels a campaign. Returns what it is now.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub async fn change_campaign(
        &self,
        name: &str,
        change: Change,
    ) -> Result<wire::campaign_status::State, ClientError> {
        let request = wire::ChangeCampaignRequest {
            campaign: name.to_owned(),
            change: change.into(),
        };
        let response = self.call(request, Service::change_campaign);
        Ok(response.await?.state())
    }

    /// Deletes a campaign with its results and files.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub async fn delete_campaign(
        &self,
        name: &str,
    ) -> Result<wire::DeleteCampaignResponse, ClientError> {
        let request = wire::DeleteCampaignRequest {
            campaign: name.to_owned(),
            confirm: name.to_owned(),
        };
        self.call(request, Service::delete_campaign).await
    }

    /// A page of a campaign's jobs.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub async fn list_jobs(
        &self,
        request: &wire::ListJobsRequest,
    ) -> Result<Vec<wire::Job>, ClientError> {
        let response = self.call(request.clone(), Service::list_jobs);
        Ok(response.await?.jobs)
    }

    /// Everything about one job.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub async fn job(
        &self,
        campaign: &str,
        job: wire::JobName,
    ) -> Result<wire::GetJobResponse, ClientError> {
        let request = wire::GetJobRequest {
            campaign: campaign.to_owned(),
            job: Some(job),
        };
        self.call(request, Service::get_job).await
    }

    /// Takes jobs out of quarantine: those that are named, or all of the
    /// campaign's if none is. Returns how many.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub async fn retry_jobs(
        &self,
        campaign: &str,
        jobs: Vec<wire::JobName>,
    ) -> Result<u64, ClientError> {
        let request = wire::RetryJobsRequest {
            campaign: campaign.to_owned(),
            all: jobs.is_empty(),
            jobs,
        };
        let response = self.call(request, Service::retry_jobs);
        Ok(response.await?.jobs)
    }

    /// The workers, those with the latest calls first.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub async fn list_workers(&self) -> Result<Vec<wire::WorkerStatus>, ClientError> {
        let response = self.call(wire::ListWorkersRequest {}, Service::list_workers);
        Ok(response.await?.workers)
    }

    /// A copy of the database, piece by piece.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub async fn backup(&self) -> Result<Streaming<wire::BackupChunk>, ClientError> {
        self.call(wire::BackupRequest {}, Service::backup).await
    }
}
