//! Which rollouts are filmed after the fact: those of configurations whose outcome
//! the combination of axes changed, in campaigns that record transitions. Their
//! actions were kept, so that filming them needs no policy.
//!
//! What is being filmed is remembered in memory only. Should that be lost, a
//! rollout is filmed twice, with the same frames.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use attempt::Pin;
use paired::{Outcome, Record, Records, Transition};

use super::error::QueueError;
use super::shared::Shared;
use crate::clock::UnixMillis;
use crate::ids::JobId;
use crate::store::films::{self, FilmableRow};
use crate::store::{Doing, StoreError, undecodable};

pub use crate::store::films::Film;

/// Longest time to film a rollout before it is handed out again: drawing the
/// longest one in software takes a few minutes.
const FILMING_TIMEOUT: Duration = Duration::from_secs(15 * 60);

/// The rollouts that are being filmed, and until when.
#[derive(Debug, Default)]
pub(crate) struct InFlight(Mutex<BTreeMap<JobId, UnixMillis>>);

impl InFlight {
    /// A rollout that is to be filmed with this asset pack and simulator, and
    /// how many there are; none if nothing is left.
    pub(crate) async fn next(
        &self,
        shared: &Shared,
        pin: &Pin,
    ) -> Result<Option<(Film, u64)>, QueueError> {
        let mut view = shared.store.read().await?;
        let mut wanting = Vec::new();
        for campaign in films::filmed_campaigns(&mut view, pin).await? {
            wanting.extend(wanting_films(&films::filmable(&mut view, campaign).await?)?);
        }
        match self.take(&wanting, shared.now()) {
            Some(job) => {
                let film = films::film(&mut view, job).await?;
                Ok(Some((film, wanting.len() as u64)))
            }
            None => Ok(None),
        }
    }

    /// The first that nobody is filming.
    fn take(&self, wanting: &[JobId], now: UnixMillis) -> Option<JobId> {
        let mut in_flight = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        in_flight.retain(|_, until| *until > now);
        let job = *wanting.iter().find(|job| !in_flight.contains_key(job))?;
        in_flight.insert(job, now.plus(FILMING_TIMEOUT));
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
