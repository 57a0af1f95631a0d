//! Transfer of a campaign between coordinators, by means of a data folder whose database has the
//! regular schema and holds only this campaign.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use benchmark::CampaignSpec;
use paired::Outcome;
use sha2::{Digest, Sha256};

use super::artifacts::campaign_folder;
use super::batches::{self, JOBS_PER_BATCH};
use super::context::Context;
use super::error::QueueError;
use super::imported::{self, RowsError};
use super::removals;
use crate::expand::altered;
use crate::ids::{CampaignId, CampaignName};
use crate::invariants::{self, SCHEMA_INVARIANT, Violation};
use crate::queue::Queue;
use crate::read::{Counts, View};
use crate::store::campaigns::{self, Campaign};
use crate::store::failpoint::Step;
use crate::store::portable::{self, CopyTarget};
use crate::store::{
    DATABASE_FILE, Doing, OpenError, Store, StoreError, hidden, instants, outcomes,
    removals as removal_marks, schema, undecodable,
};
use crate::timing::Timing;

/// Longest time by which the instants of an added campaign may be ahead of this coordinator's clock,
/// which begins at the newest one when the coordinator starts the next time.
const MAX_AHEAD: Duration = Duration::from_secs(24 * 3_600);

/// A campaign in a data folder of its own.
#[derive(Debug)]
pub struct Portable {
    pub(super) store: Store,
    pub campaign: Campaign,
    /// Specification, JSON.
    pub spec: String,
}

/// A video of a campaign being exported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilmFile {
    /// Path below the data folder.
    pub path: String,
    /// Size, bytes.
    pub size_bytes: u64,
}

/// The source campaign of a derived campaign, with the digest of its outcomes.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct SourceOutcomes {
    /// Name of the source campaign.
    pub campaign: String,
    /// SHA-256 of the outcomes, hex.
    pub outcomes: String,
}

/// A data folder that does not hold exactly one valid campaign.
#[derive(Debug, thiserror::Error)]
pub enum PortableError {
    #[error(transparent)]
    Open(#[from] OpenError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("find the campaign of the database: it holds {count} campaigns, not one")]
    NotOne { count: usize },
    #[error("use the specification of campaign `{campaign}`: it does not match its digest")]
    SpecDigest { campaign: CampaignName },
    #[error("verify the database: the invariant `{invariant}` is violated ({example})")]
    Violated { invariant: &'static str, example: String },
    #[error(transparent)]
    Rows(#[from] RowsError),
}

impl Portable {
    /// Opens the data folder of one campaign and verifies it: its schema, every invariant, the
    /// specification's digest, and that all jobs, results and workers are ones that this program
    /// would have stored.
    ///
    /// The database is untrusted. A view in place of a table, or a trigger, would run with the
    /// first statement that touches it, so the schema is compared before any other statement.
    pub async fn open(folder: &Path) -> Result<Portable, PortableError> {
        let foreign = schema::foreign_schema(&folder.join(DATABASE_FILE)).await;
        if let Some(example) = foreign.doing("compare the schema of an archive")? {
            let invariant = SCHEMA_INVARIANT;
            return Err(PortableError::Violated { invariant, example });
        }
        let store = Store::open(folder).await?;
        let mut reader = store.reader().await?;
        let violations = invariants::violations(&mut reader).await;
        let violations = violations.doing("verify the invariants of an archive")?;
        drop(reader);
        if let Some(Violation { invariant, examples, .. }) = violations.into_iter().next() {
            let example = examples.into_iter().next().unwrap_or_default();
            return Err(PortableError::Violated { invariant, example });
        }
        let portable = Portable::from_store(store).await?;
        let mut view = portable.store.read().await?;
        let id = portable.campaign.id;
        match imported::contradiction(&mut view, id, &portable.spec).await? {
            Some(error) => Err(error.into()),
            None => Ok(portable),
        }
    }

    pub(super) async fn from_store(store: Store) -> Result<Portable, PortableError> {
        let mut view = store.read().await?;
        let all = campaigns::all(&mut view).await?;
        let [campaign] = all.as_slice() else {
            return Err(PortableError::NotOne { count: all.len() });
        };
        let campaign = campaign.clone();
        let spec = campaigns::spec(&mut view, campaign.id).await?;
        drop(view);
        if hex::encode(Sha256::digest(spec.as_bytes())) != campaign.spec_digest {
            return Err(PortableError::SpecDigest { campaign: campaign.name });
        }
        Ok(Portable { store, campaign, spec })
    }

    pub fn folder(&self) -> &Path {
        self.store.folder()
    }

    /// Begins a read-only view of the database, at the instant of the campaign's creation: a copy
    /// has neither live workers nor leases, so ages do not matter.
    pub async fn view(&self) -> Result<View, StoreError> {
        let (now, filming) = (self.campaign.created_ms, BTreeMap::new());
        View::begin(&self.store, now, Timing::default(), None, filming, Arc::default()).await
    }

    /// Returns the videos, by path; the database lists no other kind of artifact.
    pub async fn films(&self) -> Result<Vec<FilmFile>, StoreError> {
        let mut view = self.store.read().await?;
        let films: Vec<(String, i64)> =
            sqlx::query_as("SELECT path, size_bytes FROM artifact ORDER BY path")
                .fetch_all(&mut *view)
                .await
                .doing("list a campaign's videos")?;
        let film = |(path, size): (String, i64)| FilmFile { path, size_bytes: size.unsigned_abs() };
        Ok(films.into_iter().map(film).collect())
    }

    /// Removes the videos with these paths, whose files are missing, from the database.
    pub async fn remove_missing_films(&self, missing: &[String]) -> Result<(), StoreError> {
        let mut tx = self.store.write(Vec::new()).await?;
        portable::remove_artifacts(&mut tx, missing).await?;
        tx.commit().await
    }

    /// Closes the database, leaving a single file.
    pub async fn close(self) -> Result<(), StoreError> {
        self.store.close().await
    }
}

impl Queue {
    /// Copies the current state of a campaign into an empty folder, which becomes a data folder.
    /// Leases end in the copy without a charge: their jobs wait again. Videos are not copied.
    /// Returns the copy, and the folder of the videos below this coordinator's data folder.
    pub async fn copy_campaign(
        &self,
        name: &CampaignName,
        into: &Path,
    ) -> Result<(Portable, String), CopyError> {
        let mut view = self.view().await.map_err(QueueError::from)?;
        let campaign = view.campaign(name).await?;
        let spec = view.spec(&campaign).await.map_err(QueueError::from)?;
        drop(view);
        let target = CopyTarget {
            name: campaign.name.clone(),
            spec,
            spec_digest: campaign.spec_digest.clone(),
            folder: campaign.name.as_str().to_owned(),
        };
        let database = self.store().folder().join(DATABASE_FILE);
        let copy = copy_into(&database, &campaign, &target, into).await?;
        Ok((copy, campaign_folder(&campaign.folder)))
    }

    /// Returns the digest of the outcomes of the source campaign that a specification names; `None`
    /// if the specification is not of a derived campaign.
    pub async fn source_outcomes(&self, spec: &str) -> Result<Option<SourceOutcomes>, QueueError> {
        let Some(source) = source_of(spec)? else {
            return Ok(None);
        };
        let mut view = self.view().await?;
        let campaign = view.campaign(&source).await?;
        drop(view);
        let mut view = self.store().read().await?;
        let outcomes = outcomes_digest(&mut view, &campaign).await?;
        Ok(Some(SourceOutcomes { campaign: source.as_str().to_owned(), outcomes }))
    }

    /// Imports the campaign of a data folder and moves its videos into this coordinator's data
    /// folder. The campaign continues in its former state. Returns its name and the numbers of its
    /// jobs by state. If this fails, the campaign is not added.
    pub async fn adopt(
        &self,
        from: &Portable,
        source: Option<&SourceOutcomes>,
        name: Option<&CampaignName>,
    ) -> Result<(CampaignName, Counts), AdoptError> {
        let _guard = self.campaigns.lock().await;
        let shared = &*self.shared;
        let mut target = from.copy_target(name)?;
        let films = from.films().await?;
        let newest = instants::newest(&mut *from.store.read().await?).await?;
        let mut context = Context::begin(shared, vec![]).await?;
        let ahead = newest.since(context.now);
        if ahead > MAX_AHEAD {
            return Err(AdoptError::Ahead { campaign: target.name, seconds: ahead.as_secs() });
        }
        if campaigns::by_name(&mut context.tx, &target.name).await?.is_some() {
            return Err(AdoptError::Exists { campaign: target.name });
        }
        if let Some(source) = context.local_source(&target, source).await? {
            // Dropping the context releases the writer while many rows are read. The lock on
            // `campaigns` prevents creations and deletions meanwhile, and the manifest rows of a
            // campaign never change.
            drop(context);
            let derived = (&from.store, from.campaign.id);
            if !imported::has_budgets_of(derived, (&shared.store, source)).await? {
                return Err(AdoptError::OtherBudgets { campaign: target.name });
            }
            context = Context::begin(shared, vec![]).await?;
        }
        target.folder = campaigns::free_folder(&mut context.tx, &target.name).await?;
        let folder = campaign_folder(&target.folder);
        // Marks the folder for removal at the next start, in case the import does not complete.
        removal_marks::add(&mut context.tx, &folder).await?;
        context.commit().await?;
        let moved = move_films(from.folder(), &films, &shared.store.folder().join(&folder)).await;
        let adopted = match moved {
            Ok(()) => self.copy_rows(from, &target).await,
            Err(error) => Err(error),
        };
        if adopted.is_err() {
            removals::remove_locally(shared, &folder).await?;
        }
        let counts = adopted?;
        let jobs = counts.total();
        tracing::info!(campaign = %target.name, jobs, results = counts.committed,
            "campaign added from an archive");
        shared.work.notify_waiters();
        Ok((target.name, counts))
    }

    /// Copies a campaign in batches, so that workers are served in between; it stays hidden until
    /// it is complete.
    async fn copy_rows(&self, from: &Portable, target: &CopyTarget) -> Result<Counts, AdoptError> {
        let shared = &*self.shared;
        let old = from.campaign.id;
        let database = from.folder().join(DATABASE_FILE);
        let mut attached = shared.store.attach(&database).await?;
        let tx = attached.write(vec![Step::ImportCampaign]).await?;
        let mut context = Context::within(shared, tx).await;
        let now = context.now;
        let id = portable::copy_without_jobs(&mut context.tx, old, target, now).await?;
        hidden::hide_new(&mut context.tx, id).await?;
        let policy = context.campaign(id).await?.policy_id;
        context.cache.clear_campaigns();
        context.commit().await?;
        attached.detach().await?;
        let copied = self.copy_jobs(from, (id, old), target).await;
        if copied.is_err()
            && let Err(error) = batches::remove(shared, id, policy).await
        {
            tracing::warn!(
                "failed to {}; the next start deletes the incomplete campaign",
                error.with_cause()
            );
        }
        copied
    }

    /// Copies the jobs of campaign `old` in batches into the hidden campaign `id`, which then
    /// becomes visible.
    async fn copy_jobs(
        &self,
        from: &Portable,
        (id, old): (CampaignId, CampaignId),
        target: &CopyTarget,
    ) -> Result<Counts, AdoptError> {
        let shared = &*self.shared;
        let database = &from.folder().join(DATABASE_FILE);
        let mut view = from.store.read().await?;
        let jobs = portable::jobs(&mut view, old).await?;
        drop(view);
        for batch in jobs.chunks(JOBS_PER_BATCH) {
            let mut attached = shared.store.attach(database).await?;
            let tx = attached.write(vec![Step::ImportCampaign]).await?;
            let mut context = Context::within(shared, tx).await;
            portable::copy_batch(&mut context.tx, (id, old), &target.folder, batch).await?;
            context.commit().await?;
            attached.detach().await?;
        }
        let mut attached = shared.store.attach(database).await?;
        let tx = attached.write(vec![Step::ImportCampaign]).await?;
        let mut context = Context::within(shared, tx).await;
        let now = context.now;
        campaigns::take_name(&mut context.tx, &target.name).await?;
        hidden::publish(&mut context.tx, id, (&target.name, &target.folder), now).await?;
        portable::copy_stop_and_state(&mut context.tx, (id, old)).await?;
        context.settles = true;
        context.cache.clear_campaigns();
        removal_marks::remove(&mut context.tx, &campaign_folder(&target.folder)).await?;
        let counts = Counts::read(&mut context.tx, id).await?;
        context.commit().await?;
        attached.detach().await?;
        Ok(counts)
    }
}

/// A campaign that cannot be exported.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// This coordinator has no such campaign, or the database failed.
    #[error(transparent)]
    Queue(#[from] QueueError),
    #[error(transparent)]
    Portable(#[from] PortableError),
}

/// A campaign that cannot be imported.
#[derive(Debug, thiserror::Error)]
pub enum AdoptError {
    #[error(
        "add campaign `{campaign}`: this coordinator has a campaign of that name; choose another \
         name with --as NAME"
    )]
    Exists { campaign: CampaignName },
    #[error(
        "add campaign `{campaign}`: it is derived from `{source_campaign}`, which this coordinator does not have; import that one first"
    )]
    NoSource { campaign: CampaignName, source_campaign: CampaignName },
    #[error(
        "add campaign `{campaign}`: its source campaign `{source_campaign}` has other \
         outcomes here; archive and import both campaigns in their current state"
    )]
    OtherSource { campaign: CampaignName, source_campaign: CampaignName },
    #[error(
        "add campaign `{campaign}`: its rollouts have other step budgets than those of its source campaign; archive it again"
    )]
    OtherBudgets { campaign: CampaignName },
    #[error(
        "add campaign `{campaign}`: its newest time is {seconds} s ahead of this coordinator's; \
         if this machine's clock is behind, set it right and start the coordinator again; \
         otherwise import the archive once that time has come"
    )]
    Ahead { campaign: CampaignName, seconds: u64 },
    #[error(
        "move film {} into the data folder: make room on that disk, and make the folder writable \
         for this user",
        path.display()
    )]
    Film { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Queue(#[from] QueueError),
}

impl From<StoreError> for AdoptError {
    fn from(error: StoreError) -> AdoptError {
        AdoptError::Queue(error.into())
    }
}

impl Portable {
    /// Returns the copy's name, with its specification and digest under that name.
    pub(super) fn copy_target(
        &self,
        name: Option<&CampaignName>,
    ) -> Result<CopyTarget, QueueError> {
        let name = name.unwrap_or(&self.campaign.name);
        let (spec, spec_digest) = match *name == self.campaign.name {
            true => (self.spec.clone(), self.campaign.spec_digest.clone()),
            false => altered(&self.spec, |spec| name.as_str().clone_into(&mut spec.name)).map_err(
                |error| QueueError::Unspecified {
                    campaign: name.clone(),
                    problem: error.to_string(),
                },
            )?,
        };
        Ok(CopyTarget { folder: name.as_str().to_owned(), name: name.clone(), spec, spec_digest })
    }
}

impl Context<'_> {
    /// Returns this coordinator's campaign that an imported campaign derives from, after checking
    /// that its outcomes are the `expected` ones; `None` if the imported campaign is not derived.
    async fn local_source(
        &mut self,
        target: &CopyTarget,
        expected: Option<&SourceOutcomes>,
    ) -> Result<Option<CampaignId>, AdoptError> {
        let Some(name) = source_of(&target.spec)? else {
            return Ok(None);
        };
        let campaign = target.name.clone();
        let Some(source) = campaigns::by_name(&mut self.tx, &name).await? else {
            return Err(AdoptError::NoSource { campaign, source_campaign: name });
        };
        let local_outcomes = outcomes_digest(&mut self.tx, &source).await?;
        if expected.is_none_or(|expected| expected.outcomes != local_outcomes) {
            return Err(AdoptError::OtherSource { campaign, source_campaign: name });
        }
        Ok(Some(source.id))
    }
}

/// Copies a campaign from a database into a new database in an empty folder.
async fn copy_into(
    database: &Path,
    campaign: &Campaign,
    target: &CopyTarget,
    into: &Path,
) -> Result<Portable, PortableError> {
    let store = Store::open(into).await?;
    let mut attached = store.attach(database).await?;
    let mut tx = attached.write(Vec::new()).await?;
    portable::copy(&mut tx, campaign.id, target, campaign.created_ms).await?;
    portable::erase_history(&mut tx).await?;
    tx.commit().await?;
    drop(attached);
    store.compact().await?;
    Portable::from_store(store).await
}

/// Returns the name of the campaign that a specification derives from, if there is one.
fn source_of(spec: &str) -> Result<Option<CampaignName>, QueueError> {
    let spec = CampaignSpec::from_json(spec).map_err(undecodable);
    let spec = spec.doing("read a campaign's specification")?;
    let name = spec.purpose.map(|purpose| CampaignName::parse(purpose.source())).transpose();
    let name = name.map_err(undecodable);
    Ok(name.doing("read the name of the source campaign")?)
}

/// Returns the SHA-256 of a campaign's outcomes, by published id: archives store it.
async fn outcomes_digest(
    tx: &mut sqlx::SqliteConnection,
    campaign: &Campaign,
) -> Result<String, StoreError> {
    let mut lines = BTreeMap::new();
    for row in outcomes::of_campaign(tx, campaign.id).await? {
        let id = row.record().map_err(undecodable).doing("read a rollout id")?.id.published();
        let outcome = match row.outcome() {
            Outcome::Success => "success",
            Outcome::Failure => "failure",
            Outcome::Quarantined => "quarantined",
            Outcome::Missing => "open",
        };
        lines.insert((id.clone(), row.replicate), format!("{id} {} {outcome}\n", row.replicate));
    }
    Ok(hex::encode(Sha256::digest(lines.into_values().collect::<String>())))
}

async fn move_films(from: &Path, films: &[FilmFile], to: &Path) -> Result<(), AdoptError> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| AdoptError::Film { path, source }
    };
    if !films.is_empty() {
        tokio::fs::create_dir_all(to).await.map_err(failed(to))?;
    }
    for film in films {
        let path = from.join(&film.path);
        let name = path.file_name().unwrap_or_default();
        let moved = tokio::fs::rename(&path, to.join(name)).await;
        moved.map_err(failed(&path))?;
    }
    Ok(())
}
