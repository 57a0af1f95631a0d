//! Rows that clients add to a campaign.

use std::collections::{BTreeMap, BTreeSet};

use libero_ctrl::manifest::{Difference, diff};
use libero_ctrl::{CampaignSpec, ManifestRow, RolloutId, Rollouts};
use libero_family::TaskKey;

use super::campaigns::{Created, check_not_ended};
use super::context::Context;
use super::error::QueueError;
use super::records::{on_blocking_thread, specification};
use crate::expand::{NewCampaign, NewJob, altered, differing_fields};
use crate::ids::CampaignName;
use crate::queue::Queue;
use crate::store::campaigns::Campaign;
use crate::store::failpoint::Step;
use crate::store::imported::{self, Budget};
use crate::store::{Doing, StoreError, campaigns, derivations, undecodable};

/// Reason why a campaign with a stop rule gets no further rows.
const DRAWN: &str = "it may stop early, so that the order of its rows was drawn at its creation; \
                     create one without `stop` to add rows to it";

/// A row to be added to a campaign.
#[derive(Clone, Debug)]
pub struct AppendedRow {
    pub row: ManifestRow,
    /// Replicates to run; if empty, all of the campaign's specification.
    pub replicates: Vec<u32>,
}

/// What the rows to be added are checked against.
struct Target {
    spec: CampaignSpec,
    /// Rows of the campaign; of a search, only those of the added rows' tasks.
    earlier: Vec<ManifestRow>,
    /// Replicates of the earlier rows.
    replicates: BTreeSet<(RolloutId, u32)>,
    /// Step budgets of the campaign that a search is compared with; `None` in other campaigns.
    budgets: Option<BTreeSet<Budget>>,
    /// Number of the campaign's jobs.
    jobs: i64,
}

impl Queue {
    /// Adds rows to a campaign of a manifest, or to one that explains another or measures its
    /// thresholds: all rows, or none. Rows that the campaign has are ignored, so that a client may
    /// send the same rows again.
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
        let shared = &*self.shared;
        let campaign = self.view().await?.campaign(name).await?;
        check_not_ended(&campaign)?;
        let mut view = shared.store.read().await?;
        let spec = campaigns::spec(&mut view, campaign.id).await?;
        let source = derivations::source(&mut view, campaign.id).await?;
        let mut target = Target {
            spec: specification(&spec)?,
            earlier: Vec::new(),
            replicates: BTreeSet::new(),
            budgets: None,
            jobs: campaigns::job_count(&mut view, campaign.id).await?,
        };
        if let Some(source) = source {
            target.budgets = Some(imported::budgets(&mut view, source).await?);
            let tasks = rows.iter().map(|new| TaskKey::of_row(&new.row)).collect();
            let present = campaigns::rows_of_tasks(&mut view, campaign.id, &tasks).await?;
            target.read(present)?;
        }
        drop(view);
        let first = target.jobs;
        let checked = on_blocking_thread(move || target.further(rows)).await;
        let unspecified = |problem| QueueError::Unspecified { campaign: name.clone(), problem };
        let (jobs, new) = checked.map_err(unspecified)?;
        let extend = |spec: &mut CampaignSpec| {
            if let Rollouts::Manifest(rows) = &mut spec.rollouts {
                rows.extend(new);
            }
        };
        let spec = match source {
            Some(_) => None,
            None => Some(altered(&spec, extend).map_err(|error| unspecified(error.to_string()))?),
        };
        self.append(&campaign, first, jobs, spec).await
    }

    /// Adds the rows that a campaign of a design lacks of a larger one, or of more replicates.
    ///
    /// # Errors
    /// If there is no such campaign, it has ended, may stop early, or is not of a design; if the
    /// larger campaign lacks or alters one of its rollouts, or differs otherwise; or if the database
    /// fails.
    pub async fn extend_campaign(
        &self,
        name: &CampaignName,
        larger: NewCampaign,
    ) -> Result<Created, QueueError> {
        let _guard = self.campaigns.lock().await;
        let campaign = self.view().await?.campaign(name).await?;
        check_not_ended(&campaign)?;
        let unspecified = |problem: &str| QueueError::Unspecified {
            campaign: name.clone(),
            problem: problem.to_owned(),
        };
        let mut view = self.shared.store.read().await?;
        let text = campaigns::spec(&mut view, campaign.id).await?;
        let (spec, larger_spec) = (specification(&text)?, specification(&larger.spec)?);
        let (Rollouts::Design(_), Rollouts::Design(_)) = (&spec.rollouts, &larger_spec.rollouts)
        else {
            return Err(unspecified("only a design can be extended; create another campaign"));
        };
        let CampaignSpec { rollouts, replicates, .. } = larger_spec.clone();
        if (CampaignSpec { rollouts, replicates, ..spec }) != larger_spec {
            let differs = differing_fields(&text, &larger.spec);
            return Err(QueueError::CampaignDiffers { campaign: name.clone(), differs });
        }
        if campaign.is_drawn {
            return Err(unspecified(DRAWN));
        }
        let tasks = larger.tasks().into_iter().map(str::to_owned).collect();
        let present = campaigns::rows_of_tasks(&mut view, campaign.id, &tasks).await?;
        let first = campaigns::job_count(&mut view, campaign.id).await?;
        drop(view);
        let is_lost = present.len() as i64 != first;
        let present: BTreeSet<(String, u32)> = present.into_iter().collect();
        let count = larger.jobs.len();
        let mut jobs = larger.jobs;
        jobs.retain(|job| !present.contains(&(job.manifest_row.clone(), job.replicate)));
        if is_lost || jobs.len() + present.len() != count {
            return Err(unspecified(
                "the larger design lacks some of its rollouts, or perturbs them otherwise; add \
                 tasks, levels, configurations or replicates only",
            ));
        }
        for (place, job) in (first..).zip(&mut jobs) {
            job.unit_order = place;
        }
        self.append(&campaign, first, jobs, Some((larger.spec, larger.spec_digest))).await
    }

    /// Adds jobs to a campaign that has `before`, and replaces its specification if one is given.
    async fn append(
        &self,
        campaign: &Campaign,
        before: i64,
        jobs: Vec<NewJob>,
        spec: Option<(String, String)>,
    ) -> Result<Created, QueueError> {
        let shared = &*self.shared;
        let jobs_added = jobs.len() as u64;
        let jobs_total = before.unsigned_abs() + jobs_added;
        let created = Created { jobs_added, jobs_total, priority: campaign.priority };
        if jobs.is_empty() {
            return Ok(created);
        }
        let mut context = Context::begin(shared, vec![Step::AppendRows]).await?;
        // The campaign may have ended meanwhile.
        check_not_ended(&*context.campaign(campaign.id).await?)?;
        if let Some((spec, digest)) = spec {
            campaigns::set_spec(&mut context.tx, campaign.id, &spec, &digest).await?;
        }
        campaigns::append_jobs(&mut context.tx, campaign.id, &jobs).await?;
        context.cache.clear_campaigns();
        context.commit().await?;
        tracing::info!(campaign = %campaign.name, jobs = jobs_added, "rows were added");
        shared.work.notify_waiters();
        Ok(created)
    }
}

impl Target {
    /// Reads the rows that a search has.
    fn read(&mut self, present: Vec<(String, u32)>) -> Result<(), StoreError> {
        let mut rows = BTreeMap::new();
        for (row, replicate) in present {
            let row: Result<ManifestRow, _> = serde_json::from_str(&row).map_err(undecodable);
            let row = row.doing("read a campaign's manifest row")?;
            self.replicates.insert((row.id, replicate));
            rows.insert(row.id, row);
        }
        self.earlier = rows.into_values().collect();
        Ok(())
    }

    /// Returns the jobs to be added, and the rows that the campaign lacks; or the first fault of
    /// the rows, and its remedy.
    fn further(
        mut self,
        rows: Vec<AppendedRow>,
    ) -> Result<(Vec<NewJob>, Vec<ManifestRow>), String> {
        let all = 0..self.spec.replicates;
        let is_search = self.budgets.is_some();
        if let Rollouts::Manifest(rows) = &self.spec.rollouts {
            self.earlier.clone_from(rows);
            let jobs = rows.iter().flat_map(|row| all.clone().map(|replicate| (row.id, replicate)));
            self.replicates = jobs.collect();
        } else if !is_search {
            return Err("its specification defines its rows; add rows to a campaign of a manifest"
                .to_owned());
        }
        if self.spec.stop.is_some() {
            return Err(DRAWN.to_owned());
        }
        let mut known: BTreeMap<RolloutId, ManifestRow> =
            self.earlier.iter().map(|row| (row.id, row.clone())).collect();
        let (mut new, mut jobs) = (Vec::new(), Vec::new());
        for AppendedRow { row, replicates } in rows {
            let id = row.id;
            let run = row.clone().under(&self.spec.execution);
            let row = if is_search && row.execution.is_wait() { run.clone() } else { row };
            if !replicates.is_empty() && !is_search {
                return Err(format!(
                    "row {id} names `replicates`, but a row of a manifest runs in all of them; \
                     leave them out"
                ));
            }
            let budget = (TaskKey::of_row(&row), row.max_steps.into(), row.settle_steps.into());
            if self.budgets.as_ref().is_some_and(|budgets| !budgets.contains(&budget)) {
                return Err(format!(
                    "row {id} has another step budget than the rollouts that it is compared with; \
                     use theirs"
                ));
            }
            match known.get(&id) {
                Some(present) => check_equal(present, &row)?,
                None => {
                    known.insert(id, row.clone());
                    new.push(row);
                }
            }
            let replicates = if replicates.is_empty() { all.clone().collect() } else { replicates };
            for replicate in replicates {
                if self.replicates.insert((id, replicate)) {
                    let job = NewJob::new(&run, replicate, self.jobs + jobs.len() as i64);
                    jobs.push(job.map_err(|error| error.to_string())?);
                }
            }
        }
        if !new.is_empty() {
            let checked = self.spec.check_rows(&self.earlier, &new);
            checked.map_err(|error| error.to_string())?;
        }
        Ok((jobs, new))
    }
}

fn check_equal(present: &ManifestRow, given: &ManifestRow) -> Result<(), String> {
    let differing = diff(std::slice::from_ref(present), std::slice::from_ref(given));
    match differing.into_iter().next() {
        Some(Difference::Value { id, column, left, right }) => Err(format!(
            "row {id} has {column} {right}, but {left} in the campaign; send it unchanged, or \
             create another campaign"
        )),
        _ => Ok(()),
    }
}
