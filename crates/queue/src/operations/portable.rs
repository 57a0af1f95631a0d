//! Transfer of a campaign between coordinators: its specification, and a file of lines of JSON, of
//! which the first has the state of the campaign and each other one a job.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use benchmark::attempt::AttemptId;
use benchmark::{CampaignSpec, Rollouts};
use paired::Outcome;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use super::artifacts::{ARTIFACTS_FOLDER, campaign_folder};
use super::batches::{self, JOBS_PER_BATCH};
use super::context::Context;
use super::error::QueueError;
use super::records::on_blocking_thread;
use super::removals;
use crate::expand::{ExpandError, NewCampaign, NewJob, altered};
use crate::ids::{CampaignId, CampaignName, json_problem};
use crate::invariants::{self, Violation};
use crate::queue::Queue;
use crate::read::{Counts, View};
use crate::store::campaigns::{self, Campaign};
use crate::store::failpoint::Step;
use crate::store::portable::{self, Films, Head, Line};
use crate::store::{
    Doing, OpenError, Store, StoreError, budgets, hidden, instants, outcomes,
    removals as removal_marks, undecodable,
};
use crate::timing::Timing;

/// File of a campaign's state and jobs.
pub const ROLLOUTS_FILE: &str = "rollouts.jsonl";
/// Longest accepted line, bytes: a rollout of thousands of steps with its actions takes a tenth.
const MAX_LINE_BYTES: u64 = 16 << 20;
/// Longest time by which the instants of an added campaign may be ahead of this coordinator's clock,
/// which begins at the newest one when the coordinator starts the next time.
const MAX_AHEAD: Duration = Duration::from_secs(24 * 3_600);

/// A campaign in a folder of its own, as the file of its jobs and, once verified, as a database.
#[derive(Debug)]
pub struct Portable {
    store: Store,
    head: Head,
    films: Films,
    pub campaign: Campaign,
    /// Specification, JSON.
    pub spec: String,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilmFile {
    /// Its name in an archive, `artifacts/CAMPAIGN/….ATTEMPT.mp4`.
    pub name: String,
    /// Path below the data folder of the coordinator that has it.
    pub path: String,
    /// Size, bytes.
    pub size_bytes: u64,
}

/// The source campaign of a derived campaign, with the digest of its outcomes.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct SourceOutcomes {
    pub campaign: String,
    /// SHA-256 of the outcomes, hex.
    pub outcomes: String,
}

/// A folder that does not hold a valid campaign.
#[derive(Debug, thiserror::Error)]
pub enum PortableError {
    #[error(transparent)]
    Open(#[from] OpenError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("read the file: this user must be allowed to")]
    Read(#[from] std::io::Error),
    #[error("expand the campaign's specification")]
    Specification(#[from] ExpandError),
    #[error("read line {line}: {problem}")]
    Line { line: u64, problem: String },
    #[error("find its {expected} rollouts: it holds {found}; repeat an extension that was cut off")]
    Rollouts { found: u64, expected: u64 },
    #[error("find the results of its films: {results} of {films} films have one")]
    Films { results: i64, films: usize },
    #[error("verify the rows: the invariant `{invariant}` is violated ({example})")]
    Violated { invariant: &'static str, example: String },
}

/// Reader of a file of jobs.
struct Lines {
    file: BufReader<File>,
    number: u64,
}

impl Lines {
    fn open(folder: &Path) -> Result<(Head, Lines), PortableError> {
        let file = BufReader::new(File::open(folder.join(ROLLOUTS_FILE))?);
        let mut lines = Lines { file, number: 0 };
        match lines.next()? {
            Some(head) => Ok((head, lines)),
            None => Err(lines.problem("it is missing".to_owned())),
        }
    }

    fn problem(&self, problem: String) -> PortableError {
        PortableError::Line { line: self.number, problem }
    }

    fn next<T: DeserializeOwned>(&mut self) -> Result<Option<T>, PortableError> {
        self.number += 1;
        let mut line = Vec::new();
        let mut limited = self.file.by_ref().take(MAX_LINE_BYTES);
        match limited.read_until(b'\n', &mut line)? {
            0 => Ok(None),
            _ => serde_json::from_slice(&line)
                .map(Some)
                .map_err(|error| self.problem(json_problem(error))),
        }
    }

    /// Reads the jobs that one transaction stores; none at the end of the file.
    async fn batch(mut self) -> Result<(Lines, Vec<Line>), PortableError> {
        on_blocking_thread(move || {
            let mut batch = Vec::new();
            while batch.len() < JOBS_PER_BATCH
                && let Some(line) = self.next()?
            {
                batch.push(line);
            }
            Ok((self, batch))
        })
        .await
    }
}

impl Portable {
    /// Reads and verifies a campaign: its specification, every invariant of its rows, and that all
    /// rows and workers are ones that this program would have stored. `films` are the names and
    /// sizes of its videos.
    ///
    /// The file is untrusted: each line is parsed as what it has to be, and the schema's constraints
    /// and the invariants hold for what is stored of it.
    pub async fn open(
        folder: &Path,
        spec: &str,
        films: impl IntoIterator<Item = (&str, u64)>,
    ) -> Result<Portable, PortableError> {
        let film = |(path, bytes): (&str, u64)| {
            let name = path.rsplit('/').next()?;
            Some((film_attempt(name)?, (name.to_owned(), bytes)))
        };
        let films: Films = films.into_iter().filter_map(film).collect();
        let spec = spec.to_owned();
        let mut new = on_blocking_thread(move || NewCampaign::from_json(&spec)).await?;
        let jobs = std::mem::take(&mut new.jobs).into_iter();
        let mut expected: HashMap<(String, u32), String> =
            jobs.map(|job| ((job.rollout_id, job.replicate), job.manifest_row)).collect();
        let read = CampaignSpec::from_json(&new.spec).map_err(ExpandError::from)?;
        let is_design = matches!(read.rollouts, Rollouts::Design(_));
        let (head, mut lines) = Lines::open(folder)?;
        let store = Store::open(folder).await?;
        let mut tx = store.write(Vec::new()).await?;
        let name = new.name.as_str();
        let id = portable::begin(&mut tx, &new, &head, name, head.created_ms).await;
        let id = id.map_err(|error| violation(error, 1))?;
        let (mut found, rollouts) = (0, expected.len() as u64);
        loop {
            let (rest, batch) = lines.batch().await?;
            lines = rest;
            if batch.is_empty() {
                break;
            }
            for (line, number) in batch.iter().zip(found + 2..) {
                let invalid = |problem| PortableError::Line { line: number, problem };
                if let Some(error) = line.invalid_worker() {
                    return Err(invalid(error.to_string()));
                }
                if is_design && let Some(problem) = contradiction(line, &mut expected) {
                    return Err(invalid(problem));
                }
            }
            let folder = campaign_folder(name);
            portable::insert(&mut tx, id, &batch, (&folder, &films))
                .await
                .map_err(|error| violation(error, found + 2))?;
            found += batch.len() as u64;
        }
        if is_design && found != rollouts {
            return Err(PortableError::Rollouts { found, expected: rollouts });
        }
        portable::end(&mut tx, id, &new, &head).await.map_err(|error| violation(error, 1))?;
        let results: i64 = sqlx::query_scalar("SELECT count(*) FROM artifact")
            .fetch_one(&mut *tx)
            .await
            .doing("count the videos of an archive")?;
        if results != films.len() as i64 {
            return Err(PortableError::Films { results, films: films.len() });
        }
        tx.commit().await?;
        let mut reader = store.reader().await?;
        let violations = invariants::violations(&mut reader).await;
        let violations = violations.doing("verify the invariants of an archive")?;
        drop(reader);
        if let Some(Violation { invariant, examples, .. }) = violations.into_iter().next() {
            let example = examples.into_iter().next().unwrap_or_default();
            return Err(PortableError::Violated { invariant, example });
        }
        let campaign = campaigns::by_id(&mut *store.read().await?, id).await?;
        Ok(Portable { store, head, films, campaign, spec: new.spec })
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

    pub fn films(&self) -> u64 {
        self.films.len() as u64
    }

    fn named(&self, name: Option<&CampaignName>) -> Result<NewCampaign, QueueError> {
        let name = name.unwrap_or(&self.campaign.name);
        let renamed = altered(&self.spec, |spec| name.as_str().clone_into(&mut spec.name));
        let new = renamed.and_then(|(spec, _)| NewCampaign::from_json(&spec));
        new.map_err(|error| QueueError::Unspecified {
            campaign: name.clone(),
            problem: error.to_string(),
        })
    }
}

/// Returns the attempt that a film's file name ends with.
pub fn film_attempt(name: &str) -> Option<AttemptId> {
    name.strip_suffix(".mp4")?.rsplit('.').next()?.parse().ok()
}

/// Returns the problem of a row that the campaign's specification does not give; `None` if it does.
fn contradiction(line: &Line, expected: &mut HashMap<(String, u32), String>) -> Option<String> {
    let key = (line.row.id.to_string(), line.replicate);
    let Some(row) = expected.remove(&key) else {
        return Some(format!(
            "the campaign's specification has no rollout `{}` left in replicate {}",
            key.0, key.1
        ));
    };
    let is_expected =
        NewJob::new(&line.row, line.replicate, 0).is_ok_and(|job| job.manifest_row == row);
    (!is_expected).then(|| {
        format!(
            "the campaign's specification gives rollout `{}` another row; import the archive with \
             the release that wrote it",
            key.0
        )
    })
}

/// Names the lines whose rows a constraint of the schema refuses.
fn violation(error: StoreError, line: u64) -> PortableError {
    let problem = match &error {
        StoreError::Statement { source, .. } => match &**source {
            sqlx::Error::Database(refused) if is_constraint(refused.code()) => refused.to_string(),
            sqlx::Error::Decode(refused) => refused.to_string(),
            _ => return error.into(),
        },
        _ => return error.into(),
    };
    PortableError::Line {
        line,
        problem: format!("it or one of the next contradicts the schema ({problem})"),
    }
}

/// Returns true for SQLite's code of a violated constraint, with or without its kind.
fn is_constraint(code: Option<std::borrow::Cow<'_, str>>) -> bool {
    let code = code.and_then(|code| code.parse::<u32>().ok());
    code.is_some_and(|code| code & 0xff == 19)
}

impl Queue {
    /// Writes the current state of a campaign into an empty folder. Leases end in the copy without
    /// a charge: their jobs wait again. Videos are not copied. Returns the verified copy and the
    /// campaign's videos.
    pub async fn copy_campaign(
        &self,
        name: &CampaignName,
        into: &Path,
    ) -> Result<(Portable, Vec<FilmFile>), CopyError> {
        let mut view = self.view().await.map_err(QueueError::from)?;
        let campaign = view.campaign(name).await?;
        let spec = view.spec(&campaign).await.map_err(QueueError::from)?;
        let early = view.early_stop(&campaign).await.map_err(QueueError::from)?;
        let head = Head {
            priority: campaign.priority,
            created_ms: campaign.created_ms,
            state: campaign.state,
            pinned: campaign.pinned_ms.zip(campaign.pin.clone()),
            used: early.and_then(|early| early.used),
        };
        let films = view.write_jobs(&campaign, &head, &into.join(ROLLOUTS_FILE)).await?;
        drop(view);
        let listed = films.iter().map(|film| (film.name.as_str(), film.size_bytes));
        let copy = Portable::open(into, &spec, listed).await?;
        Ok((copy, films))
    }

    /// Returns the digest of the outcomes of the source campaign that a specification names; `None`
    /// if the specification is not of a derived campaign.
    pub async fn source_outcomes(&self, spec: &str) -> Result<Option<SourceOutcomes>, QueueError> {
        let Some(source) = source_of(spec)? else {
            return Ok(None);
        };
        let mut view = self.view().await?;
        let campaign = view.campaign(&source).await?;
        let outcomes = outcomes_digest(view.tx(), &campaign).await?;
        Ok(Some(SourceOutcomes { campaign: source.as_str().to_owned(), outcomes }))
    }

    /// Imports the campaign of a folder and moves its videos into this coordinator's data folder.
    /// The campaign continues in its former state. Returns its name and the numbers of its jobs by
    /// state. If this fails, the campaign is not added.
    pub async fn adopt(
        &self,
        from: &Portable,
        source: Option<&SourceOutcomes>,
        name: Option<&CampaignName>,
    ) -> Result<(CampaignName, Counts), AdoptError> {
        let _guard = self.campaigns.lock().await;
        let shared = &*self.shared;
        let new = from.named(name)?;
        let newest = instants::newest(&mut *from.store.read().await?).await?;
        let mut context = Context::begin(shared, vec![]).await?;
        let ahead = newest.since(context.now);
        if ahead > MAX_AHEAD {
            return Err(AdoptError::Ahead { campaign: new.name, seconds: ahead.as_secs() });
        }
        if campaigns::by_name(&mut context.tx, &new.name).await?.is_some() {
            return Err(AdoptError::Exists { campaign: new.name });
        }
        if let Some(source) = context.local_source(&new, source).await? {
            let budgets =
                budgets::of_campaign(&mut *from.store.read().await?, from.campaign.id).await?;
            // Dropping the context releases the writer while many rows are read. The lock on
            // `campaigns` prevents creations and deletions meanwhile, and the manifest rows of a
            // campaign never change.
            drop(context);
            let known = budgets::of_campaign(&mut *shared.store.read().await?, source).await?;
            if !budgets.is_subset(&known) {
                return Err(AdoptError::OtherBudgets { campaign: new.name });
            }
            context = Context::begin(shared, vec![]).await?;
        }
        let name = campaigns::free_folder(&mut context.tx, &new.name).await?;
        let folder = campaign_folder(&name);
        // Marks the folder for removal at the next start, in case the import does not complete.
        removal_marks::add(&mut context.tx, &folder).await?;
        context.commit().await?;
        let moved = move_films(from, &shared.store.folder().join(&folder)).await;
        let adopted = match moved {
            Ok(()) => self.insert_copy(from, &new, &name).await,
            Err(error) => Err(error),
        };
        if adopted.is_err() {
            removals::remove_locally(shared, &folder).await?;
        }
        let counts = adopted?;
        let jobs = counts.total();
        tracing::info!(campaign = %new.name, jobs, results = counts.committed,
            "campaign added from an archive");
        shared.work.notify_waiters();
        Ok((new.name, counts))
    }

    /// Stores a campaign in batches, so that workers are served in between; it stays hidden until
    /// it is complete.
    async fn insert_copy(
        &self,
        from: &Portable,
        new: &NewCampaign,
        folder: &str,
    ) -> Result<Counts, AdoptError> {
        let shared = &*self.shared;
        let mut context = Context::begin(shared, vec![Step::ImportCampaign]).await?;
        let now = context.now;
        let id = portable::begin(&mut context.tx, new, &from.head, folder, now).await?;
        hidden::hide_new(&mut context.tx, id).await?;
        let policy = context.campaign(id).await?.policy_id;
        context.cache.clear_campaigns();
        context.commit().await?;
        let copied = self.insert_jobs(from, id, new, folder).await;
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

    /// Stores the jobs of the hidden campaign `id`, which then becomes visible.
    async fn insert_jobs(
        &self,
        from: &Portable,
        id: CampaignId,
        new: &NewCampaign,
        folder: &str,
    ) -> Result<Counts, AdoptError> {
        let shared = &*self.shared;
        let path = campaign_folder(folder);
        let (_, mut lines) = Lines::open(from.folder())?;
        loop {
            let (rest, batch) = lines.batch().await?;
            lines = rest;
            if batch.is_empty() {
                break;
            }
            let mut context = Context::begin(shared, vec![Step::ImportCampaign]).await?;
            portable::insert(&mut context.tx, id, &batch, (&path, &from.films)).await?;
            context.commit().await?;
        }
        let mut context = Context::begin(shared, vec![Step::ImportCampaign]).await?;
        let now = context.now;
        campaigns::take_name(&mut context.tx, &new.name).await?;
        hidden::publish(&mut context.tx, id, (&new.name, folder), now).await?;
        portable::end(&mut context.tx, id, new, &from.head).await?;
        context.settles = true;
        context.cache.clear_campaigns();
        removal_marks::remove(&mut context.tx, &path).await?;
        let counts = Counts::read(&mut context.tx, id).await?;
        context.commit().await?;
        Ok(counts)
    }
}

impl View {
    /// Writes a campaign's state and jobs to a new file. Returns its videos, by name.
    async fn write_jobs(
        &mut self,
        campaign: &Campaign,
        head: &Head,
        path: &Path,
    ) -> Result<Vec<FilmFile>, PortableError> {
        let mut file = BufWriter::new(File::create(path)?);
        writeln!(file, "{}", serde_json::to_string(head).map_err(std::io::Error::from)?)?;
        for batch in portable::jobs(self.tx(), campaign.id).await?.chunks(JOBS_PER_BATCH) {
            for line in portable::lines(self.tx(), batch).await? {
                writeln!(file, "{line}")?;
            }
        }
        file.flush()?;
        let name = |file| format!("{ARTIFACTS_FOLDER}/{}/{file}", campaign.name);
        let film = |(file, path, size): (String, String, i64)| FilmFile {
            name: name(file),
            path,
            size_bytes: size.unsigned_abs(),
        };
        let films = portable::films(self.tx(), campaign.id).await?;
        Ok(films.into_iter().map(film).collect())
    }
}

#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// This coordinator has no such campaign, or the database failed.
    #[error(transparent)]
    Queue(#[from] QueueError),
    #[error(transparent)]
    Portable(#[from] PortableError),
}

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
    #[error(transparent)]
    Portable(#[from] PortableError),
}

impl From<StoreError> for AdoptError {
    fn from(error: StoreError) -> AdoptError {
        AdoptError::Queue(error.into())
    }
}

impl Context<'_> {
    /// Returns this coordinator's campaign that an imported campaign derives from, after checking
    /// that its outcomes are the `expected` ones; `None` if the imported campaign is not derived.
    async fn local_source(
        &mut self,
        new: &NewCampaign,
        expected: Option<&SourceOutcomes>,
    ) -> Result<Option<CampaignId>, AdoptError> {
        let Some(name) = new.source.clone() else {
            return Ok(None);
        };
        let campaign = new.name.clone();
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

/// Returns the name of the campaign that a specification derives from, if there is one.
fn source_of(spec: &str) -> Result<Option<CampaignName>, QueueError> {
    let spec = CampaignSpec::from_json(spec).map_err(undecodable);
    let spec = spec.doing("read a campaign's specification")?;
    let name = spec.purpose.map(|purpose| CampaignName::parse(purpose.source())).transpose();
    let name = name.map_err(undecodable);
    Ok(name.doing("read the name of the source campaign")?)
}

/// Returns the SHA-256 of a campaign's outcomes: archives store it.
async fn outcomes_digest(
    tx: &mut sqlx::SqliteConnection,
    campaign: &Campaign,
) -> Result<String, StoreError> {
    let mut lines = BTreeMap::new();
    for row in outcomes::of_campaign(tx, campaign.id).await? {
        let id = row.record().map_err(undecodable).doing("read a rollout id")?.id.to_string();
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

async fn move_films(from: &Portable, to: &Path) -> Result<(), AdoptError> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| AdoptError::Film { path, source }
    };
    if !from.films.is_empty() {
        tokio::fs::create_dir_all(to).await.map_err(failed(to))?;
    }
    let unpacked = from.folder().join(campaign_folder(from.campaign.name.as_str()));
    for (name, _) in from.films.values() {
        let path = unpacked.join(name);
        let moved = tokio::fs::rename(&path, to.join(name)).await;
        moved.map_err(failed(&path))?;
    }
    Ok(())
}
