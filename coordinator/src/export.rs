//! Export of committed results with the reference's columns: one JSON object per line, ordered by
//! rollout id, then replicate.

use std::sync::Arc;

use benchmark::ManifestRow;
use futures_util::{Stream, StreamExt, TryStreamExt, stream};
use queue::ids::CampaignName;
use queue::read::ExportedRow;
use queue::{Queue, QueueError};
use report::ResultRow;

use crate::reading::ReadError;

/// Rows per database query.
const PAGE_ROWS: u32 = 1_000;

/// Returns the exported lines of a campaign as a stream that reads page by page on demand.
pub async fn lines(
    queue: Arc<Queue>,
    name: &CampaignName,
) -> Result<impl Stream<Item = Result<String, ReadError>> + Send + use<>, QueueError> {
    let campaign = queue.view().await?.campaign(name).await?;
    // The row after which the next page begins, with an empty id before the first row; `None` once
    // the last page was read.
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
    let ExportedRow { rollout_id, replicate, manifest_row, outcome } = result;
    let error = |source| ReadError::Row { rollout_id: rollout_id.clone(), source };
    let row: ManifestRow =
        serde_json::from_str(manifest_row).map_err(|problem| error(problem.into()))?;
    ResultRow::new(row, *replicate, policy, outcome).to_json().map_err(error)
}
