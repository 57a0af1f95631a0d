-- Campaigns that come or go piece by piece. Nobody sees them; one that was on its way when the
-- coordinator ended is deleted at the next start.
CREATE TABLE passage (
    campaign_id      INTEGER PRIMARY KEY REFERENCES campaign (id) ON DELETE CASCADE
) STRICT;
