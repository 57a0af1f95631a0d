//! Choice of the rollouts that are filmed after they were committed: in campaigns that record
//! transitions, the rollouts of configurations whose outcome simultaneous perturbation changed; in
//! campaigns that explain others, the rollouts that show the explanation. The actions of these
//! rollouts are stored, so filming needs no policy.

use std::collections::BTreeSet;
use std::time::Instant;

use benchmark::Purpose;
use benchmark::attempt::Pin;
use paired::adaptive::subsets::illustrative;
use paired::{Record, Records, Transition};
use sqlx::SqliteConnection;

use super::error::QueueError;
use super::records::{on_blocking_thread, records, specification};
use crate::ids::{CampaignId, CampaignName, JobId};
use crate::queue::Queue;
use crate::store::films::{self, FilmableRow};
use crate::store::{Doing, StoreError, campaigns, undecodable};

pub use crate::store::films::Film;

impl Queue {
    /// Returns a rollout to film with this asset pack and simulator, of `only` if given, and the
    /// number of such rollouts without a video, including those being filmed; `None` if none is
    /// left to assign.
    pub async fn next_film(
        &self,
        pin: &Pin,
        only: Option<&CampaignName>,
    ) -> Result<Option<(Film, u64)>, QueueError> {
        let films = &self.shared.films;
        let scanning = films.scanning.lock().await;
        films.scan_begins();
        let mut view = self.shared.store.read().await?;
        let mut campaigns = films::filmed_campaigns(&mut view, pin).await?;
        for outdated in films.outdated(&campaigns, Instant::now()) {
            let (began, campaign) = (Instant::now(), outdated.campaign);
            let rows = films::filmable(&mut view, campaign).await?;
            let unfilmed = match outdated.source {
                Some(source) => unfilmed_illustrations(&mut view, [source, campaign], rows).await?,
                None => on_blocking_thread(move || unfilmed_transitions(&rows)).await?,
            };
            films.scanned(outdated, unfilmed, began, began.elapsed());
        }
        drop(scanning);
        campaigns.retain(|campaign| only.is_none_or(|only| campaign.name == *only));
        let Some((job, unfilmed)) = films.assign(&campaigns, self.now()) else {
            return Ok(None);
        };
        let film = films::film(&mut view, job).await?;
        Ok(Some((film, unfilmed)))
    }
}

/// Returns the rollouts that show a campaign's explanations and have no video yet; empty for a
/// campaign that measures thresholds.
async fn unfilmed_illustrations(
    view: &mut SqliteConnection,
    [source, campaign]: [CampaignId; 2],
    rows: Vec<FilmableRow>,
) -> Result<Vec<JobId>, StoreError> {
    let spec = campaigns::spec(view, campaign).await?;
    let Some(Purpose::Explanation(explanation)) = specification(&spec)?.purpose else {
        return Ok(Vec::new());
    };
    let source = records(view, source).await?;
    let own_records = records(view, campaign).await?;
    let unfilmed = on_blocking_thread(move || {
        let illustrative = illustrative(&source, &own_records, &explanation);
        let illustrative: BTreeSet<(String, u32)> =
            illustrative.into_iter().map(|(id, replicate)| (id.to_string(), replicate)).collect();
        let is_illustrative = |row: &FilmableRow| {
            illustrative.contains(&(row.job.rollout_id.clone(), row.job.replicate))
        };
        let unfilmed = rows.iter().filter(|row| row.lacks_video && is_illustrative(row));
        unfilmed.map(|row| row.job_id).collect()
    });
    Ok(unfilmed.await)
}

/// Returns the rollouts without a video of the configurations whose outcome simultaneous
/// perturbation changed.
fn unfilmed_transitions(rows: &[FilmableRow]) -> Result<Vec<JobId>, StoreError> {
    let records: Result<Vec<Record>, _> = rows.iter().map(|row| row.job.record()).collect();
    let records = records.map_err(undecodable);
    let records = records.doing("find rollouts to film")?;
    // The schema guarantees one job per rollout and replicate.
    let matched = Records::new(&records).map_err(undecodable);
    let matched = matched.doing("find rollouts to film")?;
    // A unit's perturbed rollouts share level and configuration, and share the initial state with
    // its nominal rollout.
    let mut perturbed = BTreeSet::new();
    let mut nominal = BTreeSet::new();
    for unit in matched.configurations() {
        let transition = unit.transition();
        if let Some(Transition::Emergent | Transition::Compensated) = transition {
            perturbed.insert((unit.replicate, unit.task, unit.level, unit.config));
            nominal.insert((unit.replicate, unit.task, unit.init_id));
        }
    }
    let is_of_transition = |record: &Record| match record.id.config() {
        Some(config) => {
            let (task, level) = (record.id.task(), record.id.level());
            perturbed.contains(&(record.replicate, task, level, config))
        }
        None => nominal.contains(&(record.replicate, record.id.task(), record.init_id)),
    };
    let unfilmed = rows
        .iter()
        .zip(&records)
        .filter(|(row, record)| row.lacks_video && is_of_transition(record));
    Ok(unfilmed.map(|(row, _)| row.job_id).collect())
}
