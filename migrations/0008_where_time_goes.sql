-- Results say where their time went, and workers how many cores their slots share, so
-- that it can be told how long a campaign takes and what it waits for. Results and
-- workers of before do not.

-- Processor time of the slot: loading, settling and control steps.
ALTER TABLE result ADD COLUMN physics_secs REAL CHECK (physics_secs >= 0);
-- Processor time of drawing what the policy looks at.
ALTER TABLE result ADD COLUMN drawing_secs REAL
    CHECK (drawing_secs >= 0 AND (drawing_secs IS NULL) = (physics_secs IS NULL));
-- From asking the policy to its answer, by the clock.
ALTER TABLE result ADD COLUMN policy_secs REAL
    CHECK (policy_secs >= 0 AND (policy_secs IS NULL) = (physics_secs IS NULL));

ALTER TABLE worker ADD COLUMN cores INTEGER CHECK (cores > 0);
