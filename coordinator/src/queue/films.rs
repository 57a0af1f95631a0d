//! Which rollouts are filmed after the fact: those of configurations whose outcome
//! the combination of axes changed, in campaigns that record transitions. Their
//! actions were kept, so that whoever films them needs no policy.
//!
//! What is handed out is remembered in memory only. Should that be lost, a
//! rollout is filmed twice, with the same pictures.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use paired::{Outcome, Record, Records, Transition};

use super::{Queue, QueueError};
use crate::clock::UnixMillis;
use crate::ids::{CampaignName, JobId, LeaseRef};
use crate::store::motions::{self, FilmableRow};
use crate::store::undecodable;
use crate::store::workers::Pin;
use crate::store::{Doing, StoreError};

/// How long somebody may take to film what was handed out: drawing the longest
/// rollout in software takes a few minutes.
const HANDED_OUT_FOR: Duration = Duration::from_secs(15 * 60);

/// When what was handed out is handed out again.
#[derive(Debug, Default)]
pub(super) struct HandedOut(BTreeMap<JobId, UnixMillis>);

/// A committed rollout that is to be filmed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Film {
    /// Under which its file is stored.
    pub lease: LeaseRef,
    /// Its campaign.
    pub campaign: CampaignName,
    /// Which replicate.
    pub replicate: u32,
    /// One manifest row, JSON.
    pub manifest_row: String,
    /// "matched" or "reference".
    pub realisation: String,
    /// What the robot was told: seven 32-bit floats a control step.
    pub actions: Vec<u8>,
    /// What must come out again.
    pub success: bool,
}

impl Queue {
    /// A rollout that is to be filmed with this asset pack and simulator, and
    /// how many there are; none if nothing is left.
    ///
    /// # Errors
    /// When the database fails.
    pub async fn next_film(&self, pin: &Pin) -> Result<Option<(Film, u64)>, QueueError> {
        let now = self.now();
        let mut view = self.store.read().await?;
        let mut wanting = Vec::new();
        for campaign in motions::filmed_campaigns(&mut view, pin).await? {
            wanting.extend(wanting_films(
                &motions::filmable(&mut view, campaign).await?,
            )?);
        }
        let Some(job) = self.handed_out().next(&wanting, now) else {
            return Ok(None);
        };
        let row = motions::film(&mut view, job).await?;
        let film = Film {
            lease: LeaseRef {
                worker: row.worker_id,
                job: row.job_id,
                attempt: row.attempt,
            },
            campaign: row.campaign,
            replicate: row.replicate,
            manifest_row: row.manifest_row,
            realisation: row.realisation,
            actions: row.actions,
            success: row.success,
        };
        Ok(Some((film, wanting.len() as u64)))
    }
}

impl HandedOut {
    /// The first that nobody is filming.
    fn next(&mut self, wanting: &[JobId], now: UnixMillis) -> Option<JobId> {
        self.0.retain(|_, until| *until > now);
        let job = *wanting.iter().find(|job| !self.0.contains_key(job))?;
        self.0.insert(job, now.plus(HANDED_OUT_FOR));
        Some(job)
    }
}

/// The rollouts of changed configurations that have no video yet.
fn wanting_films(rows: &[FilmableRow]) -> Result<Vec<JobId>, StoreError> {
    let records = rows.iter().map(|row| {
        Ok(Record {
            id: row.rollout_id.parse().map_err(undecodable)?,
            replicate: row.replicate,
            init_id: row.init_id,
            outcome: match row.success {
                Some(true) => Outcome::Success,
                Some(false) => Outcome::Failure,
                None => Outcome::Missing,
            },
        })
    });
    let records = records.collect::<Result<Vec<_>, sqlx::Error>>();
    let records = records.doing("look for rollouts to film")?;
    // A rollout and replicate is one job: the schema says so.
    let matched = Records::new(&records).map_err(undecodable);
    let matched = matched.doing("look for rollouts to film")?;
    // A unit's perturbed rollouts share level and configuration, and with its
    // nominal one the initial state.
    let mut perturbed = BTreeSet::new();
    let mut nominal = BTreeSet::new();
    for unit in matched.configurations() {
        let transition = unit.transition();
        if let Some(Transition::Emergent | Transition::Compensated) = transition {
            perturbed.insert((unit.replicate, unit.task, unit.level, unit.config));
            nominal.insert((unit.replicate, unit.task, unit.init_id));
        }
    }
    let is_of_changed = |record: &Record| match record.id.config() {
        Some(config) => {
            let (task, level) = (record.id.task(), record.id.level());
            perturbed.contains(&(record.replicate, task, level, config))
        }
        None => nominal.contains(&(record.replicate, record.id.task(), record.init_id)),
    };
    let wanting = rows
        .iter()
        .zip(&records)
        .filter(|(row, record)| row.is_wanting && is_of_changed(record));
    Ok(wanting.map(|(row, _)| row.job_id).collect())
}
