//! Statements that copy one campaign with all dependent rows from another database, which is
//! attached as the schema `source`.
//!
//! Columns are copied by name, so a column that a later migration adds is copied automatically; a
//! new table must be added to the lists here.

use sqlx::{AssertSqlSafe, SqliteConnection};

use super::{Doing, StoreError, policies};
use crate::clock::UnixMillis;
use crate::ids::{CampaignId, CampaignName, JobId};

/// Name and specification of a copied campaign in its new database.
#[derive(Clone, Debug)]
pub(crate) struct CopyTarget {
    pub(crate) name: CampaignName,
    /// Specification under the new name, JSON.
    pub(crate) spec: String,
    /// SHA-256 of the specification, hex.
    pub(crate) spec_digest: String,
    /// Folder of the campaign's files below the artifacts folder.
    pub(crate) folder: String,
}

/// Parts of the statement that copies the rows of one table.
struct TableCopy {
    table: &'static str,
    /// The `FROM` clause; the copied rows have the alias `s`.
    from: &'static str,
    /// Columns with a changed value, and its SQL; NULL as an `id` makes a new row number.
    values: &'static [(&'static str, &'static str)],
    /// SQL that follows the `FROM` clause.
    tail: &'static str,
}

/// The column of the campaign's id, with its new value from the temporary table `moved`.
const CAMPAIGN: (&str, &str) = ("campaign_id", "(SELECT new FROM temp.moved)");
/// The column of the job's id, with its new value from the temporary table `moved_job`.
const JOB: (&str, &str) = ("job_id", "m.new");

/// Error text stored with an attempt that was in progress when its campaign was copied.
const MOVED: &str = "the campaign was copied while this attempt ran";

/// Tables whose rows are copied, in order. `CROSS JOIN` makes SQLite start from the copied jobs,
/// which may be a small part of all jobs.
const COPIED: [TableCopy; 10] = [
    TableCopy {
        table: "campaign_task",
        from: "source.campaign_task s WHERE s.campaign_id = (SELECT old FROM temp.moved)",
        values: &[CAMPAIGN],
        tail: " ORDER BY s.task ON CONFLICT DO NOTHING",
    },
    // Workers are copied as signed off: none of them works for this coordinator.
    TableCopy {
        table: "worker",
        from: "source.worker s JOIN (SELECT worker_id, max(committed_ms) AS last_ms
                   FROM source.result WHERE campaign_id = (SELECT old FROM temp.moved)
                   GROUP BY worker_id) r ON r.worker_id = s.id WHERE TRUE",
        values: &[
            ("last_seen_ms", "r.last_ms"),
            ("signed_off_ms", "r.last_ms"),
            ("charged_in_a_row", "0"),
            ("stopped_reason", "NULL"),
        ],
        tail: " ORDER BY s.id ON CONFLICT (id) DO NOTHING",
    },
    TableCopy {
        table: "provenance",
        from: "source.provenance s WHERE s.id IN (SELECT old FROM temp.moved_origin)",
        values: &[("id", "NULL")],
        tail: " ORDER BY s.id ON CONFLICT DO NOTHING",
    },
    // A committed job is copied as leased until its result is stored, as the schema requires.
    TableCopy {
        table: "job",
        from: "temp.moved_job m CROSS JOIN source.job s ON s.id = m.old
               LEFT JOIN source.result r ON r.job_id = s.id WHERE TRUE",
        values: &[
            ("id", "m.new"),
            CAMPAIGN,
            (
                "state",
                "CASE s.state WHEN 'committed' THEN 'leased' WHEN 'leased' THEN 'queued'
                     ELSE s.state END",
            ),
            ("not_before_ms", "iif(s.state IN ('queued', 'leased'), 0, NULL)"),
            ("lease_owner", "r.worker_id"),
            ("leased_ms", "r.committed_ms"),
            ("lease_expires_ms", "r.committed_ms"),
            ("ceiling_ms", "r.committed_ms"),
            ("control_steps", "iif(r.job_id IS NULL, NULL, 0)"),
            ("claim_id", "iif(r.job_id IS NULL, NULL, '')"),
            ("acknowledged", "iif(r.job_id IS NULL, NULL, 1)"),
            ("attempt_id", "(SELECT new FROM temp.moved_attempt WHERE old = r.attempt_id)"),
        ],
        tail: " ORDER BY m.new",
    },
    TableCopy {
        table: "result",
        from: "temp.moved_job m CROSS JOIN source.result s ON s.job_id = m.old
               JOIN temp.moved_attempt a ON a.old = s.attempt_id
               JOIN temp.moved_origin o ON o.old = s.provenance_id WHERE TRUE",
        values: &[CAMPAIGN, JOB, ("attempt_id", "a.new"), ("provenance_id", "o.new")],
        tail: " ORDER BY m.new",
    },
    TableCopy {
        table: "motion",
        from: "temp.moved_job m CROSS JOIN source.motion s ON s.job_id = m.old WHERE TRUE",
        values: &[JOB],
        tail: " ORDER BY m.new",
    },
    TableCopy {
        table: "divergence",
        from: "temp.moved_job m CROSS JOIN source.divergence s ON s.job_id = m.old
               JOIN temp.moved_origin o ON o.old = s.provenance_id WHERE TRUE",
        values: &[("id", "NULL"), JOB, ("provenance_id", "o.new")],
        tail: " ORDER BY s.id",
    },
    TableCopy {
        table: "failure",
        from: "temp.moved_job m CROSS JOIN source.failure s ON s.job_id = m.old
               JOIN temp.moved_attempt a ON a.old = s.attempt_id WHERE TRUE",
        values: &[
            JOB,
            ("attempt_id", "a.new"),
            // The attempt cannot be resumed, since a worker that reconnects reports its result to
            // the original coordinator.
            ("leased_ms", "NULL"),
            ("ceiling_ms", "NULL"),
        ],
        tail: " ORDER BY m.new, s.attempt",
    },
    TableCopy {
        table: "artifact",
        from: "temp.moved_attempt a CROSS JOIN source.artifact s ON s.attempt_id = a.old
               WHERE TRUE",
        values: &[
            ("attempt_id", "a.new"),
            // The text after the last slash is the file name.
            (
                "path",
                "'artifacts/' || (SELECT folder FROM temp.moved) || '/'
                     || replace(s.path, rtrim(s.path, replace(s.path, '/', '')), '')",
            ),
        ],
        tail: " ORDER BY s.path, s.kind",
    },
    // Copied last, because a stopped campaign must hold no lease.
    TableCopy {
        table: "stop",
        from: "source.stop s WHERE s.campaign_id = (SELECT old FROM temp.moved)",
        values: &[CAMPAIGN],
        tail: "",
    },
];

/// Tables with rows per campaign rather than per job. Their rows must exist before the first job is
/// copied.
const PER_CAMPAIGN: [&str; 2] = ["campaign_task", "worker"];

/// Row of the campaign in table `campaign`, which all other copied rows refer to.
const CAMPAIGN_ROW: TableCopy = TableCopy {
    table: "campaign",
    from: "source.campaign s JOIN temp.moved m ON m.old = s.id WHERE TRUE",
    values: &[
        ("id", "NULL"),
        ("name", "m.name"),
        ("spec", "m.spec"),
        ("spec_digest", "m.spec_digest"),
        ("policy_id", "m.policy"),
        ("folder", "nullif(m.folder, m.name)"),
    ],
    tail: " RETURNING id",
};

/// Tables that are not copied. Health of policies and pending removals concern one coordinator
/// only; the specification names the source of a derived campaign; triggers count the copied rows.
#[cfg(test)]
const NOT_COPIED: [&str; 8] = [
    "_sqlx_migrations",
    "policy",
    "removal",
    "former_name",
    "passage",
    "tally",
    "origin_tally",
    "ending_tally",
];

/// Copies a campaign from the schema `source`. Leases end without a charge: their jobs wait again.
pub(crate) async fn copy(
    tx: &mut SqliteConnection,
    old: CampaignId,
    target: &CopyTarget,
    now: UnixMillis,
) -> Result<CampaignId, StoreError> {
    begin(tx, old).await?;
    let new = copy_row(tx, old, target, now).await?;
    run(
        tx,
        "INSERT INTO temp.moved_job
         SELECT id, (SELECT seq FROM main.sqlite_sequence WHERE name = 'job')
             + row_number() OVER (ORDER BY unit_order)
         FROM source.job WHERE campaign_id = (SELECT old FROM temp.moved)",
    )
    .await?;
    copy_rows(tx, new, |_| true).await?;
    end(tx).await?;
    Ok(new)
}

/// Copies a campaign like [`copy`], but without its jobs, stop and state, which [`copy_batch`] and
/// [`copy_stop_and_state`] copy.
pub(crate) async fn copy_without_jobs(
    tx: &mut SqliteConnection,
    old: CampaignId,
    target: &CopyTarget,
    now: UnixMillis,
) -> Result<CampaignId, StoreError> {
    begin(tx, old).await?;
    let new = copy_row(tx, old, target, now).await?;
    copy_rows(tx, new, |table| PER_CAMPAIGN.contains(&table)).await?;
    end(tx).await?;
    Ok(new)
}

/// Copies some jobs with their dependent rows. The new job numbers follow the order of `jobs` and
/// are higher than those of all jobs that ever existed in this database.
pub(crate) async fn copy_batch(
    tx: &mut SqliteConnection,
    (campaign, old): (CampaignId, CampaignId),
    folder: &str,
    jobs: &[JobId],
) -> Result<(), StoreError> {
    begin(tx, old).await?;
    sqlx::query("UPDATE temp.moved SET new = ?, folder = ?")
        .bind(campaign)
        .bind(folder)
        .execute(&mut *tx)
        .await
        .doing("copy a campaign")?;
    sqlx::query(
        "INSERT INTO temp.moved_job
         SELECT value, (SELECT seq FROM main.sqlite_sequence WHERE name = 'job')
             + row_number() OVER (ORDER BY key) FROM json_each(?)",
    )
    .bind(super::json(jobs))
    .execute(&mut *tx)
    .await
    .doing("copy a campaign")?;
    let is_per_job = |table: &str| !PER_CAMPAIGN.contains(&table) && table != "stop";
    copy_rows(tx, campaign, is_per_job).await?;
    end(tx).await
}

/// Returns the jobs of a campaign, in its order of jobs.
pub(crate) async fn jobs(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
) -> Result<Vec<JobId>, StoreError> {
    sqlx::query_scalar("SELECT id FROM job WHERE campaign_id = ? ORDER BY unit_order")
        .bind(campaign)
        .fetch_all(tx)
        .await
        .doing("list the jobs of the campaign to copy")
}

/// Copies the early stop and the state of the campaign, which require that all jobs are present.
pub(crate) async fn copy_stop_and_state(
    tx: &mut SqliteConnection,
    (campaign, old): (CampaignId, CampaignId),
) -> Result<(), StoreError> {
    begin(tx, old).await?;
    sqlx::query("UPDATE temp.moved SET new = ?")
        .bind(campaign)
        .execute(&mut *tx)
        .await
        .doing("copy a campaign")?;
    copy_rows(tx, campaign, |table| table == "stop").await?;
    run(
        tx,
        "UPDATE main.campaign SET (state, state_since_ms, created_ms) =
             (SELECT s.state, s.state_since_ms, s.created_ms FROM source.campaign s
              JOIN temp.moved m ON m.old = s.id)
         WHERE id = (SELECT new FROM temp.moved)",
    )
    .await?;
    end(tx).await
}

/// Copies the row of a campaign, and finds or stores its policy.
async fn copy_row(
    tx: &mut SqliteConnection,
    old: CampaignId,
    target: &CopyTarget,
    now: UnixMillis,
) -> Result<CampaignId, StoreError> {
    let (endpoint, policy): (String, String) = sqlx::query_as(
        "SELECT p.endpoint, p.name FROM source.campaign c
         JOIN source.policy p ON p.id = c.policy_id WHERE c.id = ?",
    )
    .bind(old)
    .fetch_one(&mut *tx)
    .await
    .doing("read the policy of a campaign")?;
    let policy = policies::find_or_insert(tx, &endpoint, &policy, now).await?;
    sqlx::query(
        "UPDATE temp.moved SET policy = ?, name = ?, spec = ?, spec_digest = ?, folder = ?",
    )
    .bind(policy)
    .bind(&target.name)
    .bind(&target.spec)
    .bind(&target.spec_digest)
    .bind(&target.folder)
    .execute(&mut *tx)
    .await
    .doing("copy a campaign")?;
    let statement = CAMPAIGN_ROW.statement(tx).await?;
    let new: CampaignId = sqlx::query_scalar(AssertSqlSafe(statement))
        .fetch_one(&mut *tx)
        .await
        .doing("copy a campaign")?;
    sqlx::query("UPDATE temp.moved SET new = ?")
        .bind(new)
        .execute(&mut *tx)
        .await
        .doing("copy a campaign")?;
    Ok(new)
}

/// Creates temporary tables that map old row numbers to new ones.
async fn begin(tx: &mut SqliteConnection, old: CampaignId) -> Result<(), StoreError> {
    run(
        tx,
        "CREATE TEMP TABLE moved (old INTEGER, new INTEGER, policy INTEGER, name TEXT,
             spec TEXT, spec_digest TEXT, folder TEXT);
         CREATE TEMP TABLE moved_job (old INTEGER PRIMARY KEY, new INTEGER NOT NULL);
         CREATE TEMP TABLE moved_attempt (old TEXT PRIMARY KEY, new TEXT NOT NULL);
         CREATE TEMP TABLE moved_origin (old INTEGER PRIMARY KEY, new INTEGER)",
    )
    .await?;
    sqlx::query("INSERT INTO temp.moved (old) VALUES (?)")
        .bind(old)
        .execute(tx)
        .await
        .doing("copy a campaign")
        .map(drop)
}

/// Drops the temporary tables.
async fn end(tx: &mut SqliteConnection) -> Result<(), StoreError> {
    run(
        tx,
        "DROP TABLE temp.moved; DROP TABLE temp.moved_job; DROP TABLE temp.moved_attempt;
         DROP TABLE temp.moved_origin",
    )
    .await
}

/// Copies, from the tables that `is_wanted` selects, the rows of the campaign and of the jobs in
/// `moved_job`.
async fn copy_rows(
    tx: &mut SqliteConnection,
    campaign: CampaignId,
    is_wanted: impl Fn(&str) -> bool,
) -> Result<(), StoreError> {
    assign_attempt_ids(tx).await?;
    for copied in COPIED.iter().filter(|table| is_wanted(table.table)) {
        let statement = copied.statement(tx).await?;
        run(tx, &statement).await?;
        match copied.table {
            "provenance" => find_origins(tx).await?,
            "result" => commit_jobs(tx, campaign).await?,
            _ => {}
        }
    }
    end_leases(tx).await
}

/// Assigns ids to the copied attempts: the original id, or a new one if the original id exists in
/// this database, which then holds the original campaign as well.
async fn assign_attempt_ids(tx: &mut SqliteConnection) -> Result<(), StoreError> {
    run(
        tx,
        "INSERT INTO temp.moved_attempt
         SELECT id, iif(EXISTS (SELECT 1 FROM main.result WHERE attempt_id = id)
                 OR EXISTS (SELECT 1 FROM main.failure WHERE attempt_id = id)
                 OR EXISTS (SELECT 1 FROM main.job WHERE state = 'leased' AND attempt_id = id),
             lower(hex(randomblob(16))), id)
         FROM (SELECT attempt_id AS id FROM source.result
                   WHERE job_id IN (SELECT old FROM temp.moved_job)
               UNION ALL SELECT attempt_id FROM source.failure
                   WHERE job_id IN (SELECT old FROM temp.moved_job)
               UNION ALL SELECT attempt_id FROM source.job
                   WHERE state = 'leased' AND id IN (SELECT old FROM temp.moved_job));
         INSERT INTO temp.moved_origin (old)
         SELECT provenance_id FROM source.result WHERE job_id IN (SELECT old FROM temp.moved_job)
         UNION SELECT provenance_id FROM source.divergence
             WHERE job_id IN (SELECT old FROM temp.moved_job)",
    )
    .await
}

/// Maps the copied origins to their rows in this database.
async fn find_origins(tx: &mut SqliteConnection) -> Result<(), StoreError> {
    let columns = columns(tx, "provenance").await?;
    let columns = columns.iter().filter(|name| *name != "id");
    let same: Vec<String> = columns.map(|name| format!("n.{name} IS o.{name}")).collect();
    let statement = format!(
        "UPDATE temp.moved_origin SET new = (SELECT n.id FROM main.provenance n
             JOIN source.provenance o ON {} WHERE o.id = moved_origin.old)",
        same.join(" AND ")
    );
    run(tx, &statement).await
}

/// Marks the jobs whose results were copied as committed.
async fn commit_jobs(tx: &mut SqliteConnection, campaign: CampaignId) -> Result<(), StoreError> {
    sqlx::query(
        "UPDATE main.job SET state = 'committed', lease_owner = NULL, leased_ms = NULL,
             lease_expires_ms = NULL, ceiling_ms = NULL, control_steps = NULL, claim_id = NULL,
             acknowledged = NULL, attempt_id = NULL
         WHERE campaign_id = ? AND state = 'leased'",
    )
    .bind(campaign)
    .execute(tx)
    .await
    .doing("copy a campaign's results")
    .map(drop)
}

/// Ends copied attempts that were in progress, without a charge.
async fn end_leases(tx: &mut SqliteConnection) -> Result<(), StoreError> {
    sqlx::query(
        "INSERT INTO main.failure (attempt_id, job_id, attempt, worker_id, failed_ms, reason,
             charged, error)
         SELECT a.new, m.new, s.attempt, s.lease_owner, s.leased_ms, 'draining', 0, ?
         FROM temp.moved_job m CROSS JOIN source.job s ON s.id = m.old
         JOIN temp.moved_attempt a ON a.old = s.attempt_id
         WHERE s.state = 'leased' ORDER BY m.new",
    )
    .bind(MOVED)
    .execute(tx)
    .await
    .doing("copy a campaign's leases")
    .map(drop)
}

impl TableCopy {
    /// Returns the statement that copies the rows.
    async fn statement(&self, tx: &mut SqliteConnection) -> Result<String, StoreError> {
        let columns = columns(tx, self.table).await?;
        let value = |column: &String| {
            let changed = self.values.iter().find(|(name, _)| name == column);
            changed.map_or_else(|| format!("s.{column}"), |(_, value)| (*value).to_owned())
        };
        let values: Vec<String> = columns.iter().map(value).collect();
        Ok(format!(
            "INSERT INTO main.{} ({}) SELECT {} FROM {}{}",
            self.table,
            columns.join(", "),
            values.join(", "),
            self.from,
            self.tail,
        ))
    }
}

async fn columns(tx: &mut SqliteConnection, table: &str) -> Result<Vec<String>, StoreError> {
    sqlx::query_scalar("SELECT name FROM pragma_table_info(?, 'main') ORDER BY cid")
        .bind(table)
        .fetch_all(tx)
        .await
        .doing("read a table's columns")
}

/// Runs constant SQL statements without parameters.
async fn run(tx: &mut SqliteConnection, statements: &str) -> Result<(), StoreError> {
    sqlx::raw_sql(AssertSqlSafe(statements.to_owned()))
        .execute(tx)
        .await
        .doing("copy a campaign")
        .map(drop)
}

/// Removes values that depend on a database's history, so that databases with equal campaigns are
/// equal: instants of migrations, revisions, and counters that are zero.
pub(crate) async fn erase_history(tx: &mut SqliteConnection) -> Result<(), StoreError> {
    run(
        tx,
        "UPDATE _sqlx_migrations SET installed_on = '1970-01-01 00:00:00', execution_time = 0;
         UPDATE tally SET revision = 0;
         DELETE FROM origin_tally WHERE results = 0;
         DELETE FROM ending_tally WHERE attempts = 0",
    )
    .await
}

/// Removes the rows of videos whose files are missing.
pub(crate) async fn remove_artifacts(
    tx: &mut SqliteConnection,
    missing: &[String],
) -> Result<(), StoreError> {
    sqlx::query("DELETE FROM artifact WHERE path IN (SELECT value FROM json_each(?))")
        .bind(super::json(missing))
        .execute(tx)
        .await
        .doing("remove the rows of missing videos")
        .map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;

    #[tokio::test]
    async fn every_table_is_copied_or_explicitly_excluded() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(folder.path()).await.expect("a database");
        let mut view = store.read().await.expect("a view");
        let mut tables: Vec<String> = sqlx::query_scalar(
            "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%'",
        )
        .fetch_all(&mut *view)
        .await
        .expect("tables");
        let copied = COPIED.iter().chain([&CAMPAIGN_ROW]);
        let mut known: Vec<&str> = copied.map(|copied| copied.table).collect();
        known.extend(NOT_COPIED);
        known.sort_unstable();
        tables.sort_unstable();
        assert_eq!(tables, known, "name new tables in COPIED or NOT_COPIED");
        for copied in COPIED.iter().chain([&CAMPAIGN_ROW]) {
            let columns = columns(&mut view, copied.table).await.expect("columns");
            for (column, _) in copied.values {
                assert!(columns.iter().any(|name| name == column), "{column}");
            }
        }
    }
}
