-- The renderer pins a campaign as its assets and its simulator do, and a result
-- carries the fingerprint of the slot that it came from.

ALTER TABLE worker RENAME COLUMN gl_renderer TO renderer;

-- A campaign that schema 1 pinned has the renderer of the first result that a
-- frame was drawn for. Where there is none, the next lease decides.
ALTER TABLE campaign ADD COLUMN renderer TEXT
    CHECK (renderer IS NULL OR (renderer <> '' AND pinned_ms IS NOT NULL));

UPDATE campaign SET renderer =
    (SELECT p.gl_renderer FROM result r JOIN provenance p ON p.id = r.provenance_id
     WHERE r.campaign_id = campaign.id AND p.gl_renderer <> ''
     ORDER BY r.committed_ms, r.job_id LIMIT 1);

-- SQLite adds no column to a UNIQUE constraint: the table is made anew, under
-- the rows that refer to it.
PRAGMA defer_foreign_keys = ON;

CREATE TEMP TABLE former_provenance AS SELECT * FROM provenance;

DROP TABLE provenance;

-- Where results came from, as far as many of them share it.
CREATE TABLE provenance (
    id               INTEGER PRIMARY KEY,
    host             TEXT    NOT NULL,
    -- Empty in results of schema 1 for which no frame was drawn.
    renderer         TEXT    NOT NULL,
    -- Of a fixed motion and its frames: equal fingerprints mean equal bits.
    -- Empty in results of schema 1.
    fingerprint      TEXT    NOT NULL CHECK (length(fingerprint) IN (0, 64)),
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
    UNIQUE (host, renderer, fingerprint, mujoco_version, asset_pack, asset_pack_digest,
            realisation, policy_name, policy_checkpoint, policy_checkpoint_digest,
            policy_privileged, policy_canonical_only, batch_mode, program_version)
) STRICT;

INSERT INTO provenance (id, host, renderer, fingerprint, mujoco_version, asset_pack,
    asset_pack_digest, realisation, policy_name, policy_checkpoint, policy_checkpoint_digest,
    policy_privileged, policy_canonical_only, batch_mode, program_version)
SELECT id, host, gl_renderer, '', mujoco_version, asset_pack, asset_pack_digest, realisation,
    policy_name, policy_checkpoint, policy_checkpoint_digest, policy_privileged,
    policy_canonical_only, batch_mode, program_version
FROM former_provenance;

DROP TABLE former_provenance;

-- How many of a campaign's results share an origin, and so a fingerprint.
CREATE INDEX result_by_origin ON result (campaign_id, provenance_id);
