-- A campaign may follow from another one in several ways, of which explaining it is one:
-- what they have in common is kept under a common name.

-- A campaign that follows from another, its source: its jobs follow from the outcomes of
-- both, and what it is compared with are the source's results too.
CREATE TABLE derivation (
    campaign_id      INTEGER PRIMARY KEY REFERENCES campaign (id) ON DELETE CASCADE,
    -- Stays as long as something follows from it.
    source_id        INTEGER NOT NULL REFERENCES campaign (id),
    CHECK (campaign_id <> source_id)
) STRICT;

INSERT INTO derivation (campaign_id, source_id) SELECT campaign_id, explained_id FROM explanation;

DROP TABLE explanation;

CREATE INDEX derivation_of ON derivation (source_id);
