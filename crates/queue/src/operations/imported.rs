//! Comparison of an archive's rows with its campaign's specification. The invariants compare rows
//! with one another; the checks of this module refuse rows that this program would never have
//! stored and that would fail every claim or commit that reads them.

use std::collections::BTreeMap;
use std::sync::Arc;

use benchmark::manifest::{Difference, diff};
use benchmark::seeds::policy_seed;
use benchmark::{CampaignSpec, ManifestRow, RolloutId, Rollouts, SpecError, TaskKey};
use sqlx::SqliteConnection;

use super::batches::JOBS_PER_BATCH;
use super::records::on_blocking_thread;
use crate::ids::{CampaignId, JobId, NameError, WorkerId, json_problem};
use crate::store::imported::{self, StoredRow};
use crate::store::portable;
use crate::store::workers::MAX_SLOTS;
use crate::store::{Store, StoreError};

/// Rows of an archive that this program would not have stored.
#[derive(Debug, thiserror::Error)]
pub enum RowsError {
    #[error("expand the campaign's specification")]
    Specification(#[from] SpecError),
    #[error("find the campaign's rollouts: it holds {found}, and its specification has {expected}")]
    Expansion { found: u64, expected: u64 },
    #[error("read job {job}: {problem}")]
    Row { job: JobId, problem: RowProblem },
    #[error(transparent)]
    Worker(#[from] WorkerProblem),
}

/// A job of an archive that this program would not have stored.
#[derive(Debug, thiserror::Error)]
pub enum RowProblem {
    #[error("its manifest row cannot be read ({problem})")]
    Unreadable {
        /// Error of the parser, shortened.
        problem: String,
    },
    #[error("its `{column}` is not that of its manifest row")]
    Column { column: &'static str },
    #[error("the campaign's specification has no such rollout")]
    Unspecified,
    #[error(
        "the campaign's specification gives it another `{column}`; import the archive with the \
         release that wrote it"
    )]
    Altered { column: String },
}

/// A worker of an archive that no coordinator would have registered.
#[derive(Debug, thiserror::Error)]
pub enum WorkerProblem {
    #[error(transparent)]
    Id(#[from] NameError),
    #[error("read worker `{worker}`: its `{column}` is {given}, and a worker has 1 to {MAX_SLOTS}")]
    Count { worker: WorkerId, column: &'static str, given: i64 },
}

/// Rows that a design expands to, and the number of their replicates; `None` if clients send rows.
type Expansion = Option<(BTreeMap<RolloutId, ManifestRow>, u32)>;

/// Checks the jobs, results and workers of a database that holds one campaign. Returns the first
/// contradiction with the campaign's specification or the bounds of this program; `None` if there
/// is none.
pub(super) async fn contradiction(
    view: &mut SqliteConnection,
    campaign: CampaignId,
    spec: &str,
) -> Result<Option<RowsError>, StoreError> {
    for (id, slots, cores) in imported::worker_sizes(view).await? {
        if let Err(problem) = check_worker(&id, slots, cores) {
            return Ok(Some(problem.into()));
        }
    }
    let spec = spec.to_owned();
    let expansion = match on_blocking_thread(move || expand(&spec)).await {
        Ok(expansion) => Arc::new(expansion),
        Err(error) => return Ok(Some(error.into())),
    };
    let jobs = portable::jobs(view, campaign).await?;
    if let Some((rows, replicates)) = expansion.as_ref() {
        let expected = rows.len() as u64 * u64::from(*replicates);
        let found = jobs.len() as u64;
        if found != expected {
            return Ok(Some(RowsError::Expansion { found, expected }));
        }
    }
    for batch in jobs.chunks(JOBS_PER_BATCH) {
        let rows = imported::rows_of(view, batch).await?;
        let expansion = expansion.clone();
        let contradicts = move |row: &StoredRow| check_row(row, &expansion).err();
        if let Some(error) = on_blocking_thread(move || rows.iter().find_map(contradicts)).await {
            return Ok(Some(error));
        }
    }
    Ok(None)
}

fn expand(spec: &str) -> Result<Expansion, SpecError> {
    let spec = CampaignSpec::from_json(spec)?;
    let Rollouts::Design(_) = spec.rollouts else { return Ok(None) };
    let rows = spec.expand()?.into_iter().map(|row| (row.id, row));
    Ok(Some((rows.collect(), spec.replicates)))
}

fn check_worker(id: &str, slots: i64, cores: Option<i64>) -> Result<(), WorkerProblem> {
    let worker = WorkerId::parse(id)?;
    let counts = [("slots", Some(slots)), ("cores", cores)];
    for (column, given) in counts {
        if let Some(given) = given
            && !(1..=i64::from(MAX_SLOTS)).contains(&given)
        {
            return Err(WorkerProblem::Count { worker, column, given });
        }
    }
    Ok(())
}

fn check_row(stored: &StoredRow, expansion: &Expansion) -> Result<(), RowsError> {
    let checked = parse(stored).and_then(|row| compare(stored, &row, expansion));
    checked.map_err(|problem| RowsError::Row { job: stored.id, problem })
}

fn parse(stored: &StoredRow) -> Result<ManifestRow, RowProblem> {
    serde_json::from_str(&stored.manifest_row)
        .map_err(|error| RowProblem::Unreadable { problem: json_problem(error) })
}

fn compare(stored: &StoredRow, row: &ManifestRow, expansion: &Expansion) -> Result<(), RowProblem> {
    let column = |column| Err(RowProblem::Column { column });
    if stored.rollout_id != row.id.to_string() {
        return column("rollout_id");
    }
    if stored.task != TaskKey::of_row(row) {
        return column("task");
    }
    if stored.init_id != i64::from(row.init_id) {
        return column("init_id");
    }
    let Ok(replicate) = u32::try_from(stored.replicate) else {
        return column("replicate");
    };
    if stored.policy_seed.cast_unsigned() != policy_seed(&row.id, replicate) {
        return column("policy_seed");
    }
    let Some((rows, replicates)) = expansion else {
        return Ok(());
    };
    let expected = rows.get(&row.id).filter(|_| replicate < *replicates);
    let expected = expected.ok_or(RowProblem::Unspecified)?;
    if row == expected {
        return Ok(());
    }
    let differing = diff(std::slice::from_ref(expected), std::slice::from_ref(row));
    Err(RowProblem::Altered {
        column: match differing.into_iter().next() {
            Some(Difference::Value { column, .. }) => column,
            _ => "manifest_row".to_owned(),
        },
    })
}

/// Returns true if every step budget of a derived campaign also occurs in its source.
pub(super) async fn has_budgets_of(
    (derived, campaign): (&Store, CampaignId),
    (local, source): (&Store, CampaignId),
) -> Result<bool, StoreError> {
    let source_budgets = imported::budgets(&mut *local.read().await?, source).await?;
    let budgets = imported::budgets(&mut *derived.read().await?, campaign).await?;
    Ok(budgets.is_subset(&source_budgets))
}
