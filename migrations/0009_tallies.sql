-- Counts that pages, metrics, claims and derived campaigns ask for all the while. Triggers
-- keep them in the transaction that changes what is counted, so that reading one costs the
-- same in a campaign of any size; the invariant `tallies_are_true` counts again.

-- The jobs of a campaign by state, and its results that reached their goal.
CREATE TABLE tally (
    campaign_id      INTEGER PRIMARY KEY REFERENCES campaign (id) ON DELETE CASCADE,
    queued           INTEGER NOT NULL DEFAULT 0 CHECK (queued >= 0),
    leased           INTEGER NOT NULL DEFAULT 0 CHECK (leased >= 0),
    committed        INTEGER NOT NULL DEFAULT 0 CHECK (committed >= 0),
    quarantined      INTEGER NOT NULL DEFAULT 0 CHECK (quarantined >= 0),
    succeeded        INTEGER NOT NULL DEFAULT 0 CHECK (succeeded >= 0),
    -- Rises whenever a job is committed, enters quarantine or leaves it. Equal revisions of
    -- one campaign mean equal outcomes.
    revision         INTEGER NOT NULL DEFAULT 0 CHECK (revision >= 0)
) STRICT;

-- The results of a campaign by origin.
CREATE TABLE origin_tally (
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    provenance_id    INTEGER NOT NULL,
    results          INTEGER NOT NULL CHECK (results >= 0),
    PRIMARY KEY (campaign_id, provenance_id)
) STRICT, WITHOUT ROWID;

-- Attempts without a result by the way in which they ended.
CREATE TABLE ending_tally (
    reason           TEXT    PRIMARY KEY,
    attempts         INTEGER NOT NULL CHECK (attempts >= 0)
) STRICT, WITHOUT ROWID;

INSERT INTO tally (campaign_id, queued, leased, committed, quarantined, succeeded)
SELECT c.id, coalesce(j.queued, 0), coalesce(j.leased, 0), coalesce(j.committed, 0),
    coalesce(j.quarantined, 0),
    (SELECT count(*) FROM result r WHERE r.campaign_id = c.id AND r.success = 1)
FROM campaign c LEFT JOIN
    (SELECT campaign_id, sum(state = 'queued') AS queued, sum(state = 'leased') AS leased,
         sum(state = 'committed') AS committed, sum(state = 'quarantined') AS quarantined
     FROM job GROUP BY campaign_id) j ON j.campaign_id = c.id;

INSERT INTO origin_tally
SELECT campaign_id, provenance_id, count(*) FROM result GROUP BY campaign_id, provenance_id;

INSERT INTO ending_tally SELECT reason, count(*) FROM failure GROUP BY reason;

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

-- Films are looked up by their path while they are moved to where they are kept.
CREATE INDEX artifact_path ON artifact (path);
