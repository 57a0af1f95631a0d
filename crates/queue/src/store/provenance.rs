//! Statements on `provenance`: the part of an origin that many results share.

use benchmark::Suite;
use benchmark::attempt::Provenance;
use sqlx::SqliteConnection;
use sqlx::types::Json;

use super::{Doing, StoreError};
use crate::ids::CampaignId;

/// Row number of a stored origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, sqlx_macros::Type)]
#[sqlx(transparent)]
pub(crate) struct ProvenanceId(i64);

/// Returns the provenance of a result in a suite, of a campaign or of its source campaign.
pub(crate) async fn of_suite(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    suite: Suite,
) -> Result<Option<Provenance>, StoreError> {
    let found: Option<Json<Provenance>> = sqlx::query_scalar(
        "SELECT v.origin FROM result r
         JOIN provenance v ON v.id = r.provenance_id
         JOIN job j ON j.id = r.job_id
         WHERE r.campaign_id IN
                 (SELECT ?1 UNION SELECT s.id FROM campaign c JOIN campaign s ON s.name = c.source
                     WHERE c.id = ?1)
             AND j.task GLOB ?2 || '/*'
         LIMIT 1",
    )
    .bind(campaign)
    .bind(suite.name())
    .fetch_optional(tx)
    .await
    .doing("find the policy that was measured in a suite")?;
    Ok(found.map(|Json(origin)| origin))
}

/// Returns the row number of an origin, storing the origin if it is new.
pub(crate) async fn find_or_insert(
    tx: &mut SqliteConnection,
    origin: &Provenance,
) -> Result<ProvenanceId, StoreError> {
    // The no-op update makes RETURNING return an existing row too.
    sqlx::query_scalar(
        "INSERT INTO provenance (origin) VALUES (?)
         ON CONFLICT DO UPDATE SET origin = excluded.origin RETURNING id",
    )
    .bind(Json(origin))
    .fetch_one(tx)
    .await
    .doing("store the provenance of a result")
}
