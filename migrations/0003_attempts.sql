-- Every attempt has an id of its own, which names it in every call and beside
-- every row; claims are idempotent; realised values take the place of digests;
-- a policy that answers nonsense pauses; the first result pins a campaign.

-- Workers of the former protocol cannot be spoken to any more: what they hold
-- is queued again, charged to nobody.
INSERT INTO failure (job_id, attempt, worker_id, failed_ms, reason, charged, error)
SELECT id, attempt, lease_owner, leased_ms, 'draining', 0, 'the coordinator was upgraded'
FROM job WHERE state = 'leased';

UPDATE job SET state = 'queued', not_before_ms = 0, lease_owner = NULL, leased_ms = NULL,
    lease_expires_ms = NULL, control_steps = NULL
WHERE state = 'leased';

UPDATE policy SET state = 'paused', resume_ms = 0, probe_job_id = NULL, probe_attempt = NULL
WHERE state = 'probing';

-- SQLite changes no CHECK and no UNIQUE: tables are made anew, under the rows
-- that refer to them.
PRAGMA defer_foreign_keys = ON;

CREATE TEMP TABLE former_policy AS SELECT * FROM policy;

DROP TABLE policy;

-- One row per policy at one endpoint, shared by the campaigns that measure it.
-- An outage pauses the jobs of this policy and of no other; after `resume_ms`
-- one job, the probe, is let through, and its success resumes the rest.
CREATE TABLE policy (
    id               INTEGER PRIMARY KEY,
    endpoint         TEXT    NOT NULL CHECK (endpoint <> ''),
    name             TEXT    NOT NULL CHECK (name <> ''),
    state            TEXT    NOT NULL DEFAULT 'available'
                     CHECK (state IN ('available', 'paused', 'probing')),
    -- Outages since the last committed rollout: what the back-off grows with.
    outages          INTEGER NOT NULL DEFAULT 0 CHECK (outages >= 0),
    -- Attempts in a row that it answered nonsense in.
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

INSERT INTO policy (id, endpoint, name, state, outages, available_ms, resume_ms, pause_reason)
SELECT id, endpoint, name, state, outages, available_ms, resume_ms, pause_reason
FROM former_policy;

DROP TABLE former_policy;

-- What a campaign asks of its workers: {"assets": "libero", "renderer": "gl"}.
ALTER TABLE campaign ADD COLUMN wanted TEXT NOT NULL DEFAULT '{}'
    CHECK (json_type(wanted) = 'object');

UPDATE campaign SET pinned_ms = NULL, asset_pack = NULL, asset_pack_digest = NULL,
    mujoco_version = NULL, renderer = NULL
WHERE NOT EXISTS (SELECT 1 FROM result r WHERE r.campaign_id = campaign.id);

-- A lease has the id of its attempt, the claim that asked for it, whether its
-- worker has acknowledged it, and an instant that no heartbeat extends it past.
ALTER TABLE job ADD COLUMN attempt_id TEXT
    CHECK ((state = 'leased') = (attempt_id IS NOT NULL) AND length(attempt_id) = 32);
ALTER TABLE job ADD COLUMN claim_id TEXT CHECK ((state = 'leased') = (claim_id IS NOT NULL));
ALTER TABLE job ADD COLUMN acknowledged INTEGER
    CHECK ((state = 'leased') = (acknowledged IS NOT NULL) AND acknowledged IN (0, 1));
ALTER TABLE job ADD COLUMN ceiling_ms INTEGER
    CHECK ((state = 'leased') = (ceiling_ms IS NOT NULL));

CREATE UNIQUE INDEX job_attempt ON job (attempt_id) WHERE state = 'leased';
CREATE INDEX job_claim ON job (claim_id) WHERE state = 'leased';

CREATE TEMP TABLE former_failure AS SELECT * FROM failure;

DROP TABLE failure;

-- How every attempt that brought no result ended: at most once each.
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
                      'never_acknowledged')),
    charged          INTEGER NOT NULL CHECK (charged IN (0, 1)),
    error            TEXT    NOT NULL,
    UNIQUE (job_id, attempt),
    CHECK (charged = (reason NOT IN
        ('policy_unavailable', 'draining', 'cancelled', 'unsuited', 'never_acknowledged')))
) STRICT, WITHOUT ROWID;

INSERT INTO failure (attempt_id, job_id, attempt, worker_id, failed_ms, reason, charged, error)
SELECT lower(hex(randomblob(16))), job_id, attempt, worker_id, failed_ms, reason, charged, error
FROM former_failure;

DROP TABLE former_failure;

CREATE TEMP TABLE former_result AS SELECT * FROM result;

DROP TABLE result;

-- The committed outcome of a job: one, for ever.
CREATE TABLE result (
    job_id           INTEGER PRIMARY KEY REFERENCES job (id) ON DELETE CASCADE,
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    attempt_id       TEXT    NOT NULL UNIQUE CHECK (length(attempt_id) = 32),
    attempt          INTEGER NOT NULL CHECK (attempt > 0),
    worker_id        TEXT    NOT NULL REFERENCES worker (id),
    committed_ms     INTEGER NOT NULL,
    success          INTEGER NOT NULL CHECK (success IN (0, 1)),
    steps            INTEGER NOT NULL CHECK (steps >= 0),
    wall_secs        REAL    NOT NULL CHECK (wall_secs >= 0),
    ik_residual_mm   REAL,
    ik_residual_deg  REAL,
    ik_clamped_joints INTEGER,
    clipped_actions  INTEGER NOT NULL CHECK (clipped_actions >= 0),
    policy_queries   INTEGER NOT NULL CHECK (policy_queries >= 0),
    provenance_id    INTEGER NOT NULL REFERENCES provenance (id),
    scene_digest     TEXT    NOT NULL CHECK (length(scene_digest) = 64),
    init_state_digest TEXT   NOT NULL CHECK (length(init_state_digest) = 64),
    first_frame_digest TEXT  NOT NULL CHECK (length(first_frame_digest) IN (0, 64)),
    -- The perturbation as realised, by axis: {"camera": {"parameters": [...],
    -- "elements": [...]}}. Results of schema 2 and before have the SHA-256 of
    -- the values instead: {"camera": "HEX"}.
    realised         TEXT    NOT NULL CHECK (json_type(realised) = 'object')
) STRICT;

INSERT INTO result (job_id, campaign_id, attempt_id, attempt, worker_id, committed_ms, success,
    steps, wall_secs, ik_residual_mm, ik_residual_deg, ik_clamped_joints, clipped_actions,
    policy_queries, provenance_id, scene_digest, init_state_digest, first_frame_digest, realised)
SELECT job_id, campaign_id, lower(hex(randomblob(16))), attempt, worker_id, committed_ms, success,
    steps, wall_secs, ik_residual_mm, ik_residual_deg, ik_clamped_joints, clipped_actions,
    policy_queries, provenance_id, scene_digest, init_state_digest, first_frame_digest,
    CASE perturbation_digests WHEN '' THEN '{}' ELSE
        '{"' || replace(replace(perturbation_digests, ':', '":"'), ',', '","') || '"}' END
FROM former_result;

DROP TABLE former_result;

CREATE INDEX result_by_time ON result (campaign_id, committed_ms, success);
CREATE INDEX result_by_origin ON result (campaign_id, provenance_id);

CREATE TRIGGER result_is_of_the_held_lease
BEFORE INSERT ON result
WHEN NOT EXISTS (SELECT 1 FROM job WHERE id = NEW.job_id AND state = 'leased'
    AND lease_owner = NEW.worker_id AND attempt_id = NEW.attempt_id AND attempt = NEW.attempt)
BEGIN
    SELECT RAISE (ABORT, 'result_is_of_the_held_lease');
END;

-- Files were kept by job: one that a failed attempt left is of no outcome, and
-- goes with the next start.
INSERT OR IGNORE INTO removal (folder)
SELECT a.path FROM artifact a LEFT JOIN result r ON r.job_id = a.job_id AND r.attempt = a.attempt
WHERE r.job_id IS NULL;

CREATE TEMP TABLE former_artifact AS
SELECT r.attempt_id, a.kind, a.path, a.size_bytes, a.stored_ms
FROM artifact a JOIN result r ON r.job_id = a.job_id AND r.attempt = a.attempt;

DROP TABLE artifact;

-- Files kept beside an outcome, by kind; the path is below the data folder.
CREATE TABLE artifact (
    attempt_id       TEXT    NOT NULL REFERENCES result (attempt_id) ON DELETE CASCADE,
    kind             TEXT    NOT NULL CHECK (kind IN ('video')),
    path             TEXT    NOT NULL CHECK (path <> ''),
    size_bytes       INTEGER NOT NULL CHECK (size_bytes >= 0),
    stored_ms        INTEGER NOT NULL,
    PRIMARY KEY (attempt_id, kind)
) STRICT, WITHOUT ROWID;

INSERT INTO artifact SELECT * FROM former_artifact;

DROP TABLE former_artifact;

-- Operators steer a campaign that is there: which goes first, where its policy
-- is, what it is called. A worker that ends says so.

-- Jobs of a higher priority are leased first.
ALTER TABLE campaign ADD COLUMN priority INTEGER NOT NULL DEFAULT 0
    CHECK (priority BETWEEN -100 AND 100);

-- The folder of its files below `artifacts`, once it is not its name: a renamed
-- campaign keeps the one that it was created with.
ALTER TABLE campaign ADD COLUMN folder TEXT CHECK (folder <> '');

CREATE UNIQUE INDEX campaign_folder ON campaign (coalesce(folder, name));

-- What campaigns were called before: who asks for the old name is told the new
-- one. A campaign that takes the name takes the row out.
CREATE TABLE former_name (
    name             TEXT    PRIMARY KEY CHECK (name <> ''),
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;

CREATE INDEX former_name_of ON former_name (campaign_id);

-- When a worker ended in good order; it may announce itself again.
ALTER TABLE worker ADD COLUMN signed_off_ms INTEGER;

-- A policy is kept as long as a campaign measures it.
DELETE FROM policy WHERE id NOT IN (SELECT policy_id FROM campaign);
