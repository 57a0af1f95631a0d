//! Statements on `derivation`: campaigns that derive from others, and the inputs of their next
//! jobs.

use sqlx::SqliteConnection;

use super::{Doing, StoreError, json};
use crate::ids::{CampaignId, CampaignName};
use crate::store::outcomes::OutcomeRow;

/// A campaign that derives from another.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub(crate) struct Derived {
    pub(crate) campaign: CampaignId,
    /// The campaign that `campaign` derives from.
    pub(crate) source: CampaignId,
    /// Specification of `campaign`, JSON.
    pub(crate) spec: String,
    /// Number of jobs of `campaign` so far.
    pub(crate) jobs: i64,
    /// Number of the source's jobs that are not settled; 0 if the source has stopped early.
    pub(crate) unsettled: i64,
    /// Revision of the outcomes of `campaign`: equal revisions mean equal outcomes.
    pub(crate) revision: i64,
    #[sqlx(flatten)]
    pub(crate) source_edition: SourceEdition,
}

/// State of a source; equal editions of one source have equal records.
#[derive(Clone, Copy, Debug, PartialEq, Eq, sqlx_macros::FromRow)]
pub(crate) struct SourceEdition {
    #[sqlx(rename = "source_revision")]
    revision: i64,
    /// True if the source stopped early, so that only a part of its outcomes counts.
    #[sqlx(rename = "source_has_stopped")]
    has_stopped: bool,
}

/// SQL for the number of jobs of `d`'s source that are not settled; 0 if the source has stopped
/// early. Reads one row of `tally`.
macro_rules! unsettled {
    () => {
        "(SELECT iif(EXISTS (SELECT 1 FROM stop s WHERE s.campaign_id = d.source_id
                  AND s.stopped_ms IS NOT NULL), 0, t.queued + t.leased)
              FROM tally t WHERE t.campaign_id = d.source_id)"
    };
}

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

/// Returns the derived campaigns that are not cancelled.
pub(crate) async fn all(tx: &mut SqliteConnection) -> Result<Vec<Derived>, StoreError> {
    sqlx::query_as(concat!(
        "SELECT d.campaign_id AS campaign, d.source_id AS source, c.spec, c.jobs, ",
        unsettled!(),
        " AS unsettled, own.revision, its.revision AS source_revision,
             EXISTS (SELECT 1 FROM stop s WHERE s.campaign_id = d.source_id
                 AND s.stopped_ms IS NOT NULL) AS source_has_stopped
         FROM derivation d JOIN campaign c ON c.id = d.campaign_id
         JOIN tally own ON own.campaign_id = d.campaign_id
         JOIN tally its ON its.campaign_id = d.source_id
         WHERE c.state <> 'cancelled' ORDER BY d.campaign_id"
    ))
    .fetch_all(tx)
    .await
    .doing("list derived campaigns")
}

/// Returns true if the stored campaign still has the source and the number of jobs in `campaign`,
/// and is not cancelled. Row numbers of campaigns are never reused.
pub(crate) async fn is_unchanged(
    tx: &mut SqliteConnection,
    campaign: &Derived,
) -> Result<bool, StoreError> {
    sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM derivation d JOIN campaign c ON c.id = d.campaign_id
         WHERE d.campaign_id = ? AND d.source_id = ? AND c.jobs = ? AND c.state <> 'cancelled')",
    )
    .bind(campaign.campaign)
    .bind(campaign.source)
    .bind(campaign.jobs)
    .fetch_one(tx)
    .await
    .doing("check whether a derived campaign is unchanged")
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

/// The source campaign that a derived campaign waits for.
#[derive(Clone, Debug, PartialEq, Eq, sqlx_macros::FromRow)]
pub struct Source {
    pub name: CampaignName,
    /// Rollouts of the source that are not settled; no rollout is derived until this is 0.
    pub awaited: u32,
    /// True if the source is cancelled, so that awaited rollouts will never be settled.
    pub is_cancelled: bool,
}

/// Returns the source of a derived campaign, with the number of its unsettled rollouts; `None` for
/// other campaigns.
pub(crate) async fn awaited(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Option<Source>, StoreError> {
    sqlx::query_as(concat!(
        "SELECT k.name, k.state = 'cancelled' AS is_cancelled, ",
        unsettled!(),
        " AS awaited FROM derivation d JOIN campaign k ON k.id = d.source_id
         WHERE d.campaign_id = ?"
    ))
    .bind(campaign)
    .fetch_optional(tx)
    .await
    .doing("read the outcomes that a derived campaign waits for")
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

/// Returns all jobs of a campaign with their outcomes so far, by rollout id, then replicate.
pub(crate) async fn outcomes(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<OutcomeRow>, StoreError> {
    sqlx::query_as(
        "SELECT j.rollout_id, j.replicate, j.init_id, j.state = 'quarantined' AS is_quarantined,
             r.success
         FROM job j LEFT JOIN result r ON r.job_id = j.id
         WHERE j.campaign_id = ? ORDER BY j.rollout_id, j.replicate",
    )
    .bind(campaign)
    .fetch_all(tx)
    .await
    .doing("read a campaign's outcomes")
}

/// Returns the manifest rows, JSON, of these rollouts of replicate 0; rollouts that the campaign
/// lacks are left out.
pub(crate) async fn rows(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    rollouts: &[String],
) -> Result<Vec<String>, StoreError> {
    sqlx::query_scalar(
        "SELECT manifest_row FROM job WHERE campaign_id = ? AND replicate = 0
             AND rollout_id IN (SELECT value FROM json_each(?)) ORDER BY rollout_id",
    )
    .bind(campaign)
    .bind(json(rollouts))
    .fetch_all(tx)
    .await
    .doing("read the rollouts to explain")
}
