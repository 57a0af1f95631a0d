-- A campaign that explains another: its jobs follow from the outcomes of both, and
-- what it is compared with are the other's results too.
CREATE TABLE explanation (
    campaign_id      INTEGER PRIMARY KEY REFERENCES campaign (id) ON DELETE CASCADE,
    -- Stays as long as it is explained.
    explained_id     INTEGER NOT NULL REFERENCES campaign (id),
    CHECK (campaign_id <> explained_id)
) STRICT;

CREATE INDEX explanation_of ON explanation (explained_id);
