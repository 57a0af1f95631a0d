//! Export of committed results in the reference's row format: one JSON object per line, ordered by
//! rollout id, then replicate.

use std::sync::Arc;

use benchmark::{Condition, Execution, Level, ManifestRow, RolloutId, Suite};
use futures_util::{Stream, StreamExt, TryStreamExt, stream};
use queue::ids::CampaignName;
use queue::read::ExportedRow;
use queue::{Queue, QueueError};
use serde::Serialize;

use crate::reading::ReadError;

/// Rows per database query.
const PAGE_ROWS: u32 = 1_000;

/// Exported row: the reference's columns in its order, then the replicate and optional columns: the
/// radius of a placebo, the execution model unless it is `wait`, the protocol
/// of LIBERO's family or of a suite file, the goal's progress if the worker reported it, and the
/// prompt of a rollout with a protocol.
#[derive(Serialize)]
struct ExportRow<'a> {
    rollout_id: RolloutId,
    success: bool,
    steps: u32,
    axis: Condition,
    level: Level,
    suite: Suite,
    task_id: u8,
    init_id: u16,
    config: Option<u16>,
    policy: &'a str,
    wall_s: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    ik_res_mm: Option<f64>,
    replicate: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    placebo_radius: Option<f64>,
    #[serde(skip_serializing_if = "Execution::is_wait")]
    execution: Execution,
    #[serde(skip_serializing_if = "Option::is_none")]
    protocol: Option<String>,
    goal_predicates: u32,
    goal_at_end: u32,
    goal_at_most: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    prompt: Option<&'a str>,
}

/// Returns the exported lines of a campaign as a stream that reads page by page on demand.
pub async fn lines(
    queue: Arc<Queue>,
    name: &CampaignName,
) -> Result<impl Stream<Item = Result<String, ReadError>> + Send + use<>, QueueError> {
    let campaign = queue.view().await?.campaign(name).await?;
    // Last row of the previous page; `None` once the last page was read.
    let before_first_row: Option<(String, u32)> = Some((String::new(), 0));
    let pages = stream::try_unfold((queue, before_first_row), move |(queue, last)| async move {
        let Some((rollout_id, replicate)) = last else {
            return Ok::<_, ReadError>(None);
        };
        // A new view per page: a view held open by a slow reader would keep SQLite from
        // checkpointing the write-ahead log.
        let after = (!rollout_id.is_empty()).then_some((rollout_id.as_str(), replicate));
        let mut view = queue.view().await?;
        let rows = view.exported(campaign.id, after, PAGE_ROWS).await?;
        let is_last = rows.len() < PAGE_ROWS as usize;
        let next = rows.last().filter(|_| !is_last);
        let next = next.map(|row| (row.rollout_id.clone(), row.replicate));
        Ok(Some((rows, (queue, next))))
    });
    let rows = pages.map_ok(|rows| stream::iter(rows).map(Ok::<_, ReadError>)).try_flatten();
    let policy = campaign.policy;
    Ok(rows.map(move |row| line(&row?, &policy)))
}

fn line(result: &ExportedRow, policy: &str) -> Result<String, ReadError> {
    let row_error = |error: serde_json::Error| ReadError::Row {
        rollout_id: result.rollout_id.clone(),
        source: error.into(),
    };
    let row: ManifestRow = serde_json::from_str(&result.manifest_row).map_err(row_error)?;
    let (task, outcome) = (row.id.task(), &result.outcome);
    serde_json::to_string(&ExportRow {
        rollout_id: row.id,
        success: outcome.success,
        steps: outcome.steps,
        axis: row.id.condition(),
        level: row.id.level(),
        suite: task.suite(),
        task_id: task.index(),
        init_id: row.init_id,
        config: row.id.config(),
        policy,
        wall_s: outcome.wall_secs,
        ik_res_mm: outcome.ik.map(|ik| ik.residual_mm),
        replicate: result.replicate,
        placebo_radius: row.placebo_radius.map(Level::radius),
        execution: row.execution,
        protocol: row.protocol,
        goal_predicates: outcome.goal.predicates,
        goal_at_end: outcome.goal.at_end,
        goal_at_most: outcome.goal.at_most,
        // The prompt of a rollout of LIBERO-CTRL is the instruction of its manifest row.
        prompt: outcome.prompt.as_deref().filter(|_| row.id.variant().is_some()),
    })
    .map_err(row_error)
}
