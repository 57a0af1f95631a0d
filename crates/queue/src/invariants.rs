//! Named invariants of a database. Each is one query whose rows describe the violations.
//! `coordinator check` runs them, also while a coordinator uses the database; tests run them after
//! every injected fault. They cover neither policy servers nor files beside the database.

use std::path::{Path, PathBuf};

use benchmark::attempt::{Provenance, RolloutResult};
use futures_util::TryStreamExt;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, SqliteConnection};

use crate::ids::json_problem;
use crate::store::{self, DATABASE_FILE};

/// Violations of one invariant that are described; further ones are only counted.
pub const MAX_EXAMPLES: usize = 5;

#[derive(Clone, Copy, Debug)]
pub struct Invariant {
    pub name: &'static str,
    /// Query for violations: one text column, no rows if the invariant holds.
    query: &'static str,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    pub invariant: &'static str,
    pub count: usize,
    /// Descriptions of the first [`MAX_EXAMPLES`] violations.
    pub examples: Vec<String>,
}

#[derive(Debug, thiserror::Error)]
pub enum CheckError {
    #[error("check {}: there is no such database; name a data folder, or a database file", path.display())]
    Missing { path: PathBuf },
    #[error("check {}: is it a database of the coordinator?", path.display())]
    Read { path: PathBuf, source: sqlx::Error },
    #[error(
        "check {}: its schema is version {found} and this program supports version {known}; use the program that wrote it",
        path.display()
    )]
    OtherSchema {
        path: PathBuf,
        /// Schema version of the database; 0 if it has none.
        found: i64,
        known: i64,
    },
}

/// Name of the invariant that a database violates if its schema differs from this program's.
const SCHEMA_INVARIANT: &str = "schema_is_the_programs";

/// Name of the invariant that a database violates if a result or a provenance cannot be a worker's.
const RESULTS_INVARIANT: &str = "results_fit_their_rows";

/// All invariants, in the order in which they are checked. Queries may use `known_schema`, a
/// temporary table that holds this program's schema.
pub const INVARIANTS: [Invariant; 20] = [
    // SQLite finds the file intact.
    Invariant {
        name: "file_is_whole",
        query: "SELECT integrity_check FROM pragma_integrity_check WHERE integrity_check <> 'ok'",
    },
    // Tables, indices and triggers are those of this program.
    Invariant {
        name: SCHEMA_INVARIANT,
        query: "SELECT coalesce(k.type, m.type) || ' ' || coalesce(k.name, m.name) || CASE
             WHEN m.name IS NULL THEN ' is missing'
             WHEN k.name IS NULL THEN ' is foreign' ELSE ' was altered' END
         FROM main.sqlite_schema m FULL JOIN known_schema k
             ON k.type = m.type AND k.name = m.name
         WHERE m.sql IS NOT k.sql AND coalesce(k.name, m.name) NOT GLOB 'sqlite_*'",
    },
    // Every foreign key refers to a row.
    Invariant {
        name: "references_hold",
        query: "SELECT format('row %s of %s refers to no row of %s', rowid, \"table\", parent)
         FROM pragma_foreign_key_check",
    },
    // A campaign has all the jobs that it was expanded into, each at a place of its own in the
    // order of jobs, unless the campaign is being created or deleted.
    Invariant {
        name: "expansion_is_whole",
        query: "SELECT format('campaign %s was expanded into %d jobs and has %d, in %d places',
             c.name, c.jobs, count(j.id), count(DISTINCT j.unit_order))
         FROM campaign c LEFT JOIN job j ON j.campaign_id = c.id
         WHERE c.id NOT IN (SELECT campaign_id FROM passage)
         GROUP BY c.id HAVING count(j.id) <> c.jobs
             OR count(DISTINCT j.unit_order) <> c.jobs
             OR coalesce(max(j.unit_order), -1) <> c.jobs - 1",
    },
    // The counts that triggers maintain equal the counts of the rows.
    Invariant {
        name: "tallies_are_true",
        query: "SELECT format('the tally of campaign %s counts %d queued, %d leased, %d '
             || 'committed, %d quarantined and %d succeeded rollouts, and its jobs differ', c.name,
             t.queued, t.leased, t.committed, t.quarantined, t.succeeded)
         FROM campaign c LEFT JOIN tally t ON t.campaign_id = c.id LEFT JOIN
             (SELECT campaign_id, sum(state = 'queued') AS queued, sum(state = 'leased') AS leased,
                  sum(state = 'committed') AS committed, sum(state = 'quarantined') AS quarantined
              FROM job GROUP BY campaign_id) j ON j.campaign_id = c.id
         LEFT JOIN (SELECT campaign_id, sum(success) AS succeeded FROM result
              GROUP BY campaign_id) r ON r.campaign_id = c.id
         WHERE t.queued IS NOT coalesce(j.queued, 0) OR t.leased IS NOT coalesce(j.leased, 0)
             OR t.committed IS NOT coalesce(j.committed, 0)
             OR t.quarantined IS NOT coalesce(j.quarantined, 0)
             OR t.succeeded IS NOT coalesce(r.succeeded, 0)
         UNION ALL
         SELECT format('the tally of campaign %d counts %d results of origin %d, and it has %d',
             coalesce(o.campaign_id, r.campaign_id), coalesce(o.results, 0),
             coalesce(o.provenance_id, r.provenance_id), coalesce(r.results, 0))
         FROM origin_tally o FULL JOIN
             (SELECT campaign_id, provenance_id, count(*) AS results FROM result
              GROUP BY campaign_id, provenance_id) r
             ON r.campaign_id = o.campaign_id AND r.provenance_id = o.provenance_id
         WHERE coalesce(o.results, 0) <> coalesce(r.results, 0)
         UNION ALL
         SELECT format('the tally counts %d attempts that ended as %s, and there are %d',
             coalesce(e.attempts, 0), coalesce(e.reason, f.reason), coalesce(f.attempts, 0))
         FROM ending_tally e FULL JOIN
             (SELECT reason, count(*) AS attempts FROM failure GROUP BY reason) f
             ON f.reason = e.reason
         WHERE coalesce(e.attempts, 0) <> coalesce(f.attempts, 0)",
    },
    // A job is committed exactly if it has a result, and the result is of its newest attempt.
    Invariant {
        name: "committed_has_one_result",
        query: "SELECT format('job %d is %s at attempt %d and its result is of attempt %s',
             j.id, j.state, j.attempt, coalesce(r.attempt, 'none'))
         FROM job j LEFT JOIN result r ON r.job_id = j.id
         WHERE (j.state = 'committed' AND r.attempt IS NOT j.attempt)
             OR (j.state <> 'committed' AND r.job_id IS NOT NULL)",
    },
    // A quarantined job's last failure is one that quarantines, and the job's error is that
    // failure's.
    Invariant {
        name: "quarantine_has_its_failure",
        query: "SELECT format('job %d is quarantined and its attempt %d ended with %s', j.id,
             j.attempt, coalesce(f.reason, 'no failure'))
         FROM job j LEFT JOIN failure f ON f.job_id = j.id AND f.attempt = j.attempt
         WHERE j.state = 'quarantined'
             AND (coalesce(f.charged OR f.reason IN
                     ('takes_policy_down', 'takes_worker_down', 'skipped'), 0) = 0
                 OR j.last_error IS NOT f.error)",
    },
    // Every attempt either ended exactly once or holds the job's current lease.
    Invariant {
        name: "attempts_are_accounted_for",
        query: "SELECT format('job %d is %s: %d attempts, of which %d failed', j.id, j.state,
             j.attempt, (SELECT count(*) FROM failure f WHERE f.job_id = j.id))
         FROM job j WHERE j.attempt <> (j.state IN ('leased', 'committed'))
             + (SELECT count(*) FROM failure f WHERE f.job_id = j.id)",
    },
    // The charged attempts of a job are its charged failures since it was last taken out of
    // quarantine.
    Invariant {
        name: "charges_are_accounted_for",
        query: "SELECT format('job %d counts %d charged attempts after attempt %d, and has %s',
             j.id, j.charged_attempts, j.forgiven_attempt, 'another number of charged failures')
         FROM job j WHERE j.charged_attempts <> (SELECT count(*) FROM failure f
             WHERE f.job_id = j.id AND f.charged = 1 AND f.attempt > j.forgiven_attempt)",
    },
    // A job's losses are the attempts that lost their policy since the job last left quarantine.
    Invariant {
        name: "losses_are_accounted_for",
        query: "SELECT format('job %d counts %d losses after attempt %d, and has %s', j.id,
             j.losses, j.forgiven_attempt, 'another number of attempts that lost their policy')
         FROM job j WHERE j.losses <> (SELECT count(*) FROM failure f
             WHERE f.job_id = j.id AND f.reason IN ('policy_lost', 'takes_policy_down')
                 AND f.attempt > j.forgiven_attempt)",
    },
    // Results, failures and divergences belong to attempts that were granted.
    Invariant {
        name: "attempts_only_rise",
        query: "SELECT format('job %d is at attempt %d and has a %s of attempt %d', j.id,
             j.attempt, a.what, a.attempt)
         FROM (SELECT job_id, attempt, 'failure' AS what FROM failure
             UNION ALL SELECT job_id, attempt, 'result' FROM result
             UNION ALL SELECT job_id, attempt, 'divergence' FROM divergence) a
         JOIN job j ON j.id = a.job_id WHERE a.attempt > j.attempt",
    },
    // A campaign is pinned exactly if it has results.
    Invariant {
        name: "results_pin_the_campaign",
        query: "SELECT format('campaign %s is pinned to %s and has %s', c.name,
             coalesce(c.asset_pack, 'nothing'), iif(c.pinned_ms IS NULL, 'results', 'none'))
         FROM campaign c
         WHERE c.id NOT IN (SELECT campaign_id FROM passage)
             AND (c.pinned_ms IS NULL) = EXISTS
                 (SELECT 1 FROM result r WHERE r.campaign_id = c.id)",
    },
    // A cancelled campaign holds no lease.
    Invariant {
        name: "cancelled_leases_nothing",
        query: "SELECT format('job %d is leased and campaign %s is cancelled', j.id, c.name)
         FROM job j JOIN campaign c ON c.id = j.campaign_id
         WHERE j.state = 'leased' AND c.state = 'cancelled'",
    },
    // A campaign that stopped early holds no lease.
    Invariant {
        name: "stopped_leases_nothing",
        query: "SELECT format('job %d is leased and campaign %s has stopped', j.id, c.name)
         FROM job j JOIN campaign c ON c.id = j.campaign_id JOIN stop s ON s.campaign_id = c.id
         WHERE j.state = 'leased' AND s.stopped_ms IS NOT NULL",
    },
    // The attempt that probes a policy holds a lease on a job of that policy.
    Invariant {
        name: "probe_is_out",
        query: "SELECT format('policy %s is probed by attempt %s, which holds no lease', p.name,
             p.probe_attempt_id)
         FROM policy p WHERE p.state = 'probing' AND NOT EXISTS
             (SELECT 1 FROM job j JOIN campaign c ON c.id = j.campaign_id
              WHERE j.attempt_id = p.probe_attempt_id AND j.state = 'leased'
                  AND c.policy_id = p.id)",
    },
    // A result belongs to its job's campaign, and comes from the assets, the simulator, the
    // renderer, the look and the realisation that the campaign is pinned to.
    Invariant {
        name: "results_are_of_the_pin",
        query:
            "SELECT format('the result of job %d is not of the assets, simulator, renderer, look, '
             || 'realisation or job of campaign %s', r.job_id, c.name)
         FROM result r JOIN campaign c ON c.id = r.campaign_id
         JOIN job j ON j.id = r.job_id JOIN provenance p ON p.id = r.provenance_id
         WHERE j.campaign_id <> c.id OR p.asset_pack_digest IS NOT c.asset_pack_digest
             OR p.mujoco_version IS NOT c.mujoco_version OR p.realisation <> c.realisation
             OR p.look IS NOT c.look OR p.renderer IS NOT c.renderer",
    },
    // A result is within the step budget of its job, and its generated columns are those of its
    // outcome, which an edited file need not keep. `unreadable` checks the rest of the outcome.
    Invariant {
        name: RESULTS_INVARIANT,
        query: "SELECT format('the result of job %d has %d control steps, %d of them clipped, in '
             || '%s s, of at most %s steps', r.job_id, r.steps, r.outcome ->> 'clipped_actions',
             r.wall_secs, j.manifest_row ->> 'max_steps')
         FROM result r JOIN job j ON j.id = r.job_id
         WHERE r.steps > coalesce(j.manifest_row ->> 'max_steps', r.steps)
             OR r.outcome ->> 'clipped_actions' > r.steps
             OR r.success IS NOT r.outcome ->> 'success' OR r.steps IS NOT r.outcome ->> 'steps'
             OR r.wall_secs IS NOT r.outcome ->> 'wall_secs'",
    },
    // The results of one initial state agree on scene and initial state. Rollouts of
    // variants, whose ids have a colon, have scenes and states of their own. Other simulators, whose
    // tasks begin with `simulated/`, need not repeat an initial state.
    Invariant {
        name: "configurations_agree",
        query: "SELECT format('initial state %d of %s in campaign %s has %d scenes and %d initial '
             || 'states', j.init_id, j.task, c.name,
             count(DISTINCT r.outcome ->> '$.digests.scene'),
             count(DISTINCT r.outcome ->> '$.digests.init_state'))
         FROM result r JOIN job j ON j.id = r.job_id JOIN campaign c ON c.id = j.campaign_id
         WHERE instr(j.rollout_id, ':') = 0
         GROUP BY c.id, j.task, j.init_id
         HAVING count(DISTINCT r.outcome ->> '$.digests.scene') > 1
             OR count(DISTINCT r.outcome ->> '$.digests.init_state') > 1
                 AND j.task NOT LIKE 'simulated/%'",
    },
    // A divergent outcome differs from the committed one.
    Invariant {
        name: "divergences_differ",
        query: "SELECT format('divergence %d of job %d differs from no committed outcome', d.id,
             d.job_id)
         FROM divergence d LEFT JOIN result r ON r.job_id = d.job_id
         WHERE r.job_id IS NULL OR (r.success = d.success AND r.steps = d.steps)",
    },
    // A folder marked for removal belongs to no campaign.
    Invariant {
        name: "removals_are_of_no_campaign",
        query: "SELECT format('folder %s of campaign %s is to be removed', m.folder, c.name)
         FROM removal m JOIN campaign c ON m.folder = 'artifacts/' || coalesce(c.folder, c.name)",
    },
];

/// Checks every invariant of the database in a data folder, or of a database file. Read-only, in
/// one consistent view; a coordinator may be running on the database.
pub async fn check(path: &Path) -> Result<Vec<Violation>, CheckError> {
    let file = if path.is_dir() { path.join(DATABASE_FILE) } else { path.to_owned() };
    if !file.is_file() {
        return Err(CheckError::Missing { path: path.to_owned() });
    }
    let in_file = |source| CheckError::Read { path: file.clone(), source };
    let mut connection = open(&file).await.map_err(in_file)?;
    let known = store::newest_known_schema();
    let applied = store::applied_migrations(&mut connection).await.map_err(in_file)?;
    let found = applied.last().map_or(0, |(version, _)| *version);
    if found != known {
        return Err(CheckError::OtherSchema { path: file, found, known });
    }
    let violations = violations(&mut connection).await.map_err(in_file)?;
    connection.close().await.map_err(in_file)?;
    Ok(violations)
}

/// Opens a database for reading. A file without a write-ahead log is complete and used by no
/// process, so it is opened as immutable, without a lock. If there is a log, SQLite has to read the
/// database file and the log.
async fn open(file: &Path) -> Result<SqliteConnection, sqlx::Error> {
    let mut log = file.as_os_str().to_owned();
    log.push("-wal");
    let is_at_rest = !Path::new(&log).exists();
    let options = SqliteConnectOptions::new().filename(file).read_only(true);
    options.immutable(is_at_rest).connect().await
}

pub(crate) async fn violations(
    connection: &mut SqliteConnection,
) -> Result<Vec<Violation>, sqlx::Error> {
    store::load_schema(connection).await?;
    let mut view = connection.begin().await?;
    let mut violations = Vec::new();
    for Invariant { name, query } in INVARIANTS {
        let mut rows: Vec<String> = sqlx::query_scalar(query).fetch_all(&mut *view).await?;
        if name == RESULTS_INVARIANT {
            rows.extend(unreadable(&mut view).await?);
        }
        if !rows.is_empty() {
            violations.push(Violation {
                invariant: name,
                count: rows.len(),
                examples: rows.into_iter().take(MAX_EXAMPLES).collect(),
            });
        }
    }
    Ok(violations)
}

/// Describes the outcomes and origins that no worker can have reported.
async fn unreadable(view: &mut SqliteConnection) -> Result<Vec<String>, sqlx::Error> {
    let stored = sqlx::query_as(
        "SELECT 'the result of job ' || job_id, outcome, 1 FROM result
         UNION ALL SELECT format('divergence %d of job %d', id, job_id), outcome, 1 FROM divergence
         UNION ALL SELECT 'provenance ' || id, origin, 0 FROM provenance",
    );
    let described = stored.fetch(view).try_filter_map(async |row: (String, String, bool)| {
        let (name, json, is_outcome) = row;
        let problem = match is_outcome {
            true => RolloutResult::from_json(&json).map(|read| read.problem()),
            false => serde_json::from_str(&json).map(|read: Provenance| read.problem()),
        };
        let problem = problem.unwrap_or_else(|error| Some(json_problem(error)));
        Ok(problem.map(|problem| format!("{name}: {problem}")))
    });
    described.try_collect().await
}
