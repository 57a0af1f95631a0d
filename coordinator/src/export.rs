//! Committed results as the reference's result rows, one JSON object a line, in
//! a stable order: by rollout id, then replicate.

use std::collections::VecDeque;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use protocol::{Condition, Level, ManifestRow, RolloutId, Suite};
use serde::Serialize;
use tokio_stream::Stream;

use crate::ids::{CampaignId, CampaignName};
use crate::queue::{Queue, QueueError};
use crate::store::results::{self, ResultRow};
use crate::store::{StoreError, campaigns};

/// Results read at a time.
const PAGE_ROWS: u32 = 1_000;

/// Results that cannot be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The campaign or the database.
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// A stored manifest row does not read back.
    #[error("read the stored manifest row of `{rollout_id}`")]
    Row {
        /// Whose.
        rollout_id: String,
        /// What is wrong with it.
        source: serde_json::Error,
    },
}

/// The lines of one campaign, read page by page while they are taken.
pub struct Export {
    queue: Arc<Queue>,
    campaign: CampaignId,
    policy: String,
    lines: VecDeque<String>,
    last: Option<(String, u32)>,
    loading: Option<Pin<Box<dyn Future<Output = Page> + Send>>>,
    finished: bool,
}

type Page = Result<Vec<ResultRow>, StoreError>;

/// The reference's columns, in its order, and the replicate where it is not the
/// first.
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
    #[serde(skip_serializing_if = "Option::is_none")]
    replicate: Option<u32>,
}

impl Export {
    /// Begins to export a campaign.
    ///
    /// # Errors
    /// When there is no such campaign or the database fails.
    pub async fn begin(queue: Arc<Queue>, name: &CampaignName) -> Result<Export, QueueError> {
        let mut tx = queue.store().read().await?;
        let row = campaigns::by_name(&mut tx, name).await?;
        let row = row.ok_or_else(|| QueueError::UnknownCampaign {
            campaign: name.clone(),
        })?;
        Ok(Export {
            queue,
            campaign: row.id,
            policy: row.policy,
            lines: VecDeque::new(),
            last: None,
            loading: None,
            finished: false,
        })
    }

    fn load(&self) -> Pin<Box<dyn Future<Output = Page> + Send>> {
        let queue = self.queue.clone();
        let campaign = self.campaign;
        let last = self.last.clone();
        Box::pin(async move {
            // A view per page: one that lived as long as a slow reader would
            // keep the write-ahead log from being moved.
            let mut tx = queue.store().read().await?;
            let after = last
                .as_ref()
                .map(|(id, replicate)| (id.as_str(), *replicate));
            results::page(&mut tx, campaign, after, PAGE_ROWS).await
        })
    }

    fn take_page(&mut self, rows: Vec<ResultRow>) -> Result<(), ExportError> {
        self.finished = rows.len() < PAGE_ROWS as usize;
        for row in rows {
            self.lines.push_back(line(&row, &self.policy)?);
            self.last = Some((row.rollout_id, row.replicate));
        }
        Ok(())
    }
}

impl Stream for Export {
    type Item = Result<String, ExportError>;

    fn poll_next(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let this = self.get_mut();
        loop {
            if let Some(line) = this.lines.pop_front() {
                return Poll::Ready(Some(Ok(line)));
            }
            if this.finished {
                return Poll::Ready(None);
            }
            let mut loading = this.loading.take().unwrap_or_else(|| this.load());
            let Poll::Ready(page) = loading.as_mut().poll(cx) else {
                this.loading = Some(loading);
                return Poll::Pending;
            };
            let page = page.map_err(|error| ExportError::Queue(error.into()));
            if let Err(error) = page.and_then(|rows| this.take_page(rows)) {
                this.finished = true;
                this.lines.clear();
                return Poll::Ready(Some(Err(error)));
            }
        }
    }
}

fn line(result: &ResultRow, policy: &str) -> Result<String, ExportError> {
    let in_row = |source| ExportError::Row {
        rollout_id: result.rollout_id.clone(),
        source,
    };
    let row: ManifestRow = serde_json::from_str(&result.manifest_row).map_err(in_row)?;
    let task = row.id.task();
    serde_json::to_string(&ExportRow {
        rollout_id: row.id,
        success: result.success,
        steps: result.steps,
        axis: row.id.condition(),
        level: row.id.level(),
        suite: task.suite(),
        task_id: task.index(),
        init_id: row.init_id,
        config: row.id.config(),
        policy,
        wall_s: result.wall_secs,
        ik_res_mm: result.ik_residual_mm,
        replicate: (result.replicate > 0).then_some(result.replicate),
    })
    .map_err(in_row)
}
