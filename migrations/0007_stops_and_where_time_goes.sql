-- A campaign that may end early, as its specification says: its jobs are placed in a
-- drawn order of its configurations, and leased in that order.
CREATE TABLE stop (
    campaign_id      INTEGER PRIMARY KEY REFERENCES campaign (id) ON DELETE CASCADE,
    -- All of the campaign's.
    configurations   INTEGER NOT NULL CHECK (configurations > 0),
    -- After so many of them, in the drawn order, the rule was met: since then the
    -- campaign is stopped, whatever its operator made of it before.
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

-- Results say where their time went, and workers how many cores their slots share, so
-- that it can be told how long a campaign takes and what it waits for. Earlier ones do
-- not.

-- Processor time of the slot: loading, settling and control steps.
ALTER TABLE result ADD COLUMN physics_secs REAL CHECK (physics_secs >= 0);
-- Processor time of drawing what the policy looks at.
ALTER TABLE result ADD COLUMN drawing_secs REAL
    CHECK (drawing_secs >= 0 AND (drawing_secs IS NULL) = (physics_secs IS NULL));
-- From asking the policy to its answer, by the clock.
ALTER TABLE result ADD COLUMN policy_secs REAL
    CHECK (policy_secs >= 0 AND (policy_secs IS NULL) = (physics_secs IS NULL));

ALTER TABLE worker ADD COLUMN cores INTEGER CHECK (cores > 0);
