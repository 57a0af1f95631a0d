//! Reading: one consistent view, however many questions it answers. The page, the
//! command line and reports use it; nothing that workers wait for does.

mod campaigns;
mod changes;
mod configurations;
mod forecast;
mod jobs;
mod results;
mod standing;

use std::ops::DerefMut;

use sqlx::{Sqlite, SqliteConnection, Transaction};

use crate::clock::UnixMillis;
use crate::store::{Store, StoreError};
use crate::timing::Timing;

pub use crate::store::campaigns::Campaign;
pub use campaigns::{CampaignStatus, Counts, RATE_WINDOW};
pub use changes::{Changes, Sizes};
pub use configurations::{ResultLine, RolloutLine};
pub use forecast::Forecast;
pub use jobs::{FailureLine, JobDetails, JobFilter, JobLine, MAX_JOBS_LISTED};
pub use results::{Edition, ExportedRow, RecordRow};
pub use standing::{MAX_WORKERS_LISTED, PolicyLine, QuarantinedLine, WorkerLine};

/// What is committed, as of one instant.
pub struct View {
    transaction: Transaction<'static, Sqlite>,
    /// The instant that ages are counted from.
    pub now: UnixMillis,
    timing: Timing,
    /// Why nothing is leased at the moment; none while jobs are leased.
    held: Option<String>,
}

impl View {
    pub(crate) async fn begin(
        store: &Store,
        now: UnixMillis,
        timing: Timing,
        held: Option<String>,
    ) -> Result<View, StoreError> {
        Ok(View {
            transaction: store.read().await?,
            now,
            timing,
            held,
        })
    }

    fn tx(&mut self) -> &mut SqliteConnection {
        self.transaction.deref_mut()
    }
}
