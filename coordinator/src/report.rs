//! The paired report of a campaign as it stands: reads what is committed, warns
//! of what a reader must know, and leaves the statistics to `paired`. The same
//! results give the same bytes, however many attempts they took.

mod warnings;

use paired::{DuplicateRecord, Options, Outcome, Record};
use protocol::{CampaignSpec, DesignVersion, SpecError, UnknownName};
use serde::Serialize;
use tokio::task::JoinError;

use crate::ids::CampaignName;
use crate::queue::{Queue, QueueError};
use crate::store::results::{self, Provenance, QuarantineRow, RecordRow};
use crate::store::{StoreError, campaigns};

/// Columns of a terminal. Errors are cut there; the JSON form has them whole.
const WIDTH: usize = 80;

/// A report in both of its forms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rendered {
    /// What it is of, and [`paired::Report`], as one JSON object.
    pub json: String,
    /// A text for a terminal.
    pub table: String,
}

/// A report that cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The campaign or the database.
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// The stored specification does not read back.
    #[error("read the stored specification of campaign `{campaign}`")]
    Spec {
        /// Whose.
        campaign: CampaignName,
        /// What is wrong with it.
        source: SpecError,
    },
    /// Results of another realisation mode than the campaign's, which a commit
    /// refuses.
    #[error(
        "pool the results of campaign `{campaign}`: it is of mode {mode} and holds results of mode \
         {other}, which perturbs differently; measure each mode in a campaign of its own"
    )]
    Modes {
        /// Whose.
        campaign: CampaignName,
        /// Its mode.
        mode: String,
        /// The other.
        other: String,
    },
    /// A stored rollout id does not read back.
    #[error("read a stored rollout id")]
    RolloutId(#[from] UnknownName),
    /// The same rollout twice, which the schema rules out.
    #[error(transparent)]
    Duplicate(#[from] DuplicateRecord),
    /// The report cannot be written as JSON.
    #[error("write the report as JSON")]
    Json(#[from] serde_json::Error),
    /// The computation was broken off.
    #[error("compute the report")]
    Computation(#[from] JoinError),
}

/// Everything that a report is made of.
struct Facts {
    campaign: CampaignName,
    policy: String,
    endpoint: String,
    design: DesignVersion,
    realisation: String,
    records: Vec<Record>,
    quarantined: Vec<QuarantineRow>,
    divergent: Vec<(String, u32)>,
    provenances: Vec<Provenance>,
}

/// The JSON form: what the report is of, then the report.
#[derive(Serialize)]
struct Document<'a> {
    campaign: &'a str,
    policy: &'a str,
    design: &'a DesignVersion,
    realisation: &'a str,
    errors: Vec<SetAside<'a>>,
    #[serde(flatten)]
    report: &'a paired::Report,
}

/// A rollout that was set aside, and what it last failed with.
#[derive(Serialize)]
struct SetAside<'a> {
    rollout: String,
    last_error: &'a str,
}

/// Reports on a campaign as it stands.
///
/// # Errors
/// When there is no such campaign, it holds results of two realisation modes,
/// or the database fails.
pub async fn of_campaign(queue: &Queue, name: &CampaignName) -> Result<Rendered, ReportError> {
    let facts = read(queue, name).await?;
    // Thousands of resamplings: not on a thread that serves requests.
    tokio::task::spawn_blocking(move || render(&facts)).await?
}

async fn read(queue: &Queue, name: &CampaignName) -> Result<Facts, ReportError> {
    let in_store = |error: StoreError| ReportError::Queue(error.into());
    let mut tx = queue.store().read().await.map_err(in_store)?;
    let row = campaigns::by_name(&mut tx, name).await.map_err(in_store)?;
    let row = row.ok_or_else(|| QueueError::UnknownCampaign {
        campaign: name.clone(),
    })?;
    let spec = CampaignSpec::from_json(&row.spec).map_err(|source| ReportError::Spec {
        campaign: name.clone(),
        source,
    })?;
    let provenances = results::provenances(&mut tx, row.id).await;
    let provenances = provenances.map_err(in_store)?;
    let mut modes = provenances.iter().map(|provenance| &provenance.realisation);
    if let Some(other) = modes.find(|mode| **mode != row.realisation) {
        return Err(ReportError::Modes {
            campaign: row.name,
            mode: row.realisation,
            other: other.clone(),
        });
    }
    let records = results::records(&mut tx, row.id).await.map_err(in_store)?;
    let records = records.iter().map(record);
    Ok(Facts {
        records: records.collect::<Result<_, _>>()?,
        quarantined: results::quarantined(&mut tx, row.id)
            .await
            .map_err(in_store)?,
        divergent: results::divergent(&mut tx, row.id)
            .await
            .map_err(in_store)?,
        provenances,
        campaign: row.name,
        policy: row.policy,
        endpoint: row.endpoint,
        design: spec.version(),
        realisation: row.realisation,
    })
}

fn record(row: &RecordRow) -> Result<Record, UnknownName> {
    Ok(Record {
        id: row.rollout_id.parse()?,
        init_id: row.init_id,
        replicate: row.replicate,
        outcome: match row.success {
            Some(true) => Outcome::Success,
            Some(false) => Outcome::Failure,
            None if row.is_quarantined => Outcome::Quarantined,
            None => Outcome::Missing,
        },
    })
}

fn render(facts: &Facts) -> Result<Rendered, ReportError> {
    let options = Options {
        notes: warnings::warnings(facts),
        ..Options::default()
    };
    let report = paired::report(&facts.records, &options)?;
    let document = Document {
        campaign: facts.campaign.as_str(),
        policy: &facts.policy,
        design: &facts.design,
        realisation: &facts.realisation,
        errors: facts
            .quarantined
            .iter()
            .map(|job| SetAside {
                rollout: rollout_name(&job.rollout_id, job.replicate),
                last_error: &job.last_error,
            })
            .collect(),
        report: &report,
    };
    Ok(Rendered {
        json: serde_json::to_string_pretty(&document)?,
        table: format!("{}\n{}{}", head(facts), paired::table(&report), tail(facts)),
    })
}

fn head(facts: &Facts) -> String {
    format!(
        "campaign {}\npolicy {} at {}\ndesign {}, realisation {}\n",
        facts.campaign, facts.policy, facts.endpoint, facts.design, facts.realisation
    )
}

/// What the rollouts that were set aside last failed with, each on a line.
fn tail(facts: &Facts) -> String {
    let mut text = String::new();
    if !facts.quarantined.is_empty() {
        text.push_str("\nset aside, with the last error:\n");
    }
    for job in &facts.quarantined {
        let rollout = rollout_name(&job.rollout_id, job.replicate);
        let error = job.last_error.lines().next().unwrap_or_default();
        text.extend(format!("  {rollout}: {error}").chars().take(WIDTH));
        text.push('\n');
    }
    text
}

fn rollout_name(rollout_id: &str, replicate: u32) -> String {
    match replicate {
        0 => rollout_id.to_owned(),
        k => format!("{rollout_id}#r{k}"),
    }
}
