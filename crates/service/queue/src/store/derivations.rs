//! Statements on `derivation`: campaigns that follow from another, their source.

use sqlx::SqliteConnection;

use super::{Doing, StoreError};
use crate::ids::{CampaignId, CampaignName};

/// Records that a campaign derives from another.
pub(crate) async fn insert(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    source: CampaignId,
) -> Result<(), StoreError> {
    sqlx::query("INSERT INTO derivation (campaign_id, source_id) VALUES (?, ?)")
        .bind(campaign)
        .bind(source)
        .execute(tx)
        .await
        .doing("store the source of a derived campaign")
        .map(drop)
}

/// Returns the source of a derived campaign; `None` for other campaigns.
pub(crate) async fn source(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Option<CampaignId>, StoreError> {
    sqlx::query_scalar("SELECT source_id FROM derivation WHERE campaign_id = ?")
        .bind(campaign)
        .fetch_optional(tx)
        .await
        .doing("find the source of a campaign")
}

/// Returns the names of the campaigns that derive from `source`, oldest first.
pub(crate) async fn derived_names(
    tx: &mut SqliteConnection,
    source: CampaignId,
) -> Result<Vec<CampaignName>, StoreError> {
    sqlx::query_scalar(
        "SELECT c.name FROM derivation d JOIN campaign c ON c.id = d.campaign_id
         WHERE d.source_id = ? ORDER BY c.id",
    )
    .bind(source)
    .fetch_all(tx)
    .await
    .doing("list the campaigns derived from a campaign")
}
