//! Outcomes and specifications of campaigns, for computations outside the writing transaction.

use std::panic::resume_unwind;

use benchmark::{CampaignSpec, UnknownName};
use paired::Record;
use sqlx::SqliteConnection;

use crate::ids::CampaignId;
use crate::store::outcomes::{self, OutcomeRow};
use crate::store::{Doing, StoreError, undecodable};

pub(super) fn specification(text: &str) -> Result<CampaignSpec, StoreError> {
    let spec = CampaignSpec::from_json(text).map_err(undecodable);
    spec.doing("read a campaign's specification")
}

pub(super) async fn records(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<Record>, StoreError> {
    let rows = outcomes::of_campaign(tx, campaign).await?;
    let parse = move || rows.iter().map(OutcomeRow::record).collect();
    let records: Result<_, UnknownName> = on_blocking_thread(parse).await;
    let records = records.map_err(undecodable);
    records.doing("read a campaign's outcomes")
}

/// Runs a computation on a blocking thread, not on one that answers calls: a computation over a
/// whole campaign takes tens of milliseconds or more.
pub(super) async fn on_blocking_thread<T: Send + 'static>(
    computation: impl FnOnce() -> T + Send + 'static,
) -> T {
    match tokio::task::spawn_blocking(computation).await {
        Ok(computed) => computed,
        Err(panicked) => resume_unwind(panicked.into_panic()),
    }
}
