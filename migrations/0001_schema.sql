-- The coordinator's database: what is to be run, who holds it, what came out.
--
-- The CHECK constraints hold what the enums of `crates/queue/src/rules` express: a row
-- that they cannot express cannot be stored, and every state has exactly its own columns.
-- Instants end in `_ms`: milliseconds since the Unix epoch, UTC. Digests are SHA-256, hex.

-- Policies, workers and campaigns

-- A policy at one endpoint, shared by the campaigns that measure it, and kept as long as one does.
-- An outage pauses the jobs of this policy only; after `resume_ms` one job, the probe, is let
-- through, and its success resumes the rest.
CREATE TABLE policy (
    id               INTEGER PRIMARY KEY,
    endpoint         TEXT    NOT NULL CHECK (endpoint <> ''),
    name             TEXT    NOT NULL CHECK (name <> ''),
    state            TEXT    NOT NULL DEFAULT 'available'
                     CHECK (state IN ('available', 'paused', 'probing')),
    -- Outages since the last committed rollout; the back-off grows with them.
    outages          INTEGER NOT NULL DEFAULT 0 CHECK (outages >= 0),
    -- Attempts in a row that ended with an invalid answer.
    misbehaved       INTEGER NOT NULL DEFAULT 0 CHECK (misbehaved >= 0),
    -- Leases granted before this instant are no evidence of a new outage.
    available_ms     INTEGER NOT NULL,
    resume_ms        INTEGER,
    pause_reason     TEXT,
    probe_attempt_id TEXT,
    UNIQUE (endpoint, name),
    CHECK ((state = 'paused') = (resume_ms IS NOT NULL)),
    CHECK ((state = 'available') = (pause_reason IS NULL)),
    CHECK ((state = 'probing') = (probe_attempt_id IS NOT NULL)),
    CHECK (state = 'available' OR outages > 0)
) STRICT;

-- A worker process, by the id that it chose at its start.
CREATE TABLE worker (
    id               TEXT    PRIMARY KEY CHECK (id <> ''),
    host             TEXT    NOT NULL,
    -- The machine's id, if the worker can determine it.
    machine          TEXT    CHECK (machine <> ''),
    slots            INTEGER NOT NULL CHECK (slots > 0),
    -- Cores that the slots share.
    cores            INTEGER CHECK (cores > 0),
    asset_pack       TEXT    NOT NULL,
    asset_pack_digest TEXT   NOT NULL,
    mujoco_version   TEXT    NOT NULL,
    renderer         TEXT    NOT NULL,
    look             TEXT    NOT NULL,
    program_version  TEXT    NOT NULL,
    registered_ms    INTEGER NOT NULL,
    last_seen_ms     INTEGER NOT NULL,
    -- Last heartbeat: a lease that a later heartbeat leaves out was forgotten by its worker, a
    -- lease without a later heartbeat was cut off with it.
    heartbeat_ms     INTEGER,
    -- When the worker shut down cleanly; it may register again.
    signed_off_ms    INTEGER,
    charged_in_a_row INTEGER NOT NULL DEFAULT 0 CHECK (charged_in_a_row >= 0),
    -- Why the worker may lease no more, as it is told.
    stopped_reason   TEXT
) STRICT;

CREATE INDEX worker_seen ON worker (last_seen_ms);
CREATE INDEX worker_of_machine ON worker (machine, registered_ms) WHERE machine IS NOT NULL;

-- The first result pins a campaign to one asset pack, simulator, renderer and look: results of two
-- of them belong to two benchmarks and are never pooled.
CREATE TABLE campaign (
    -- AUTOINCREMENT: the number of a deleted campaign is not given again.
    id               INTEGER PRIMARY KEY AUTOINCREMENT,
    name             TEXT    NOT NULL UNIQUE CHECK (name <> ''),
    -- Folder of the campaign's files below `artifacts`, if it is not the name: a renamed campaign
    -- keeps its first folder.
    folder           TEXT    CHECK (folder <> ''),
    spec             TEXT    NOT NULL CHECK (json_valid(spec)),
    spec_digest      TEXT    NOT NULL CHECK (length(spec_digest) = 64),
    -- Name of the campaign that this one explains or measures, with whose results it is compared. It
    -- is renamed with that campaign, which cannot be deleted meanwhile.
    source           TEXT    GENERATED ALWAYS AS
                     (coalesce(spec ->> '$.purpose.explanation.campaign',
                         spec ->> '$.purpose.thresholds.campaign')) STORED,
    policy_id        INTEGER NOT NULL REFERENCES policy (id),
    realisation      TEXT    NOT NULL CHECK (realisation IN ('matched', 'reference')),
    -- What the robot does while its policy's answer is under way.
    execution        TEXT    NOT NULL,
    record           TEXT    NOT NULL CHECK (record IN ('none', 'failures', 'transitions', 'all')),
    -- Requirements on workers: {"assets": "libero", "renderer": "gl"}.
    wanted           TEXT    NOT NULL CHECK (json_type(wanted) = 'object'),
    -- Jobs of a higher priority are leased first.
    priority         INTEGER NOT NULL CHECK (priority BETWEEN -100 AND 100),
    -- Number of rollouts that the specification was expanded into.
    jobs             INTEGER NOT NULL CHECK (jobs >= 0),
    created_ms       INTEGER NOT NULL,
    -- Only the jobs of a running campaign are leased.
    state            TEXT    NOT NULL DEFAULT 'running'
                     CHECK (state IN ('running', 'paused', 'cancelled')),
    state_since_ms   INTEGER NOT NULL,
    pinned_ms        INTEGER,
    asset_pack       TEXT,
    asset_pack_digest TEXT,
    mujoco_version   TEXT,
    renderer         TEXT    CHECK (renderer <> ''),
    look             TEXT,
    CHECK ((pinned_ms IS NULL) = (asset_pack IS NULL)),
    CHECK ((pinned_ms IS NULL) = (asset_pack_digest IS NULL)),
    CHECK ((pinned_ms IS NULL) = (mujoco_version IS NULL)),
    CHECK ((pinned_ms IS NULL) = (renderer IS NULL)),
    CHECK ((pinned_ms IS NULL) = (look IS NULL))
) STRICT;

CREATE INDEX campaign_by_policy ON campaign (policy_id);
CREATE INDEX campaign_by_source ON campaign (source) WHERE source IS NOT NULL;
CREATE UNIQUE INDEX campaign_folder ON campaign (coalesce(folder, name));

CREATE TRIGGER campaign_cancelled_is_final
BEFORE UPDATE OF state ON campaign WHEN OLD.state = 'cancelled' AND NEW.state <> 'cancelled'
BEGIN
    SELECT RAISE (ABORT, 'campaign_cancelled_is_final');
END;

-- Former names of campaigns, so that a command with one is told the present name. A campaign that
-- takes the name deletes the row.
CREATE TABLE former_name (
    name             TEXT    PRIMARY KEY CHECK (name <> ''),
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

CREATE INDEX former_name_of ON former_name (campaign_id);

-- The tasks of a campaign: at most a few score rows, which a claim walks instead of the job table.
CREATE TABLE campaign_task (
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    task             TEXT    NOT NULL CHECK (task LIKE '%/%'),
    PRIMARY KEY (campaign_id, task)
) STRICT, WITHOUT ROWID;

-- A campaign that may end early, as its specification says: its configurations are in a random
-- order, drawn at its creation, and leased in that order.
CREATE TABLE stop (
    campaign_id      INTEGER PRIMARY KEY REFERENCES campaign (id) ON DELETE CASCADE,
    -- All of the campaign's.
    configurations   INTEGER NOT NULL CHECK (configurations > 0),
    -- Configurations, in the random order, after which the rule was met. From then on the campaign
    -- is stopped, whatever its `state`.
    used             INTEGER CHECK (used > 0 AND used < configurations),
    stopped_ms       INTEGER,
    CHECK ((used IS NULL) = (stopped_ms IS NULL))
) STRICT;

CREATE TRIGGER stop_is_final
BEFORE UPDATE ON stop WHEN OLD.stopped_ms IS NOT NULL
BEGIN
    SELECT RAISE (ABORT, 'stop_is_final');
END;

CREATE TRIGGER stop_ends_no_cancelled_campaign
BEFORE UPDATE ON stop
WHEN EXISTS (SELECT 1 FROM campaign WHERE id = NEW.campaign_id AND state = 'cancelled')
BEGIN
    SELECT RAISE (ABORT, 'stop_ends_no_cancelled_campaign');
END;

-- Campaigns that are inserted or deleted in batches, hidden meanwhile. One that is left when the
-- coordinator ends is deleted at the next start.
CREATE TABLE passage (
    campaign_id      INTEGER PRIMARY KEY REFERENCES campaign (id) ON DELETE CASCADE
) STRICT;

-- Folders of deleted campaigns' files that are still on the disk: a row is inserted with the
-- deletion, and deleted when the folder is gone.
CREATE TABLE removal (
    folder           TEXT    PRIMARY KEY CHECK (folder <> '')
) STRICT, WITHOUT ROWID;

-- Jobs and their attempts

-- One rollout of one replicate. `attempt` counts the leases and only rises; `attempt_id` names the
-- current lease in every call.
CREATE TABLE job (
    -- AUTOINCREMENT: the number of a deleted job is not given again.
    id               INTEGER PRIMARY KEY AUTOINCREMENT,
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    rollout_id       TEXT    NOT NULL CHECK (rollout_id <> ''),
    replicate        INTEGER NOT NULL CHECK (replicate >= 0),
    task             TEXT    NOT NULL CHECK (task LIKE '%/%'),
    init_id          INTEGER NOT NULL CHECK (init_id >= 0),
    -- Place in paired-unit order: the conditions of one configuration and its nominal rollout are
    -- neighbours.
    unit_order       INTEGER NOT NULL CHECK (unit_order >= 0),
    manifest_row     TEXT    NOT NULL CHECK (json_valid(manifest_row)),
    policy_seed      INTEGER NOT NULL CHECK (policy_seed >= 0),
    state            TEXT    NOT NULL DEFAULT 'queued'
                     CHECK (state IN ('queued', 'leased', 'committed', 'quarantined')),
    attempt          INTEGER NOT NULL DEFAULT 0 CHECK (attempt >= 0),
    charged_attempts INTEGER NOT NULL DEFAULT 0
                     CHECK (charged_attempts BETWEEN 0 AND attempt),
    -- Failures up to this attempt were forgiven when an operator retried the job.
    forgiven_attempt INTEGER NOT NULL DEFAULT 0
                     CHECK (forgiven_attempt BETWEEN 0 AND attempt),
    -- Attempts that lost their policy since then.
    losses           INTEGER NOT NULL DEFAULT 0 CHECK (losses >= 0),
    not_before_ms    INTEGER DEFAULT 0,
    -- The lease. `claim_id` is the claim that asked for it, so that a repeated claim gets the same
    -- leases; no heartbeat extends the lease past `ceiling_ms`.
    attempt_id       TEXT
                     CHECK ((state = 'leased') = (attempt_id IS NOT NULL)
                         AND length(attempt_id) = 32),
    claim_id         TEXT    CHECK ((state = 'leased') = (claim_id IS NOT NULL)),
    lease_owner      TEXT    REFERENCES worker (id),
    leased_ms        INTEGER,
    lease_expires_ms INTEGER,
    ceiling_ms       INTEGER CHECK ((state = 'leased') = (ceiling_ms IS NOT NULL)),
    -- True after the first heartbeat that names the attempt.
    acknowledged     INTEGER
                     CHECK ((state = 'leased') = (acknowledged IS NOT NULL)
                         AND acknowledged IN (0, 1)),
    control_steps    INTEGER,
    last_error       TEXT,
    stale_reports    INTEGER NOT NULL DEFAULT 0 CHECK (stale_reports >= 0),
    UNIQUE (campaign_id, rollout_id, replicate),
    FOREIGN KEY (campaign_id, task) REFERENCES campaign_task (campaign_id, task),
    CHECK ((state = 'queued') = (not_before_ms IS NOT NULL)),
    CHECK ((state = 'leased') = (lease_owner IS NOT NULL)),
    CHECK ((state = 'leased') = (leased_ms IS NOT NULL)),
    CHECK ((state = 'leased') = (lease_expires_ms IS NOT NULL)),
    CHECK ((state = 'leased') = (control_steps IS NOT NULL)),
    CHECK (state = 'queued' OR attempt > 0),
    CHECK (state <> 'quarantined' OR last_error IS NOT NULL)
) STRICT;

-- What a claim walks: only rows that wait, so that its cost does not grow with the campaign.
CREATE INDEX job_queued ON job (campaign_id, task, unit_order) WHERE state = 'queued';
-- Likewise jobs that lost their policy so often that they are run alone only, jobs that failed so
-- often that they avoid machines, jobs that fall due, and leases.
CREATE INDEX job_alone ON job (campaign_id, unit_order) WHERE state = 'queued' AND losses >= 4;
CREATE INDEX job_failing ON job (campaign_id) WHERE state = 'queued' AND charged_attempts >= 3;
CREATE INDEX job_backed_off ON job (not_before_ms) WHERE state = 'queued' AND not_before_ms > 0;
CREATE INDEX job_leased ON job (lease_expires_ms) WHERE state = 'leased';
CREATE INDEX job_held ON job (campaign_id, task, lease_owner) WHERE state = 'leased';
CREATE UNIQUE INDEX job_attempt ON job (attempt_id) WHERE state = 'leased';
CREATE INDEX job_claim ON job (claim_id) WHERE state = 'leased';
CREATE INDEX job_quarantined ON job (campaign_id, rollout_id, replicate)
    WHERE state = 'quarantined';
-- What a commit walks to find its configuration's siblings.
CREATE INDEX job_siblings ON job (campaign_id, task, init_id) WHERE state = 'committed';

-- Copies of campaigns count on from these rows, which SQLite would insert with the first job.
INSERT INTO sqlite_sequence (name, seq) VALUES ('campaign', 0), ('job', 0);

CREATE TRIGGER job_attempt_only_rises
BEFORE UPDATE OF attempt ON job WHEN NEW.attempt < OLD.attempt
BEGIN
    SELECT RAISE (ABORT, 'job_attempt_only_rises');
END;

CREATE TRIGGER job_committed_is_final
BEFORE UPDATE OF state ON job WHEN OLD.state = 'committed' AND NEW.state <> 'committed'
BEGIN
    SELECT RAISE (ABORT, 'job_committed_is_final');
END;

-- The result is inserted first, in the same transaction.
CREATE TRIGGER job_committed_has_a_result
BEFORE UPDATE OF state ON job
WHEN NEW.state = 'committed' AND NOT EXISTS
    (SELECT 1 FROM result WHERE job_id = NEW.id AND attempt = NEW.attempt)
BEGIN
    SELECT RAISE (ABORT, 'job_committed_has_a_result');
END;

-- How every attempt without a result ended: at most once each.
CREATE TABLE failure (
    attempt_id       TEXT    PRIMARY KEY CHECK (length(attempt_id) = 32),
    job_id           INTEGER NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    attempt          INTEGER NOT NULL CHECK (attempt > 0),
    worker_id        TEXT    NOT NULL,
    failed_ms        INTEGER NOT NULL,
    reason           TEXT    NOT NULL CHECK (reason IN
                     ('simulator_error', 'machine_error', 'slot_crashed', 'slot_stuck',
                      'policy_misbehaved', 'lease_lost', 'overdue', 'unpaired',
                      'policy_unavailable', 'draining', 'cancelled', 'unsuited',
                      'never_acknowledged', 'worker_silent', 'policy_lost',
                      'takes_policy_down', 'takes_worker_down', 'skipped')),
    charged          INTEGER NOT NULL CHECK (charged IN (0, 1)),
    error            TEXT    NOT NULL,
    -- The lease that was cut off with its worker, as long as that worker may still report the
    -- result: until the job is leased again, or the ceiling.
    leased_ms        INTEGER,
    ceiling_ms       INTEGER CHECK ((ceiling_ms IS NULL) = (leased_ms IS NULL)),
    UNIQUE (job_id, attempt),
    CHECK (charged = (reason NOT IN
        ('policy_unavailable', 'draining', 'cancelled', 'unsuited', 'never_acknowledged',
         'worker_silent', 'policy_lost', 'takes_policy_down', 'takes_worker_down', 'skipped')))
) STRICT, WITHOUT ROWID;

CREATE INDEX failure_cut_off ON failure (job_id) WHERE ceiling_ms IS NOT NULL;

-- Results

-- The part of a result's origin that many results share: the JSON of benchmark::attempt::Provenance. The
-- generated columns are those that statements read.
CREATE TABLE provenance (
    id               INTEGER PRIMARY KEY,
    origin           TEXT    NOT NULL UNIQUE,
    renderer         TEXT    NOT NULL AS (origin ->> 'renderer') VIRTUAL,
    look             TEXT    NOT NULL AS (origin ->> 'look') VIRTUAL,
    -- Digest of a fixed motion and its frames: equal fingerprints mean equal bits.
    fingerprint      TEXT    NOT NULL AS (origin ->> 'fingerprint') VIRTUAL,
    mujoco_version   TEXT    NOT NULL AS (origin ->> 'mujoco_version') VIRTUAL,
    asset_pack_digest TEXT   NOT NULL AS (origin ->> 'asset_pack_digest') VIRTUAL,
    realisation      TEXT    NOT NULL AS (origin ->> 'realisation') VIRTUAL,
    policy_name      TEXT    NOT NULL AS (origin ->> 'policy_name') VIRTUAL,
    policy_checkpoint TEXT   NOT NULL AS (origin ->> 'policy_checkpoint') VIRTUAL,
    policy_checkpoint_digest TEXT NOT NULL AS (origin ->> 'policy_checkpoint_digest') VIRTUAL
) STRICT;

-- The outcome of a committed job: one, for ever.
CREATE TABLE result (
    job_id           INTEGER PRIMARY KEY REFERENCES job (id) ON DELETE CASCADE,
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    attempt_id       TEXT    NOT NULL UNIQUE CHECK (length(attempt_id) = 32),
    attempt          INTEGER NOT NULL CHECK (attempt > 0),
    worker_id        TEXT    NOT NULL REFERENCES worker (id),
    committed_ms     INTEGER NOT NULL,
    provenance_id    INTEGER NOT NULL REFERENCES provenance (id),
    -- The JSON of benchmark::attempt::RolloutResult, which checks its bounds. The generated columns are
    -- those that statements read of many results.
    outcome          TEXT    NOT NULL,
    success          INTEGER NOT NULL AS (outcome ->> 'success') STORED CHECK (success IN (0, 1)),
    steps            INTEGER NOT NULL AS (outcome ->> 'steps') STORED CHECK (steps >= 0),
    wall_secs        REAL    NOT NULL AS (outcome ->> 'wall_secs') STORED CHECK (wall_secs >= 0)
) STRICT;

CREATE INDEX result_by_time ON result (campaign_id, committed_ms, success);
-- The results of a campaign that share an origin, and so a fingerprint.
CREATE INDEX result_by_origin ON result (campaign_id, provenance_id);

CREATE TRIGGER result_is_of_the_held_lease
BEFORE INSERT ON result
WHEN NOT EXISTS (SELECT 1 FROM job WHERE id = NEW.job_id AND state = 'leased'
    AND lease_owner = NEW.worker_id AND attempt_id = NEW.attempt_id AND attempt = NEW.attempt)
BEGIN
    SELECT RAISE (ABORT, 'result_is_of_the_held_lease');
END;

-- How the robot of a committed rollout moved: positions of its end-effector (x, y, z, tenths of a
-- millimetre, 16 bits each) and, if they are kept, its actions (seven 32-bit floats per control
-- step).
CREATE TABLE motion (
    job_id           INTEGER PRIMARY KEY REFERENCES job (id) ON DELETE CASCADE,
    path             BLOB    NOT NULL CHECK (length(path) % 6 = 0),
    actions          BLOB    NOT NULL CHECK (length(actions) % 28 = 0)
) STRICT;

-- Files kept beside an outcome, by kind; the path is below the data folder.
CREATE TABLE artifact (
    attempt_id       TEXT    NOT NULL REFERENCES result (attempt_id) ON DELETE CASCADE,
    kind             TEXT    NOT NULL CHECK (kind IN ('video')),
    path             TEXT    NOT NULL CHECK (path <> ''),
    size_bytes       INTEGER NOT NULL CHECK (size_bytes >= 0),
    stored_ms        INTEGER NOT NULL,
    PRIMARY KEY (attempt_id, kind)
) STRICT, WITHOUT ROWID;

-- Films are found by their path while they are moved to the storage.
CREATE INDEX artifact_path ON artifact (path);

-- A committed rollout that was reported again with another outcome: for a deterministic policy a
-- finding, so it is kept.
CREATE TABLE divergence (
    id               INTEGER PRIMARY KEY,
    job_id           INTEGER NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    attempt          INTEGER NOT NULL CHECK (attempt > 0),
    worker_id        TEXT    NOT NULL,
    reported_ms      INTEGER NOT NULL,
    provenance_id    INTEGER NOT NULL REFERENCES provenance (id),
    -- As in `result`.
    outcome          TEXT    NOT NULL,
    success          INTEGER NOT NULL AS (outcome ->> 'success') STORED CHECK (success IN (0, 1)),
    steps            INTEGER NOT NULL AS (outcome ->> 'steps') STORED CHECK (steps >= 0),
    UNIQUE (job_id, attempt, worker_id, success, steps)
) STRICT;

-- Tallies

-- Counts that pages, metrics and claims read continually. Triggers keep them in the transaction that
-- changes what is counted, so that reading one costs the same in a campaign of any size; the
-- invariant `tallies_are_true` counts again.

-- The jobs of a campaign by state, and its successes.
CREATE TABLE tally (
    campaign_id      INTEGER PRIMARY KEY REFERENCES campaign (id) ON DELETE CASCADE,
    queued           INTEGER NOT NULL DEFAULT 0 CHECK (queued >= 0),
    leased           INTEGER NOT NULL DEFAULT 0 CHECK (leased >= 0),
    committed        INTEGER NOT NULL DEFAULT 0 CHECK (committed >= 0),
    quarantined      INTEGER NOT NULL DEFAULT 0 CHECK (quarantined >= 0),
    succeeded        INTEGER NOT NULL DEFAULT 0 CHECK (succeeded >= 0),
    -- Rises whenever a job is committed, enters quarantine or leaves it. Equal revisions of one
    -- campaign mean equal outcomes.
    revision         INTEGER NOT NULL DEFAULT 0 CHECK (revision >= 0)
) STRICT;

-- The results of a campaign by origin.
CREATE TABLE origin_tally (
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    provenance_id    INTEGER NOT NULL,
    results          INTEGER NOT NULL CHECK (results >= 0),
    PRIMARY KEY (campaign_id, provenance_id)
) STRICT, WITHOUT ROWID;

-- Attempts without a result, by the way in which they ended.
CREATE TABLE ending_tally (
    reason           TEXT    PRIMARY KEY,
    attempts         INTEGER NOT NULL CHECK (attempts >= 0)
) STRICT, WITHOUT ROWID;

CREATE TRIGGER tally_begins AFTER INSERT ON campaign
BEGIN
    INSERT INTO tally (campaign_id) VALUES (NEW.id);
END;

CREATE TRIGGER tally_of_new_job AFTER INSERT ON job
BEGIN
    UPDATE tally SET queued = queued + (NEW.state = 'queued'),
        leased = leased + (NEW.state = 'leased'),
        committed = committed + (NEW.state = 'committed'),
        quarantined = quarantined + (NEW.state = 'quarantined')
    WHERE campaign_id = NEW.campaign_id;
END;

CREATE TRIGGER tally_of_deleted_job AFTER DELETE ON job
BEGIN
    UPDATE tally SET queued = queued - (OLD.state = 'queued'),
        leased = leased - (OLD.state = 'leased'),
        committed = committed - (OLD.state = 'committed'),
        quarantined = quarantined - (OLD.state = 'quarantined'),
        revision = revision + 1
    WHERE campaign_id = OLD.campaign_id;
END;

CREATE TRIGGER tally_of_job AFTER UPDATE OF state ON job WHEN NEW.state <> OLD.state
BEGIN
    UPDATE tally SET queued = queued + (NEW.state = 'queued') - (OLD.state = 'queued'),
        leased = leased + (NEW.state = 'leased') - (OLD.state = 'leased'),
        committed = committed + (NEW.state = 'committed') - (OLD.state = 'committed'),
        quarantined = quarantined + (NEW.state = 'quarantined') - (OLD.state = 'quarantined'),
        revision = revision + (NEW.state IN ('committed', 'quarantined')
            OR OLD.state IN ('committed', 'quarantined'))
    WHERE campaign_id = NEW.campaign_id;
END;

CREATE TRIGGER tally_of_result AFTER INSERT ON result
BEGIN
    UPDATE tally SET succeeded = succeeded + NEW.success WHERE campaign_id = NEW.campaign_id;
    INSERT INTO origin_tally (campaign_id, provenance_id, results)
    VALUES (NEW.campaign_id, NEW.provenance_id, 1)
    ON CONFLICT (campaign_id, provenance_id) DO UPDATE SET results = results + 1;
END;

CREATE TRIGGER tally_of_deleted_result AFTER DELETE ON result
BEGIN
    UPDATE tally SET succeeded = succeeded - OLD.success WHERE campaign_id = OLD.campaign_id;
    UPDATE origin_tally SET results = results - 1
    WHERE campaign_id = OLD.campaign_id AND provenance_id = OLD.provenance_id;
END;

CREATE TRIGGER tally_of_failure AFTER INSERT ON failure
BEGIN
    INSERT INTO ending_tally (reason, attempts) VALUES (NEW.reason, 1)
    ON CONFLICT (reason) DO UPDATE SET attempts = attempts + 1;
END;

CREATE TRIGGER tally_of_deleted_failure AFTER DELETE ON failure
BEGIN
    UPDATE ending_tally SET attempts = attempts - 1 WHERE reason = OLD.reason;
END;
