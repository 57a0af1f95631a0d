//! Read access: one consistent view for any number of queries. Used by the web page, the command
//! line and reports; workers never wait for a view. The types that are serialised are answers to
//! operators, printed by `--json` and read by Python: keys may be added but never changed or
//! removed, and are always present, with `null` for absent values.

/// SQL column with the policy's control steps of a leased `job`. The stored count comes from
/// heartbeats and includes the settling steps, which results and budgets exclude.
macro_rules! policy_steps {
    () => {
        "iif(control_steps IS NULL, NULL, max(0, control_steps
             - coalesce(json_extract(manifest_row, '$.num_steps_wait'), 0))) AS control_steps"
    };
}

mod campaigns;
mod changes;
mod configurations;
mod derivations;
mod forecast;
mod jobs;
mod results;
mod standing;

use std::collections::BTreeMap;
use std::ops::DerefMut;
use std::sync::Arc;

use sqlx::{Sqlite, SqliteConnection, Transaction};

use crate::clock::UnixMillis;
use crate::ids::WorkerId;
use crate::operations::means::MeansOfWorkers;
use crate::store::{Store, StoreError};
use crate::timing::Timing;

pub use crate::store::campaigns::Campaign;
pub use crate::store::outcomes::OutcomeRow;
pub use crate::store::results::StoredResult;
pub use crate::store::stops::EarlyStop;
pub use campaigns::{CampaignStatus, Counts, RATE_WINDOW, Stage};
pub use changes::{Changes, Sizes};
pub use configurations::{ResultLine, RolloutLine};
pub use derivations::SubsetRow;
pub use forecast::Forecast;
pub use jobs::{FailureLine, JobDetails, JobFilter, JobLine, MAX_JOBS_LISTED, ResultOrigin};
pub use results::{Edition, ExportedRow, RecordRow, SetupRow};
pub use standing::{MAX_WORKERS_LISTED, PolicyLine, QuarantinedLine, WorkerLine};

/// The committed database at one instant.
pub struct View {
    transaction: Transaction<'static, Sqlite>,
    /// Instant relative to which ages are computed.
    pub now: UnixMillis,
    timing: Timing,
    /// Reason why leasing is suspended; `None` while jobs are leased.
    held: Option<String>,
    /// Number of videos that each worker renders or uploads; workers without videos are absent.
    filming: BTreeMap<WorkerId, u32>,
    means: Arc<MeansOfWorkers>,
}

impl View {
    pub(crate) async fn begin(
        store: &Store,
        now: UnixMillis,
        timing: Timing,
        held: Option<String>,
        filming: BTreeMap<WorkerId, u32>,
        means: Arc<MeansOfWorkers>,
    ) -> Result<View, StoreError> {
        Ok(View { transaction: store.read().await?, now, timing, held, filming, means })
    }

    pub(crate) fn tx(&mut self) -> &mut SqliteConnection {
        self.transaction.deref_mut()
    }
}
