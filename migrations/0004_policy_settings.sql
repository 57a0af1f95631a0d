-- Results carry what their policy's server resolved, and a campaign keeps to it.
-- Results of schema 3 and before have none. (The comment in the table below stays
-- as it is: databases were made with it.)

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
    -- What the policy's server resolved: {"executed": "8", ...}. Empty in results
    -- of schema 2 and before.
    policy_settings  TEXT    NOT NULL DEFAULT '{}' CHECK (json_type(policy_settings) = 'object'),
    batch_mode       TEXT    NOT NULL,
    program_version  TEXT    NOT NULL,
    UNIQUE (host, renderer, fingerprint, mujoco_version, asset_pack, asset_pack_digest,
            realisation, policy_name, policy_checkpoint, policy_checkpoint_digest,
            policy_privileged, policy_canonical_only, policy_settings, batch_mode,
            program_version)
) STRICT;

INSERT INTO provenance (id, host, renderer, fingerprint, mujoco_version, asset_pack,
    asset_pack_digest, realisation, policy_name, policy_checkpoint, policy_checkpoint_digest,
    policy_privileged, policy_canonical_only, batch_mode, program_version)
SELECT * FROM former_provenance;

DROP TABLE former_provenance;
