-- The campaign's memory: what is to be run, who holds it, what came out.
--
-- The CHECK constraints say what the Rust enums of coordinator::lease,
-- coordinator::campaign and coordinator::outage say, in both directions: a row
-- that the enum cannot express cannot be stored, and every state carries
-- exactly its own columns. Instants are milliseconds since the Unix epoch, UTC.

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
    -- Leases granted before this instant are no evidence of a new outage.
    available_ms     INTEGER NOT NULL,
    resume_ms        INTEGER,
    pause_reason     TEXT,
    probe_job_id     INTEGER,
    probe_attempt    INTEGER,
    UNIQUE (endpoint, name),
    CHECK ((state = 'paused') = (resume_ms IS NOT NULL)),
    CHECK ((state = 'available') = (pause_reason IS NULL)),
    CHECK ((state = 'probing') = (probe_job_id IS NOT NULL)),
    CHECK ((state = 'probing') = (probe_attempt IS NOT NULL)),
    CHECK (state = 'available' OR outages > 0)
) STRICT;

-- A campaign is pinned by its first lease to one asset pack and one MuJoCo:
-- results of two packs or two simulators are two benchmarks, never pooled.
CREATE TABLE campaign (
    id               INTEGER PRIMARY KEY,
    name             TEXT    NOT NULL UNIQUE CHECK (name <> ''),
    spec             TEXT    NOT NULL CHECK (json_valid(spec)),
    spec_digest      TEXT    NOT NULL CHECK (length(spec_digest) = 64),
    policy_id        INTEGER NOT NULL REFERENCES policy (id),
    realisation      TEXT    NOT NULL CHECK (realisation IN ('matched', 'reference')),
    record           TEXT    NOT NULL CHECK (record IN ('none', 'failures', 'transitions', 'all')),
    -- Rollouts that it was expanded into.
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
    CHECK ((pinned_ms IS NULL) = (asset_pack IS NULL)),
    CHECK ((pinned_ms IS NULL) = (asset_pack_digest IS NULL)),
    CHECK ((pinned_ms IS NULL) = (mujoco_version IS NULL))
) STRICT;

CREATE INDEX campaign_by_policy ON campaign (policy_id);

CREATE TRIGGER campaign_cancelled_is_final
BEFORE UPDATE OF state ON campaign WHEN OLD.state = 'cancelled' AND NEW.state <> 'cancelled'
BEGIN
    SELECT RAISE (ABORT, 'campaign_cancelled_is_final');
END;

-- Folders of deleted campaigns' files that are still on the disk: a row goes
-- in with the deletion and out when the folder is gone.
CREATE TABLE removal (
    folder           TEXT    PRIMARY KEY CHECK (folder <> '')
) STRICT, WITHOUT ROWID;

-- The tasks of a campaign: at most a few score rows, which a claim walks
-- instead of the job table.
CREATE TABLE campaign_task (
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    task             TEXT    NOT NULL CHECK (task LIKE '%/%'),
    PRIMARY KEY (campaign_id, task)
) STRICT, WITHOUT ROWID;

-- A worker process, by the id that it chose at its start.
CREATE TABLE worker (
    id               TEXT    PRIMARY KEY CHECK (id <> ''),
    host             TEXT    NOT NULL,
    slots            INTEGER NOT NULL CHECK (slots > 0),
    asset_pack       TEXT    NOT NULL,
    asset_pack_digest TEXT   NOT NULL,
    mujoco_version   TEXT    NOT NULL,
    gl_renderer      TEXT    NOT NULL,
    program_version  TEXT    NOT NULL,
    registered_ms    INTEGER NOT NULL,
    last_seen_ms     INTEGER NOT NULL,
    charged_in_a_row INTEGER NOT NULL DEFAULT 0 CHECK (charged_in_a_row >= 0),
    -- Set when it may lease no more, in the words that it is told.
    stopped_reason   TEXT
) STRICT;

CREATE INDEX worker_seen ON worker (last_seen_ms);

-- One rollout × replicate. `attempt` is the fencing token: it only rises, and
-- only the newest attempt may renew, commit or release.
CREATE TABLE job (
    id               INTEGER PRIMARY KEY,
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    rollout_id       TEXT    NOT NULL CHECK (rollout_id <> ''),
    replicate        INTEGER NOT NULL CHECK (replicate >= 0),
    task             TEXT    NOT NULL CHECK (task LIKE '%/%'),
    init_id          INTEGER NOT NULL CHECK (init_id >= 0),
    -- Place in paired-unit order: the conditions of one configuration and
    -- its nominal rollout are neighbours.
    unit_order       INTEGER NOT NULL CHECK (unit_order >= 0),
    manifest_row     TEXT    NOT NULL CHECK (json_valid(manifest_row)),
    policy_seed      INTEGER NOT NULL CHECK (policy_seed >= 0),
    state            TEXT    NOT NULL DEFAULT 'queued'
                     CHECK (state IN ('queued', 'leased', 'committed', 'quarantined')),
    attempt          INTEGER NOT NULL DEFAULT 0 CHECK (attempt >= 0),
    charged_attempts INTEGER NOT NULL DEFAULT 0
                     CHECK (charged_attempts BETWEEN 0 AND attempt),
    -- Failures up to this attempt were forgiven when the job was taken out of
    -- quarantine by hand.
    forgiven_attempt INTEGER NOT NULL DEFAULT 0
                     CHECK (forgiven_attempt BETWEEN 0 AND attempt),
    not_before_ms    INTEGER DEFAULT 0,
    lease_owner      TEXT    REFERENCES worker (id),
    leased_ms        INTEGER,
    lease_expires_ms INTEGER,
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
    CHECK (state <> 'quarantined' OR (last_error IS NOT NULL AND charged_attempts > 0))
) STRICT;

-- What a claim walks: only rows that wait, so that its cost does not grow with
-- the campaign. Likewise what falls due, and what expires.
CREATE INDEX job_queued ON job (campaign_id, task, unit_order) WHERE state = 'queued';
CREATE INDEX job_backed_off ON job (not_before_ms) WHERE state = 'queued' AND not_before_ms > 0;
CREATE INDEX job_leased ON job (lease_expires_ms) WHERE state = 'leased';
CREATE INDEX job_held ON job (campaign_id, task, lease_owner) WHERE state = 'leased';
CREATE INDEX job_quarantined ON job (campaign_id, rollout_id, replicate)
    WHERE state = 'quarantined';
-- What a commit walks to find its configuration's siblings.
CREATE INDEX job_siblings ON job (campaign_id, task, init_id) WHERE state = 'committed';

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

-- Where results came from, as far as many of them share it.
CREATE TABLE provenance (
    id               INTEGER PRIMARY KEY,
    host             TEXT    NOT NULL,
    gl_renderer      TEXT    NOT NULL,
    mujoco_version   TEXT    NOT NULL,
    asset_pack       TEXT    NOT NULL,
    asset_pack_digest TEXT   NOT NULL,
    realisation      TEXT    NOT NULL CHECK (realisation IN ('matched', 'reference')),
    policy_name      TEXT    NOT NULL,
    policy_checkpoint TEXT   NOT NULL,
    policy_checkpoint_digest TEXT NOT NULL,
    policy_privileged INTEGER NOT NULL CHECK (policy_privileged IN (0, 1)),
    policy_canonical_only INTEGER NOT NULL CHECK (policy_canonical_only IN (0, 1)),
    batch_mode       TEXT    NOT NULL,
    program_version  TEXT    NOT NULL,
    UNIQUE (host, gl_renderer, mujoco_version, asset_pack, asset_pack_digest,
            realisation, policy_name, policy_checkpoint, policy_checkpoint_digest,
            policy_privileged, policy_canonical_only, batch_mode, program_version)
) STRICT;

-- The committed outcome of a job: one, for ever.
CREATE TABLE result (
    job_id           INTEGER PRIMARY KEY REFERENCES job (id) ON DELETE CASCADE,
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
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
    -- The perturbation as realised, axis by axis: `camera:HEX,sensor:HEX`,
    -- SHA-256 each, and the empty text for a nominal rollout. One digest over
    -- all axes could not show that an axis alone and the same axis in a
    -- combination were realised identically.
    perturbation_digests TEXT NOT NULL CHECK
                     (perturbation_digests = '' OR (perturbation_digests GLOB '[a-z]*:[0-9a-f]*'
                         AND perturbation_digests NOT GLOB '*[^0-9a-z:,]*')),
    first_frame_digest TEXT  NOT NULL CHECK (length(first_frame_digest) IN (0, 64))
) STRICT;

CREATE INDEX result_by_time ON result (campaign_id, committed_ms, success);

-- A job is committed exactly when its result is stored: the result goes first,
-- in the same transaction.
CREATE TRIGGER job_committed_has_a_result
BEFORE UPDATE OF state ON job
WHEN NEW.state = 'committed' AND NOT EXISTS
    (SELECT 1 FROM result WHERE job_id = NEW.id AND attempt = NEW.attempt)
BEGIN
    SELECT RAISE (ABORT, 'job_committed_has_a_result');
END;

CREATE TRIGGER result_is_of_the_held_lease
BEFORE INSERT ON result
WHEN NOT EXISTS (SELECT 1 FROM job WHERE id = NEW.job_id AND state = 'leased'
    AND lease_owner = NEW.worker_id AND attempt = NEW.attempt)
BEGIN
    SELECT RAISE (ABORT, 'result_is_of_the_held_lease');
END;

-- How the robot of a committed rollout moved: where its end-effector was (x, y,
-- z, tenths of a millimetre, 16 bits each), and what it was told, if that is
-- kept (seven 32-bit floats a control step).
CREATE TABLE motion (
    job_id           INTEGER PRIMARY KEY REFERENCES job (id) ON DELETE CASCADE,
    path             BLOB    NOT NULL CHECK (length(path) % 6 = 0),
    actions          BLOB    NOT NULL CHECK (length(actions) % 28 = 0)
) STRICT;

-- A committed rollout that was reported again with another outcome: for a
-- deterministic policy a finding, so it is kept.
CREATE TABLE divergence (
    id               INTEGER PRIMARY KEY,
    job_id           INTEGER NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    attempt          INTEGER NOT NULL CHECK (attempt > 0),
    worker_id        TEXT    NOT NULL,
    reported_ms      INTEGER NOT NULL,
    success          INTEGER NOT NULL CHECK (success IN (0, 1)),
    steps            INTEGER NOT NULL CHECK (steps >= 0),
    wall_secs        REAL    NOT NULL CHECK (wall_secs >= 0),
    provenance_id    INTEGER NOT NULL REFERENCES provenance (id),
    UNIQUE (job_id, attempt, worker_id, success, steps)
) STRICT;

-- How every attempt that brought no result ended: at most once each.
CREATE TABLE failure (
    job_id           INTEGER NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    attempt          INTEGER NOT NULL CHECK (attempt > 0),
    worker_id        TEXT    NOT NULL,
    failed_ms        INTEGER NOT NULL,
    reason           TEXT    NOT NULL CHECK (reason IN
                     ('simulator_error', 'slot_crashed', 'slot_stuck', 'policy_misbehaved',
                      'lease_lost', 'unpaired', 'policy_unavailable', 'draining',
                      'cancelled')),
    charged          INTEGER NOT NULL CHECK (charged IN (0, 1)),
    error            TEXT    NOT NULL,
    PRIMARY KEY (job_id, attempt),
    CHECK (charged = (reason NOT IN ('policy_unavailable', 'draining', 'cancelled')))
) STRICT, WITHOUT ROWID;

-- Files kept beside a rollout, by kind; the path is below the data folder.
CREATE TABLE artifact (
    job_id           INTEGER NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    kind             TEXT    NOT NULL CHECK (kind IN ('video')),
    attempt          INTEGER NOT NULL CHECK (attempt > 0),
    path             TEXT    NOT NULL CHECK (path <> ''),
    size_bytes       INTEGER NOT NULL CHECK (size_bytes >= 0),
    stored_ms        INTEGER NOT NULL,
    PRIMARY KEY (job_id, kind)
) STRICT, WITHOUT ROWID;
