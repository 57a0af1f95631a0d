//! Rows that clients add to a campaign.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::manifest::{Difference, diff};
use benchmark::{CampaignSpec, ManifestRow, RolloutId, Rollouts, TaskKey};

use super::batches::JOBS_PER_BATCH;
use super::campaigns::{Created, check_not_ended};
use super::context::Context;
use super::error::QueueError;
use super::records::{on_blocking_thread, specification};
use crate::expand::{NewCampaign, NewJob, differing_fields};
use crate::ids::CampaignName;
use crate::queue::Queue;
use crate::store::budgets::{self, Budget};
use crate::store::campaigns::{self, Campaign};
use crate::store::failpoint::Step;
use crate::store::{Doing, undecodable};

/// A row to be added to a campaign.
#[derive(Clone, Debug)]
pub struct AppendedRow {
    pub row: ManifestRow,
    /// Replicates to run; if empty, all of the campaign's specification.
    pub replicates: Vec<u32>,
}

/// Rows, jobs and step budgets against which added rows are checked.
struct Present {
    spec: CampaignSpec,
    /// Rows that the campaign has of the tasks of the added ones, and their jobs.
    rows: BTreeMap<RolloutId, ManifestRow>,
    jobs: BTreeSet<(RolloutId, u32)>,
    /// Step budgets of the source of a campaign with a purpose; `None` in other campaigns.
    budgets: Option<BTreeSet<Budget>>,
    /// Place of the first new job in the campaign's order.
    first: i64,
}

impl Queue {
    /// Adds rows to a campaign of rows: all of them, or none. Rows that the campaign has are ignored,
    /// so that a client may send the same rows again, and create the campaign again: its stored
    /// specification keeps the rows of its creation.
    ///
    /// # Errors
    /// If there is no such campaign, it has ended, its rows are those of a design, or it may stop
    /// early; if a row is invalid or differs from the campaign's row of that id; or if the database
    /// fails.
    pub async fn append_rows(
        &self,
        name: &CampaignName,
        rows: Vec<AppendedRow>,
    ) -> Result<Created, QueueError> {
        // While the guard is held, no other call adds jobs to the campaign or deletes it.
        let _guard = self.campaigns.lock().await;
        let (campaign, spec) = self.target(name).await?;
        let unspecified = |problem| QueueError::Unspecified { campaign: name.clone(), problem };
        let Rollouts::Rows(own) = &spec.rollouts else {
            return Err(unspecified(
                "its rows are those of a design; extend the design, or add rows to a campaign of \
                 rows"
                    .to_owned(),
            ));
        };
        let added = rows.iter().map(|new| &new.row);
        // The first row has the protocol and the execution model that all rows share. The numbers of
        // other simulators' tasks must be those of the campaign.
        let simulated = own.iter().filter(|row| row.simulator.is_some());
        let named = own.first().into_iter().chain(simulated).chain(added);
        let tasks = named.map(TaskKey::of_row).collect();
        let mut view = self.shared.store.read().await?;
        let present = campaigns::rows_of_tasks(&mut view, campaign.id, &tasks).await?;
        let budgets = match campaigns::source(&mut view, campaign.id).await? {
            Some(source) => Some(budgets::of_campaign(&mut view, source.id).await?),
            None => None,
        };
        drop(view);
        // The next rows of a search follow from all those of a request.
        let batch = if budgets.is_some() { usize::MAX } else { JOBS_PER_BATCH };
        let mut known = Present {
            spec,
            rows: BTreeMap::new(),
            jobs: BTreeSet::new(),
            budgets,
            first: campaign.jobs,
        };
        for (row, replicate) in present {
            let row: Result<ManifestRow, _> = serde_json::from_str(&row).map_err(undecodable);
            let row = row.doing("read a campaign's manifest row")?;
            known.jobs.insert((row.id, replicate));
            known.rows.insert(row.id, row);
        }
        let jobs = on_blocking_thread(move || known.further(rows)).await;
        self.append(campaign, jobs.map_err(unspecified)?, batch, None).await
    }

    /// Adds the rows that a campaign of a design lacks of a larger one, or of more replicates.
    ///
    /// # Errors
    /// If there is no such campaign, it has ended or may stop early; if the larger campaign lacks
    /// or alters one of its rollouts, or differs otherwise; or if the database fails.
    pub async fn extend_campaign(
        &self,
        name: &CampaignName,
        larger: NewCampaign,
    ) -> Result<Created, QueueError> {
        let _guard = self.campaigns.lock().await;
        let (campaign, spec) = self.target(name).await?;
        let larger_spec = specification(&larger.spec)?;
        let CampaignSpec { rollouts, replicates, .. } = larger_spec.clone();
        let designs = (&spec.rollouts, &rollouts);
        let are_designs = matches!(designs, (Rollouts::Design(_), Rollouts::Design(_)));
        if !are_designs || (CampaignSpec { rollouts, replicates, ..spec }) != larger_spec {
            let spec = self.view().await?.spec(&campaign).await?;
            let differs = differing_fields(&spec, &larger.spec);
            return Err(QueueError::CampaignDiffers { campaign: campaign.name, differs });
        }
        let tasks = larger.tasks().into_iter().map(str::to_owned).collect();
        let mut view = self.shared.store.read().await?;
        let present = campaigns::rows_of_tasks(&mut view, campaign.id, &tasks).await?;
        drop(view);
        let is_lost = present.len() as i64 != campaign.jobs;
        let present: BTreeSet<(String, u32)> = present.into_iter().collect();
        let (count, mut jobs) = (larger.jobs.len(), larger.jobs);
        jobs.retain(|job| !present.contains(&(job.manifest_row.clone(), job.replicate)));
        if is_lost || jobs.len() + present.len() != count {
            return Err(QueueError::Unspecified {
                campaign: campaign.name,
                problem: "the larger one lacks some of its rollouts, or perturbs them otherwise; \
                          add tasks, levels, configurations or replicates only"
                    .to_owned(),
            });
        }
        for (place, job) in (campaign.jobs..).zip(&mut jobs) {
            job.unit_order = place;
        }
        self.append(campaign, jobs, JOBS_PER_BATCH, Some((larger.spec, larger.spec_digest))).await
    }

    /// Returns a campaign that may get further rows, and its specification.
    async fn target(&self, name: &CampaignName) -> Result<(Campaign, CampaignSpec), QueueError> {
        let mut view = self.view().await?;
        let campaign = view.campaign(name).await?;
        check_not_ended(&campaign)?;
        if campaign.is_drawn {
            return Err(QueueError::Unspecified {
                campaign: name.clone(),
                problem: "it may stop early, so that the order of its rows was drawn at its \
                          creation; create one without `stop` to add rows to it"
                    .to_owned(),
            });
        }
        let spec = specification(&view.spec(&campaign).await?)?;
        Ok((campaign, spec))
    }

    /// Adds jobs to a campaign in batches, between which the writer serves workers, and replaces its
    /// specification if another one is given.
    async fn append(
        &self,
        campaign: Campaign,
        jobs: Vec<NewJob>,
        batch: usize,
        mut spec: Option<(String, String)>,
    ) -> Result<Created, QueueError> {
        let jobs_added = jobs.len() as u64;
        let jobs_total = campaign.jobs.unsigned_abs() + jobs_added;
        let created = Created { jobs_added, jobs_total, priority: campaign.priority };
        for jobs in jobs.chunks(batch) {
            let mut context = Context::begin(&self.shared, vec![Step::AppendRows]).await?;
            // The campaign may have ended meanwhile.
            check_not_ended(&*context.campaign(campaign.id).await?)?;
            if let Some((spec, digest)) = spec.take() {
                campaigns::set_spec(&mut context.tx, campaign.id, &spec, &digest).await?;
            }
            campaigns::append_jobs(&mut context.tx, campaign.id, jobs).await?;
            context.cache.clear_campaigns();
            context.commit().await?;
            self.shared.work.notify_waiters();
        }
        tracing::info!(campaign = %campaign.name, jobs = jobs_added, "rows were added");
        Ok(created)
    }
}

/// Adds a row to the known ones. Returns false if it is one of them.
fn is_new(known: &mut BTreeMap<RolloutId, ManifestRow>, row: &ManifestRow) -> Result<bool, String> {
    let Some(present) = known.get(&row.id) else {
        known.insert(row.id, row.clone());
        return Ok(true);
    };
    match diff(std::slice::from_ref(present), std::slice::from_ref(row)).into_iter().next() {
        Some(Difference::Value { id, column, left, right }) => Err(format!(
            "row {id} has {column} {right}, but {left} in the campaign; send it unchanged, or \
             create another campaign"
        )),
        _ => Ok(false),
    }
}

impl Present {
    /// Returns the jobs to be added; or the first fault of the rows, and its remedy.
    fn further(mut self, further: Vec<AppendedRow>) -> Result<Vec<NewJob>, String> {
        let (mut rows, mut jobs) = (Vec::new(), Vec::new());
        for AppendedRow { row, mut replicates } in further {
            let (id, run) = (row.id, row.clone().under(&self.spec.execution));
            let row = if row.execution.is_wait() { run.clone() } else { row };
            let budget = (TaskKey::of_row(&row), row.max_steps.into(), row.settle_steps.into());
            match &self.budgets {
                Some(budgets) if !budgets.contains(&budget) => {
                    return Err(format!(
                        "row {id} has another step budget than the rollouts that it is compared \
                         with; use theirs"
                    ));
                }
                None if !replicates.is_empty() => {
                    return Err(format!(
                        "row {id} names `replicates`, but it runs in all of the campaign's; leave \
                         them out"
                    ));
                }
                _ => {}
            }
            if is_new(&mut self.rows, &row)? {
                rows.push(row);
            }
            if replicates.is_empty() {
                replicates = (0..self.spec.replicates).collect();
            }
            for replicate in replicates {
                if self.jobs.insert((id, replicate)) {
                    let job = NewJob::new(&run, replicate, self.first + jobs.len() as i64);
                    jobs.push(job.map_err(|error| error.to_string())?);
                }
            }
        }
        if !rows.is_empty() {
            // The new rows come first, since errors number the rows.
            let new: BTreeSet<RolloutId> = rows.iter().map(|row| row.id).collect();
            rows.extend(self.rows.into_values().filter(|row| !new.contains(&row.id)));
            self.spec.check_rows(&rows).map_err(|error| error.to_string())?;
        }
        Ok(jobs)
    }
}
