//! Statements on `campaign`, `campaign_task` and `former_name`: creating,
//! pinning, altering, deleting, and reading a campaign with its policy.

use std::collections::BTreeSet;

use benchmark::attempt::Pin;
use benchmark::{Realisation, Wanted};
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::policies::{self, health};
use super::workers::pin;
use super::{Doing, StoreError, json, undecodable};
use crate::clock::UnixMillis;
use crate::expand::{NewCampaign, NewJob};
use crate::ids::{CampaignId, CampaignName, PolicyId};
use crate::rules::campaign::CampaignState;
use crate::rules::outage::PolicyHealth;

/// Jobs inserted by one statement, each with eight values; SQLite binds at most 32,766 values.
const JOBS_PER_INSERT: usize = 1_000;

/// A campaign and the policy that it measures.
#[derive(Clone, Debug, sqlx_macros::FromRow)]
pub struct Campaign {
    /// Row number.
    pub id: CampaignId,
    pub name: CampaignName,
    /// SHA-256 of the specification, hex.
    pub spec_digest: String,
    pub policy_id: PolicyId,
    /// Name of the policy at its endpoint.
    pub policy: String,
    pub endpoint: String,
    #[sqlx(json)]
    pub health: PolicyHealth,
    /// Source of random values in perturbations, as [`Realisation`] names it.
    pub realisation: String,
    /// Execution model as text: what the robot does while the policy computes an answer.
    pub execution: String,
    /// Name of the rollouts to be filmed.
    pub record: String,
    #[sqlx(json)]
    pub state: CampaignState,
    /// True if configurations run in random order, so that the campaign may stop early.
    pub is_drawn: bool,
    /// Requirements on the workers.
    #[sqlx(json)]
    pub wanted: Wanted,
    /// Priority: jobs of campaigns with a higher priority are leased first.
    pub priority: i32,
    pub jobs: i64,
    pub created_ms: UnixMillis,
    /// Folder of the campaign's files below the artifacts folder: the campaign's original name, or
    /// that name with a number if another campaign has that folder.
    pub(crate) folder: String,
    pub pinned_ms: Option<UnixMillis>,
    /// Pin of the first result; until then, the source campaign's pin if this campaign is derived.
    #[sqlx(json(nullable))]
    pub pin: Option<Pin>,
}

impl Campaign {
    pub(crate) fn mode(&self) -> Result<Realisation, StoreError> {
        let mode = self.realisation.parse().map_err(undecodable);
        mode.doing("read a campaign's realisation mode")
    }

    /// Returns true if a result has pinned the campaign.
    pub(crate) fn is_pinned(&self) -> bool {
        self.pinned_ms.is_some()
    }

    /// Returns true if the campaign accepts results of a worker with this pin.
    pub(crate) fn accepts(&self, worker: &Pin) -> bool {
        worker.meets(&self.wanted) && self.pin.as_ref().is_none_or(|pin| pin.accepts(worker))
    }

    /// Describes the required workers, as text that follows the campaign's name in a message; empty
    /// if any worker suits.
    pub(crate) fn demand(&self) -> String {
        match &self.pin {
            Some(pin) => format!("is pinned to {pin}"),
            None if self.wanted == Wanted::default() => String::new(),
            None => format!("wants {}", self.wanted),
        }
    }
}

/// Query for [`Campaign`]s that meet a condition.
macro_rules! campaigns_where {
    ($condition:literal) => {
        concat!(
            "SELECT c.id, c.name, c.spec_digest, c.policy_id, p.name AS policy, p.endpoint,
                 c.realisation, c.execution, c.record, c.wanted, c.priority, c.jobs, c.created_ms,
                 coalesce(c.folder, c.name) AS folder, c.pinned_ms,
                 json_object('is', iif(s.stopped_ms IS NULL, c.state, 'stopped'),
                     'since', coalesce(s.stopped_ms, c.state_since_ms)) AS state,
                 s.campaign_id IS NOT NULL AS is_drawn,
                 iif(k.asset_pack IS NULL, NULL, ",
            pin!("k"),
            ") AS pin, ",
            health!(),
            " FROM campaign c JOIN policy p ON p.id = c.policy_id
             LEFT JOIN stop s ON s.campaign_id = c.id
             LEFT JOIN campaign k
                 ON k.name = iif(c.pinned_ms IS NULL, coalesce(c.source, c.name), c.name) WHERE ",
            $condition,
            " ORDER BY c.id"
        )
    };
}

pub(crate) async fn by_name(
    tx: &mut SqliteConnection,
    name: &CampaignName,
) -> Result<Option<Campaign>, StoreError> {
    sqlx::query_as(campaigns_where!("c.name = ?"))
        .bind(name)
        .fetch_optional(tx)
        .await
        .doing("find a campaign")
}

pub(crate) async fn by_id(
    tx: &mut SqliteConnection,
    id: CampaignId,
) -> Result<Campaign, StoreError> {
    sqlx::query_as(campaigns_where!("c.id = ?"))
        .bind(id)
        .fetch_one(tx)
        .await
        .doing("find a campaign")
}

/// Returns all campaigns, oldest first.
pub(crate) async fn all(tx: &mut SqliteConnection) -> Result<Vec<Campaign>, StoreError> {
    sqlx::query_as(campaigns_where!("c.id NOT IN (SELECT campaign_id FROM passage)"))
        .fetch_all(tx)
        .await
        .doing("list campaigns")
}

/// Returns the campaigns with waiting jobs, oldest first, except cancelled and stopped campaigns.
pub(crate) async fn waiting(tx: &mut SqliteConnection) -> Result<Vec<Campaign>, StoreError> {
    sqlx::query_as(campaigns_where!(
        "c.state <> 'cancelled' AND s.stopped_ms IS NULL
         AND c.id NOT IN (SELECT campaign_id FROM passage)
         AND EXISTS (SELECT 1 FROM job j WHERE j.campaign_id = c.id AND j.state = 'queued')"
    ))
    .fetch_all(tx)
    .await
    .doing("list campaigns with waiting jobs")
}

/// Returns the campaign that a campaign explains, or whose thresholds it measures; `None` for other
/// campaigns.
pub(crate) async fn source(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Option<Campaign>, StoreError> {
    sqlx::query_as(campaigns_where!("c.name = (SELECT source FROM campaign WHERE id = ?)"))
        .bind(campaign)
        .fetch_optional(tx)
        .await
        .doing("find the source of a campaign")
}

/// Returns the campaigns whose source is `source`, oldest first.
pub(crate) async fn derived_from(
    tx: &mut SqliteConnection,
    source: CampaignId,
) -> Result<Vec<Campaign>, StoreError> {
    sqlx::query_as(campaigns_where!(
        "c.source = (SELECT name FROM campaign WHERE id = ?)
         AND c.id NOT IN (SELECT campaign_id FROM passage)"
    ))
    .bind(source)
    .fetch_all(tx)
    .await
    .doing("list the campaigns derived from a campaign")
}

/// Returns a campaign's specification with the rows that were added since its creation; without
/// those of a campaign with a purpose.
pub(crate) async fn current_spec(
    tx: &mut SqliteConnection,
    id: CampaignId,
) -> Result<String, StoreError> {
    sqlx::query_scalar(
        "SELECT iif(json_type(spec, '$.rows') IS NULL OR json_type(spec, '$.purpose') = 'object',
             spec, json_set(spec, '$.rows', (SELECT json_group_array(json(manifest_row)) FROM (
                 SELECT manifest_row FROM job WHERE campaign_id = c.id AND replicate = 0
                 ORDER BY unit_order))))
         FROM campaign c WHERE id = ?",
    )
    .bind(id)
    .fetch_one(tx)
    .await
    .doing("read a campaign's specification and rows")
}

/// Returns a campaign's specification, JSON, as it was created.
pub(crate) async fn spec(tx: &mut SqliteConnection, id: CampaignId) -> Result<String, StoreError> {
    sqlx::query_scalar("SELECT spec FROM campaign WHERE id = ?")
        .bind(id)
        .fetch_one(tx)
        .await
        .doing("read a campaign's specification")
}

/// Returns an unused folder for a new campaign's files: the campaign's name, unless a renamed
/// campaign keeps that folder or files of a deleted campaign are still to be removed from it. A `~`
/// cannot occur in a campaign's name, so a suffix that starts with `~` is unique.
pub(crate) async fn free_folder(
    tx: &mut SqliteConnection,
    name: &CampaignName,
) -> Result<String, StoreError> {
    let mut folder = name.as_str().to_owned();
    for number in 2_u64.. {
        let taken = "SELECT EXISTS (SELECT 1 FROM campaign WHERE coalesce(folder, name) = ?1)
             OR EXISTS (SELECT 1 FROM removal WHERE folder = 'artifacts/' || ?1)";
        let taken: bool = sqlx::query_scalar(taken)
            .bind(&folder)
            .fetch_one(&mut *tx)
            .await
            .doing("find a free folder for a campaign")?;
        if !taken {
            break;
        }
        folder = format!("{name}~{number}");
    }
    Ok(folder)
}

/// Stores a campaign and all its jobs. The campaign's files go into `folder`.
pub(crate) async fn insert(
    tx: &mut SqliteConnection,
    campaign: &NewCampaign,
    folder: &str,
    now: UnixMillis,
) -> Result<CampaignId, StoreError> {
    take_name(tx, &campaign.name).await?;
    let id = insert_without_jobs(tx, campaign, folder, now).await?;
    append_jobs(tx, id, &campaign.jobs).await?;
    Ok(id)
}

/// Stores a campaign without jobs, which are appended separately.
pub(crate) async fn insert_without_jobs(
    tx: &mut SqliteConnection,
    campaign: &NewCampaign,
    folder: &str,
    now: UnixMillis,
) -> Result<CampaignId, StoreError> {
    let policy =
        policies::find_or_insert(tx, &campaign.policy_endpoint, &campaign.policy, now).await?;
    sqlx::query_scalar(
        "INSERT INTO campaign (name, spec, spec_digest, policy_id, realisation, record,
             wanted, jobs, created_ms, state_since_ms, priority, folder, execution)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, 0, ?8, ?8, ?9, nullif(?10, ?1), ?11) RETURNING id",
    )
    .bind(&campaign.name)
    .bind(&campaign.spec)
    .bind(&campaign.spec_digest)
    .bind(policy)
    .bind(&campaign.realisation)
    .bind(campaign.record)
    .bind(json(&campaign.wanted))
    .bind(now)
    .bind(campaign.priority)
    .bind(folder)
    .bind(&campaign.execution)
    .fetch_one(tx)
    .await
    .doing("store a campaign")
}

pub(crate) async fn append_jobs(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    jobs: &[NewJob],
) -> Result<(), StoreError> {
    let tasks: BTreeSet<&str> = jobs.iter().map(|job| job.task.as_str()).collect();
    sqlx::query(
        "INSERT OR IGNORE INTO campaign_task (campaign_id, task)
         SELECT ?, value FROM json_each(?)",
    )
    .bind(campaign)
    .bind(json(tasks))
    .execute(&mut *tx)
    .await
    .doing("store a campaign's tasks")?;
    for jobs in jobs.chunks(JOBS_PER_INSERT) {
        insert_some_jobs(&mut *tx, campaign, jobs).await?;
    }
    sqlx::query("UPDATE campaign SET jobs = jobs + ? WHERE id = ?")
        .bind(jobs.len() as i64)
        .bind(campaign)
        .execute(tx)
        .await
        .doing("count a campaign's jobs")
        .map(drop)
}

/// Returns a campaign's jobs of some tasks: their manifest rows, JSON, and replicates.
pub(crate) async fn rows_of_tasks(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    tasks: &BTreeSet<String>,
) -> Result<Vec<(String, u32)>, StoreError> {
    sqlx::query_as(
        "SELECT manifest_row, replicate FROM job
         WHERE campaign_id = ? AND task IN (SELECT value FROM json_each(?)) ORDER BY unit_order",
    )
    .bind(campaign)
    .bind(json(tasks))
    .fetch_all(tx)
    .await
    .doing("read a campaign's rows")
}

async fn insert_some_jobs(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    jobs: &[NewJob],
) -> Result<(), StoreError> {
    let mut insert: QueryBuilder<Sqlite> = QueryBuilder::new(
        "INSERT INTO job (campaign_id, rollout_id, replicate, task, init_id, unit_order,
             manifest_row, policy_seed) ",
    );
    insert.push_values(jobs, |mut row, job| {
        row.push_bind(campaign)
            .push_bind(&job.rollout_id)
            .push_bind(job.replicate)
            .push_bind(&job.task)
            .push_bind(job.init_id)
            .push_bind(job.unit_order)
            .push_bind(&job.manifest_row)
            .push_bind(job.policy_seed.cast_signed());
    });
    insert.build().execute(tx).await.doing("store jobs")?;
    Ok(())
}

/// Pins a campaign to the asset pack, simulator, renderer and look of its first result.
pub(crate) async fn pin(
    tx: &mut SqliteConnection,
    id: CampaignId,
    pin: &Pin,
    now: UnixMillis,
) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE campaign SET pinned_ms = ?, asset_pack = ?, asset_pack_digest = ?,
             mujoco_version = ?, renderer = ?, look = ?
         WHERE id = ? AND pinned_ms IS NULL",
    )
    .bind(now)
    .bind(&pin.asset_pack)
    .bind(&pin.asset_pack_digest)
    .bind(&pin.mujoco_version)
    .bind(&pin.renderer)
    .bind(pin.look.name())
    .bind(id)
    .execute(tx)
    .await
    .doing("pin a campaign")
    .map(drop)
}

pub(crate) async fn set_state(
    tx: &mut SqliteConnection,
    id: CampaignId,
    state: CampaignState,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE campaign SET state = ?, state_since_ms = ? WHERE id = ?")
        .bind(state.name())
        .bind(state.since())
        .bind(id)
        .execute(tx)
        .await
        .doing("store a campaign's state")
        .map(drop)
}

pub(crate) async fn set_priority(
    tx: &mut SqliteConnection,
    id: CampaignId,
    priority: i32,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE campaign SET priority = ? WHERE id = ?")
        .bind(priority)
        .bind(id)
        .execute(tx)
        .await
        .doing("store a campaign's priority")
        .map(drop)
}

pub(crate) async fn set_spec(
    tx: &mut SqliteConnection,
    id: CampaignId,
    spec: &str,
    spec_digest: &str,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE campaign SET spec = ?, spec_digest = ? WHERE id = ?")
        .bind(spec)
        .bind(spec_digest)
        .bind(id)
        .execute(tx)
        .await
        .doing("store a campaign's specification")
        .map(drop)
}

pub(crate) async fn set_policy(
    tx: &mut SqliteConnection,
    id: CampaignId,
    policy: PolicyId,
) -> Result<(), StoreError> {
    sqlx::query("UPDATE campaign SET policy_id = ? WHERE id = ?")
        .bind(policy)
        .bind(id)
        .execute(tx)
        .await
        .doing("store a campaign's policy")
        .map(drop)
}

/// Renames a campaign. Its files stay in their folder, and its former name is kept for error
/// messages.
pub(crate) async fn rename(
    tx: &mut SqliteConnection,
    campaign: &Campaign,
    name: &CampaignName,
) -> Result<(), StoreError> {
    take_name(tx, name).await?;
    sqlx::query("UPDATE campaign SET name = ?1, folder = nullif(?2, ?1) WHERE id = ?3")
        .bind(name)
        .bind(&campaign.folder)
        .bind(campaign.id)
        .execute(&mut *tx)
        .await
        .doing("rename a campaign")?;
    sqlx::query("INSERT INTO former_name (name, campaign_id) VALUES (?, ?)")
        .bind(&campaign.name)
        .bind(campaign.id)
        .execute(tx)
        .await
        .doing("store a campaign's former name")
        .map(drop)
}

/// Returns the current name of the campaign that had the former name `name`; `None` if no campaign
/// had it.
pub(crate) async fn renamed(
    tx: &mut SqliteConnection,
    name: &CampaignName,
) -> Result<Option<CampaignName>, StoreError> {
    sqlx::query_scalar(
        "SELECT c.name FROM former_name f JOIN campaign c ON c.id = f.campaign_id
         WHERE f.name = ?",
    )
    .bind(name)
    .fetch_optional(tx)
    .await
    .doing("find a former campaign name")
}

/// Releases a name for use by a campaign: the name is no longer another campaign's former name.
pub(crate) async fn take_name(
    tx: &mut SqliteConnection,
    name: &CampaignName,
) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM former_name WHERE name = ?")
        .bind(name)
        .execute(tx)
        .await
        .doing("release a former campaign name")
        .map(drop)
}

pub(crate) async fn delete(tx: &mut SqliteConnection, id: CampaignId) -> Result<(), StoreError> {
    // Jobs are deleted first, since deleting a row of `campaign_task` checks for jobs that refer to
    // it.
    for statement in ["DELETE FROM job WHERE campaign_id = ?", "DELETE FROM campaign WHERE id = ?"]
    {
        sqlx::query(statement).bind(id).execute(&mut *tx).await.doing("delete a campaign")?;
    }
    Ok(())
}
