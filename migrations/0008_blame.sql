-- Whom a failure counts against: machines instead of worker processes, nobody for
-- what the network did or what a rollout does to its policy; and no number is ever
-- given twice.

-- Which machine a worker runs on; workers of earlier releases do not say.
ALTER TABLE worker ADD COLUMN machine TEXT CHECK (machine <> '');
-- When its last heartbeat came: a lease that a later one leaves out was forgotten by
-- its worker, a lease without a later one was cut off with it.
ALTER TABLE worker ADD COLUMN heartbeat_ms INTEGER;

CREATE INDEX worker_of_machine ON worker (machine, registered_ms) WHERE machine IS NOT NULL;

-- Attempts that lost their policy since the job was last taken out of quarantine.
ALTER TABLE job ADD COLUMN losses INTEGER NOT NULL DEFAULT 0 CHECK (losses >= 0);

-- Jobs that lost their policy so often that they are run alone only.
CREATE INDEX job_alone ON job (campaign_id, unit_order) WHERE state = 'queued' AND losses >= 4;

-- The lease that was cut off with its worker, for as long as that worker may still
-- bring the result: until its job is leased again, or its ceiling.
ALTER TABLE failure ADD COLUMN leased_ms INTEGER;
ALTER TABLE failure ADD COLUMN ceiling_ms INTEGER
    CHECK ((ceiling_ms IS NULL) = (leased_ms IS NULL));

CREATE INDEX failure_cut_off ON failure (job_id) WHERE ceiling_ms IS NOT NULL;

-- A clock that was set back moves an instant that lies ahead of it, and nothing else of
-- a campaign that has stopped.
DROP TRIGGER stop_is_final;

CREATE TRIGGER stop_is_final
BEFORE UPDATE ON stop
WHEN OLD.stopped_ms IS NOT NULL
    AND (NEW.campaign_id <> OLD.campaign_id OR NEW.configurations <> OLD.configurations
        OR NEW.used IS NOT OLD.used OR coalesce(NEW.stopped_ms > OLD.stopped_ms, TRUE))
BEGIN
    SELECT RAISE (ABORT, 'stop_is_final');
END;

-- SQLite alters no constraint of a table. What these become forbids nothing that is
-- stored and changes no row's form, so that their text is replaced where it stands
-- (https://www.sqlite.org/lang_altertable.html, section 7).
PRAGMA writable_schema = ON;

UPDATE sqlite_schema SET sql = replace(sql, '''never_acknowledged''',
    '''never_acknowledged'', ''worker_silent'', ''policy_lost'', ''takes_policy_down'', '
    || '''takes_worker_down'', ''skipped''')
WHERE type = 'table' AND name = 'failure';

-- Not every job in quarantine failed: one may have been skipped.
UPDATE sqlite_schema SET sql = replace(sql,
    '(last_error IS NOT NULL AND charged_attempts > 0)', 'last_error IS NOT NULL')
WHERE type = 'table' AND name = 'job';

UPDATE sqlite_schema SET sql = replace(sql, 'id               INTEGER PRIMARY KEY,',
    'id               INTEGER PRIMARY KEY AUTOINCREMENT,')
WHERE type = 'table' AND name IN ('campaign', 'job');

-- The first table of this kind brings `sqlite_sequence` with it.
CREATE TABLE numbered (id INTEGER PRIMARY KEY AUTOINCREMENT);
DROP TABLE numbered;

PRAGMA writable_schema = RESET;

INSERT INTO sqlite_sequence (name, seq)
SELECT 'campaign', coalesce(max(id), 0) FROM campaign
UNION ALL SELECT 'job', coalesce(max(id), 0) FROM job;
