BEGIN TRANSACTION;
CREATE TABLE _sqlx_migrations (
    version BIGINT PRIMARY KEY,
    description TEXT NOT NULL,
    installed_on TIMESTAMP NOT NULL DEFAULT CURRENT_TIMESTAMP,
    success BOOLEAN NOT NULL,
    checksum BLOB NOT NULL,
    execution_time BIGINT NOT NULL
);
INSERT INTO "_sqlx_migrations" VALUES(1,'campaigns jobs results','2026-11-22 05:18:35',1,X'254675400C5715F056E39F2A1B69A5C9A48A52A67C04BCDEF58405F8C90FEF0405DAE49C00D6EFCAA8647424DF164839',11462882);
INSERT INTO "_sqlx_migrations" VALUES(2,'renderer and fingerprint','2026-11-22 05:18:35',1,X'79A51B05C763B53F0D916297311D61E0A95B4E95F3325F4F50652302CF1C1C6B55F0B0D84F5B90B4C802D18D57091014',12025816);
INSERT INTO "_sqlx_migrations" VALUES(3,'attempts','2026-11-22 11:30:00',1,X'7F069D49CF72DAC78E2D03368352B4DB89899476BE3BB8301830828139BADBFBD1E2E6574E382CB7808F1D92476EBDDA',20000000);
INSERT INTO "_sqlx_migrations" VALUES(4,'policy settings','2026-11-22 18:57:00',1,X'A51CA9EC9873F75BB788EA89F35B565F323651BF25C29EF88A82C56057FEBA3E0B149F6282FF4FD2EEEDFC9478757410',20000000);
INSERT INTO "_sqlx_migrations" VALUES(5,'explanations','2026-11-23 02:02:33',1,X'AEC78F42E023C36B0335137FFAE37266B1717D763AA9C9DA42F1FF908D5DC62A950AFA144FEEC70112A0BC3033E73690',20000000);
INSERT INTO "_sqlx_migrations" VALUES(6,'derived campaigns','2026-11-23 05:30:00',1,X'01726A5510C30AD23B91929DBC7CEFE6F7C62167D3533B6AD4FCD7FD305C286E147F5CA73533866CF1B5F6086E0AC3D7',20000000);
INSERT INTO "_sqlx_migrations" VALUES(7,'stops and where time goes','2026-11-23 21:54:41',1,X'279A29DC272587ED1C2000D156BCA59890F4C370D0C50AF2E7481850A3E93B1BC67AB932FFB87589FBBD75694FB727B6',35216907);
INSERT INTO "_sqlx_migrations" VALUES(8,'blame','2026-11-24 20:10:00',1,X'B458D58B2742C663021854BB61847194BAC6A5F755F47D29A3C05A9D791A91A4B862100164E1D13D22700D0A24F1A7BE',20000000);
INSERT INTO "_sqlx_migrations" VALUES(9,'tallies','2026-11-25 02:30:00',1,X'F34B8AC3794DD172984065D550D14A4FADC97E694FF84D0F5BD9447366F820AF9D083758D43252AF68E83F29C4730EAB',20000000);
INSERT INTO "_sqlx_migrations" VALUES(10,'goal progress','2026-11-25 02:30:00',1,X'8B179D88FF8A2DB1DB8020091A7C1602B1E423AE701AFBA11809CC2EF6592B92F6DB9970056D9E87B5B370B3F456A5C0',20000000);
INSERT INTO "_sqlx_migrations" VALUES(11,'passages','2026-11-24 05:18:35',1,X'EA81D5DDABD0D19F8192766CAB32CD0B520337F282B329D64B0C004FEF6F7CAC12956B46856AF61C41960CB07F4C7593',1482883);
INSERT INTO "_sqlx_migrations" VALUES(12,'execution','2026-11-25 05:18:35',1,X'A2EB98A2ABEF6E8186EB2A822CD554D45C8052A15BDD9F5D8C4AC7F8CD0994864112AAA249E96AF01152B9F99786B1D0',1482883);
CREATE TABLE artifact (
    attempt_id       TEXT    NOT NULL REFERENCES result (attempt_id) ON DELETE CASCADE,
    kind             TEXT    NOT NULL CHECK (kind IN ('video')),
    path             TEXT    NOT NULL CHECK (path <> ''),
    size_bytes       INTEGER NOT NULL CHECK (size_bytes >= 0),
    stored_ms        INTEGER NOT NULL,
    PRIMARY KEY (attempt_id, kind)
) STRICT, WITHOUT ROWID;
INSERT INTO "artifact" VALUES('f2430c909b93f20b6d2b3904fb73d7db','video','artifacts/running/object_t0_clean_i16.r0.mp4',4,1795324715182);
CREATE TABLE campaign (
    id               INTEGER PRIMARY KEY AUTOINCREMENT,
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
    mujoco_version   TEXT, renderer TEXT
    CHECK (renderer IS NULL OR (renderer <> '' AND pinned_ms IS NOT NULL)), wanted TEXT NOT NULL DEFAULT '{}'
    CHECK (json_type(wanted) = 'object'), priority INTEGER NOT NULL DEFAULT 0
    CHECK (priority BETWEEN -100 AND 100), folder TEXT CHECK (folder <> ''), execution TEXT NOT NULL DEFAULT 'wait',
    CHECK ((pinned_ms IS NULL) = (asset_pack IS NULL)),
    CHECK ((pinned_ms IS NULL) = (asset_pack_digest IS NULL)),
    CHECK ((pinned_ms IS NULL) = (mujoco_version IS NULL))
) STRICT;
INSERT INTO "campaign" VALUES(1,'running','{"name":"running","policy":{"name":"expert","endpoint":"http://127.0.0.1:50051"},"tasks":["libero_object/0"],"axes":["camera","sensor"],"levels":["L1"],"configs":[0],"nominal":"eval","realisation":"matched","replicates":2,"record":"transitions"}','0044bbeff66f65ce66d6da8a9674c24ac192850ce4664a041ec5c2b4e33adfc0',1,'matched','transitions',8,1795324715155,'running',1795324715155,1795324715160,'primitives','5451adc8e90babce15e6a7b19520358e71246de78013e77a5feebcd844133ed2','3.3.7','llvmpipe','{}',0,NULL,'wait');
INSERT INTO "campaign" VALUES(2,'down','{"name":"down","policy":{"name":"flaky","endpoint":"http://127.0.0.1:50051"},"tasks":["libero_object/0"],"axes":["camera","sensor"],"levels":["L1"],"configs":[0],"nominal":"eval","realisation":"matched","replicates":1,"record":"none"}','b8e9fc68a28f7b834b571682168ea1f797c2f69f7c733d327a99c066687aad61',2,'matched','none',4,1795324715200,'running',1795324715200,1795324715204,'primitives','5451adc8e90babce15e6a7b19520358e71246de78013e77a5feebcd844133ed2','3.3.7','llvmpipe','{}',0,NULL,'wait');
INSERT INTO "campaign" VALUES(3,'over','{"name":"over","policy":{"name":"expert","endpoint":"http://127.0.0.1:50051"},"tasks":["libero_object/0"],"axes":["camera","sensor"],"levels":["L1"],"configs":[0],"nominal":"eval","realisation":"matched","replicates":1,"record":"none"}','9f74f10bf223d9c121333ae022d60ce3185b5705d668945c7ed20a19f666c35d',1,'matched','none',4,1795324715212,'cancelled',1795324715215,NULL,NULL,NULL,NULL,NULL,'{}',0,NULL,'wait');
INSERT INTO "campaign" VALUES(4,'running-explained','{"name":"running-explained","policy":{"name":"expert","endpoint":"http://127.0.0.1:50051"},"explains":{"campaign":"running","seed":0,"exhaustive":false},"realisation":"matched","replicates":1,"record":"none"}','9aaa748252799e0f188b7c3fba93b8e95113f0f6f659411b460231a75fce6a48',1,'matched','none',0,1795324715155,'running',1795324715155,NULL,NULL,NULL,NULL,NULL,'{}',0,NULL,'wait');
CREATE TABLE campaign_task (
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    task             TEXT    NOT NULL CHECK (task LIKE '%/%'),
    PRIMARY KEY (campaign_id, task)
) STRICT, WITHOUT ROWID;
INSERT INTO "campaign_task" VALUES(1,'libero_object/0');
INSERT INTO "campaign_task" VALUES(2,'libero_object/0');
INSERT INTO "campaign_task" VALUES(3,'libero_object/0');
CREATE TABLE derivation (
    campaign_id      INTEGER PRIMARY KEY REFERENCES campaign (id) ON DELETE CASCADE,
    -- Stays as long as something follows from it.
    source_id        INTEGER NOT NULL REFERENCES campaign (id),
    CHECK (campaign_id <> source_id)
) STRICT;
INSERT INTO "derivation" VALUES(4,1);
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
INSERT INTO "divergence" VALUES(1,2,1,'a',1795324715174,1,120,1.5,1);
CREATE TABLE ending_tally (
    reason           TEXT    PRIMARY KEY,
    attempts         INTEGER NOT NULL CHECK (attempts >= 0)
) STRICT, WITHOUT ROWID;
INSERT INTO "ending_tally" VALUES('draining',10);
INSERT INTO "ending_tally" VALUES('policy_unavailable',1);
INSERT INTO "ending_tally" VALUES('simulator_error',2);
INSERT INTO "ending_tally" VALUES('slot_crashed',1);
CREATE TABLE failure (
    attempt_id       TEXT    PRIMARY KEY CHECK (length(attempt_id) = 32),
    job_id           INTEGER NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    attempt          INTEGER NOT NULL CHECK (attempt > 0),
    worker_id        TEXT    NOT NULL,
    failed_ms        INTEGER NOT NULL,
    reason           TEXT    NOT NULL CHECK (reason IN
                     ('simulator_error', 'machine_error', 'slot_crashed', 'slot_stuck',
                      'policy_misbehaved', 'lease_lost', 'overdue', 'unpaired',
                      'policy_unavailable', 'draining', 'cancelled', 'unsuited',
                      'never_acknowledged', 'worker_silent', 'policy_lost', 'takes_policy_down', 'takes_worker_down', 'skipped')),
    charged          INTEGER NOT NULL CHECK (charged IN (0, 1)),
    error            TEXT    NOT NULL, leased_ms INTEGER, ceiling_ms INTEGER
    CHECK ((ceiling_ms IS NULL) = (leased_ms IS NULL)),
    UNIQUE (job_id, attempt),
    CHECK (charged = (reason NOT IN
        ('policy_unavailable', 'draining', 'cancelled', 'unsuited', 'never_acknowledged', 'worker_silent', 'policy_lost', 'takes_policy_down', 'takes_worker_down', 'skipped')))
) STRICT, WITHOUT ROWID;
INSERT INTO "failure" VALUES('0bbf8b8ace2dbe403ded30fd257d99b9',5,1,'a',1795324715160,'draining',0,'the coordinator was upgraded',NULL,NULL);
INSERT INTO "failure" VALUES('12dc55fb8a185c9a152cba651ac58c86',3,2,'c',1795324716227,'simulator_error',1,'diverged',NULL,NULL);
INSERT INTO "failure" VALUES('307389be83fdefd4a29aab855392b4af',11,1,'b',1795324715204,'draining',0,'the coordinator was upgraded',NULL,NULL);
INSERT INTO "failure" VALUES('36dd5bdff12ddd914160488b762ae19e',7,1,'b',1795324715204,'draining',0,'the coordinator was upgraded',NULL,NULL);
INSERT INTO "failure" VALUES('4d12f38e6ea63057377fb9e64a215629',9,1,'b',1795324715208,'policy_unavailable',0,'connection refused',NULL,NULL);
INSERT INTO "failure" VALUES('5c7d6e850a25b9179ee6a215a059e16f',6,1,'b',1795324715204,'draining',0,'the coordinator was upgraded',NULL,NULL);
INSERT INTO "failure" VALUES('7a621b551e138326304f1c9acc7f278a',8,1,'b',1795324715204,'draining',0,'the coordinator was upgraded',NULL,NULL);
INSERT INTO "failure" VALUES('878273a8c814c34dc95d11b4caadb23e',3,1,'a',1795324715189,'slot_crashed',1,'it crashed',NULL,NULL);
INSERT INTO "failure" VALUES('8eabe2791474bd4685f538b4979e609d',4,2,'b',1795324715204,'draining',0,'the coordinator was upgraded',NULL,NULL);
INSERT INTO "failure" VALUES('b6347a05907507b0241369e107270c8f',3,3,'e',1795324718258,'simulator_error',1,'diverged',NULL,NULL);
INSERT INTO "failure" VALUES('bb9c392be601047e5719cde2822caaaf',10,1,'b',1795324715204,'draining',0,'the coordinator was upgraded',NULL,NULL);
INSERT INTO "failure" VALUES('e2b83853c275a34af11e1f4170c2ee8c',9,2,'d',1795324717238,'draining',0,'not this one',NULL,NULL);
INSERT INTO "failure" VALUES('e489b163031f29043f645509bc4947b3',12,1,'b',1795324715204,'draining',0,'the coordinator was upgraded',NULL,NULL);
INSERT INTO "failure" VALUES('f89e685b66723dd7e6533ddae7f4bc31',4,1,'a',1795324715192,'draining',0,'it drained',NULL,NULL);
CREATE TABLE former_name (
    name             TEXT    PRIMARY KEY CHECK (name <> ''),
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
CREATE TABLE job (
    id               INTEGER PRIMARY KEY AUTOINCREMENT,
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
    stale_reports    INTEGER NOT NULL DEFAULT 0 CHECK (stale_reports >= 0), attempt_id TEXT
    CHECK ((state = 'leased') = (attempt_id IS NOT NULL) AND length(attempt_id) = 32), claim_id TEXT CHECK ((state = 'leased') = (claim_id IS NOT NULL)), acknowledged INTEGER
    CHECK ((state = 'leased') = (acknowledged IS NOT NULL) AND acknowledged IN (0, 1)), ceiling_ms INTEGER
    CHECK ((state = 'leased') = (ceiling_ms IS NOT NULL)), losses INTEGER NOT NULL DEFAULT 0 CHECK (losses >= 0),
    UNIQUE (campaign_id, rollout_id, replicate),
    FOREIGN KEY (campaign_id, task) REFERENCES campaign_task (campaign_id, task),
    CHECK ((state = 'queued') = (not_before_ms IS NOT NULL)),
    CHECK ((state = 'leased') = (lease_owner IS NOT NULL)),
    CHECK ((state = 'leased') = (leased_ms IS NOT NULL)),
    CHECK ((state = 'leased') = (lease_expires_ms IS NOT NULL)),
    CHECK ((state = 'leased') = (control_steps IS NOT NULL)),
    CHECK (state = 'queued' OR attempt > 0),
    CHECK (state <> 'quarantined' OR last_error IS NOT NULL)
) STRICT;
INSERT INTO "job" VALUES(1,1,'object/t0/clean/i16',0,'libero_object/0',16,0,'{"rollout_id":"object/t0/clean/i16","split":"clean","suite":"libero_object","task_id":0,"axis":"clean","level":"L0","config":null,"init_slot":16,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{}}',4279581102,'committed',1,0,0,NULL,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(2,1,'object/t0/camera/L1/c00',0,'libero_object/0',16,1,'{"rollout_id":"object/t0/camera/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"camera","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"d_azimuth_deg":0.063986,"d_distance_m":0.073102,"d_elevation_deg":0.80701,"d_lookat_x_m":-0.014915,"d_lookat_y_m":0.019136}}',2407598533,'committed',1,0,0,NULL,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(3,1,'object/t0/sensor/L1/c00',0,'libero_object/0',16,2,'{"rollout_id":"object/t0/sensor/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"sensor","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"blur_sigma":-0.12865,"jpeg_log2":0.634535,"motion_len":-0.8862,"noise_sigma":-0.000346}}',610897952,'quarantined',3,3,0,NULL,NULL,NULL,NULL,NULL,'diverged',0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(4,1,'object/t0/combination/L1/c00',0,'libero_object/0',16,3,'{"rollout_id":"object/t0/combination/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"combination","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"camera":{"d_azimuth_deg":0.063986,"d_distance_m":0.073102,"d_elevation_deg":0.80701,"d_lookat_x_m":-0.014915,"d_lookat_y_m":0.019136},"sensor":{"blur_sigma":-0.12865,"jpeg_log2":0.634535,"motion_len":-0.8862,"noise_sigma":-0.000346}}}',2351656207,'queued',2,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(5,1,'object/t0/clean/i16',1,'libero_object/0',16,4,'{"rollout_id":"object/t0/clean/i16","split":"clean","suite":"libero_object","task_id":0,"axis":"clean","level":"L0","config":null,"init_slot":16,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{}}',958538529,'queued',1,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(6,1,'object/t0/camera/L1/c00',1,'libero_object/0',16,5,'{"rollout_id":"object/t0/camera/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"camera","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"d_azimuth_deg":0.063986,"d_distance_m":0.073102,"d_elevation_deg":0.80701,"d_lookat_x_m":-0.014915,"d_lookat_y_m":0.019136}}',1434740286,'queued',1,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(7,1,'object/t0/sensor/L1/c00',1,'libero_object/0',16,6,'{"rollout_id":"object/t0/sensor/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"sensor","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"blur_sigma":-0.12865,"jpeg_log2":0.634535,"motion_len":-0.8862,"noise_sigma":-0.000346}}',4110364615,'queued',1,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(8,1,'object/t0/combination/L1/c00',1,'libero_object/0',16,7,'{"rollout_id":"object/t0/combination/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"combination","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"camera":{"d_azimuth_deg":0.063986,"d_distance_m":0.073102,"d_elevation_deg":0.80701,"d_lookat_x_m":-0.014915,"d_lookat_y_m":0.019136},"sensor":{"blur_sigma":-0.12865,"jpeg_log2":0.634535,"motion_len":-0.8862,"noise_sigma":-0.000346}}}',4264464894,'queued',1,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(9,2,'object/t0/clean/i16',0,'libero_object/0',16,0,'{"rollout_id":"object/t0/clean/i16","split":"clean","suite":"libero_object","task_id":0,"axis":"clean","level":"L0","config":null,"init_slot":16,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{}}',4279581102,'committed',3,0,0,NULL,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(10,2,'object/t0/camera/L1/c00',0,'libero_object/0',16,1,'{"rollout_id":"object/t0/camera/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"camera","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"d_azimuth_deg":0.063986,"d_distance_m":0.073102,"d_elevation_deg":0.80701,"d_lookat_x_m":-0.014915,"d_lookat_y_m":0.019136}}',2407598533,'queued',1,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(11,2,'object/t0/sensor/L1/c00',0,'libero_object/0',16,2,'{"rollout_id":"object/t0/sensor/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"sensor","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"blur_sigma":-0.12865,"jpeg_log2":0.634535,"motion_len":-0.8862,"noise_sigma":-0.000346}}',610897952,'queued',1,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(12,2,'object/t0/combination/L1/c00',0,'libero_object/0',16,3,'{"rollout_id":"object/t0/combination/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"combination","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"camera":{"d_azimuth_deg":0.063986,"d_distance_m":0.073102,"d_elevation_deg":0.80701,"d_lookat_x_m":-0.014915,"d_lookat_y_m":0.019136},"sensor":{"blur_sigma":-0.12865,"jpeg_log2":0.634535,"motion_len":-0.8862,"noise_sigma":-0.000346}}}',2351656207,'queued',1,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(13,3,'object/t0/clean/i16',0,'libero_object/0',16,0,'{"rollout_id":"object/t0/clean/i16","split":"clean","suite":"libero_object","task_id":0,"axis":"clean","level":"L0","config":null,"init_slot":16,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{}}',4279581102,'queued',0,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(14,3,'object/t0/camera/L1/c00',0,'libero_object/0',16,1,'{"rollout_id":"object/t0/camera/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"camera","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"d_azimuth_deg":0.063986,"d_distance_m":0.073102,"d_elevation_deg":0.80701,"d_lookat_x_m":-0.014915,"d_lookat_y_m":0.019136}}',2407598533,'queued',0,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(15,3,'object/t0/sensor/L1/c00',0,'libero_object/0',16,2,'{"rollout_id":"object/t0/sensor/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"sensor","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"blur_sigma":-0.12865,"jpeg_log2":0.634535,"motion_len":-0.8862,"noise_sigma":-0.000346}}',610897952,'queued',0,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
INSERT INTO "job" VALUES(16,3,'object/t0/combination/L1/c00',0,'libero_object/0',16,3,'{"rollout_id":"object/t0/combination/L1/c00","split":"eval","suite":"libero_object","task_id":0,"axis":"combination","level":"L1","config":0,"init_slot":0,"init_id":16,"language":"pick up the alphabet soup and place it in the basket","max_steps":280,"num_steps_wait":10,"policy_seed":0,"perturb":{"camera":{"d_azimuth_deg":0.063986,"d_distance_m":0.073102,"d_elevation_deg":0.80701,"d_lookat_x_m":-0.014915,"d_lookat_y_m":0.019136},"sensor":{"blur_sigma":-0.12865,"jpeg_log2":0.634535,"motion_len":-0.8862,"noise_sigma":-0.000346}}}',2351656207,'queued',0,0,0,0,NULL,NULL,NULL,NULL,NULL,0,NULL,NULL,NULL,NULL,0);
CREATE TABLE motion (
    job_id           INTEGER PRIMARY KEY REFERENCES job (id) ON DELETE CASCADE,
    path             BLOB    NOT NULL CHECK (length(path) % 6 = 0),
    actions          BLOB    NOT NULL CHECK (length(actions) % 28 = 0)
) STRICT;
INSERT INTO "motion" VALUES(1,X'010101010101',X'02020202020202020202020202020202020202020202020202020202');
INSERT INTO "motion" VALUES(2,X'010101010101',X'02020202020202020202020202020202020202020202020202020202');
INSERT INTO "motion" VALUES(9,X'010101010101',X'');
CREATE TABLE origin_tally (
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    provenance_id    INTEGER NOT NULL,
    results          INTEGER NOT NULL CHECK (results >= 0),
    PRIMARY KEY (campaign_id, provenance_id)
) STRICT, WITHOUT ROWID;
INSERT INTO "origin_tally" VALUES(1,1,2);
INSERT INTO "origin_tally" VALUES(2,2,1);
CREATE TABLE passage (
    campaign_id      INTEGER PRIMARY KEY REFERENCES campaign (id) ON DELETE CASCADE
) STRICT;
CREATE TABLE policy (
    id               INTEGER PRIMARY KEY,
    endpoint         TEXT    NOT NULL CHECK (endpoint <> ''),
    name             TEXT    NOT NULL CHECK (name <> ''),
    state            TEXT    NOT NULL DEFAULT 'available'
                     CHECK (state IN ('available', 'paused', 'probing')),
    -- Outages since the last committed rollout: what the back-off grows with.
    outages          INTEGER NOT NULL DEFAULT 0 CHECK (outages >= 0),
    -- Attempts in a row that it answered nonsense in.
    misbehaved       INTEGER NOT NULL DEFAULT 0 CHECK (misbehaved >= 0),
    -- Leases granted before this instant are no evidence of a new outage.
    available_ms     INTEGER NOT NULL,
    resume_ms        INTEGER,
    pause_reason     TEXT,
    probe_attempt_id TEXT,
    UNIQUE (endpoint, name),
    CHECK ((state = 'paused') = (resume_ms IS NOT NULL)),
    CHECK ((state = 'available') = (pause_reason IS NULL)),
    CHECK ((state = 'probing') = (probe_attempt_id IS NOT NULL)),
    CHECK (state = 'available' OR outages > 0)
) STRICT;
INSERT INTO "policy" VALUES(1,'http://127.0.0.1:50051','expert','available',0,0,1795324715155,NULL,NULL,NULL);
INSERT INTO "policy" VALUES(2,'http://127.0.0.1:50051','flaky','available',0,0,1795324718264,NULL,NULL,NULL);
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
INSERT INTO "provenance" VALUES(1,'bench','llvmpipe','e5e59d10f196504b6e08ac7785f84430a61e1558fd6246075a9566edaab2e814','3.3.7','primitives','5451adc8e90babce15e6a7b19520358e71246de78013e77a5feebcd844133ed2','matched','expert','none','',0,0,'{}','deterministic','0.1.0');
INSERT INTO "provenance" VALUES(2,'bench','llvmpipe','e5e59d10f196504b6e08ac7785f84430a61e1558fd6246075a9566edaab2e814','3.3.7','primitives','5451adc8e90babce15e6a7b19520358e71246de78013e77a5feebcd844133ed2','matched','flaky','none','',0,0,'{}','deterministic','0.1.0');
CREATE TABLE removal (
    folder           TEXT    PRIMARY KEY CHECK (folder <> '')
) STRICT, WITHOUT ROWID;
CREATE TABLE result (
    job_id           INTEGER PRIMARY KEY REFERENCES job (id) ON DELETE CASCADE,
    campaign_id      INTEGER NOT NULL REFERENCES campaign (id) ON DELETE CASCADE,
    attempt_id       TEXT    NOT NULL UNIQUE CHECK (length(attempt_id) = 32),
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
    first_frame_digest TEXT  NOT NULL CHECK (length(first_frame_digest) IN (0, 64)),
    -- The perturbation as realised, by axis: {"camera": {"parameters": [...],
    -- "elements": [...]}}. Results of schema 2 and before have the SHA-256 of
    -- the values instead: {"camera": "HEX"}.
    realised         TEXT    NOT NULL CHECK (json_type(realised) = 'object')
, physics_secs REAL CHECK (physics_secs >= 0), drawing_secs REAL
    CHECK (drawing_secs >= 0 AND (drawing_secs IS NULL) = (physics_secs IS NULL)), policy_secs REAL
    CHECK (policy_secs >= 0 AND (policy_secs IS NULL) = (physics_secs IS NULL)), goal_predicates INTEGER CHECK (goal_predicates > 0), goal_at_end INTEGER
    CHECK (goal_at_end BETWEEN 0 AND goal_predicates
        AND (goal_at_end = goal_predicates) = success
        AND (goal_at_end IS NULL) = (goal_predicates IS NULL)), goal_at_most INTEGER
    CHECK (goal_at_most BETWEEN goal_at_end AND goal_predicates
        AND (goal_at_most IS NULL) = (goal_predicates IS NULL))) STRICT;
INSERT INTO "result" VALUES(1,1,'f2430c909b93f20b6d2b3904fb73d7db',1,'a',1795324715168,1,120,1.5,NULL,NULL,NULL,0,30,1,'9298847788e0b770012aceaa199914c9509fdad64e8aedc8e3529e0aaa629b23','6746a4bc8fff91afd1326acc515ead4fd4960165e805c93c23987aed9e5769d1','','{}',NULL,NULL,NULL,NULL,NULL,NULL);
INSERT INTO "result" VALUES(2,1,'c3fd985398c4d59c1f9fb0391cdcb88d',1,'a',1795324715172,0,280,1.5,NULL,NULL,NULL,0,30,1,'9298847788e0b770012aceaa199914c9509fdad64e8aedc8e3529e0aaa629b23','6746a4bc8fff91afd1326acc515ead4fd4960165e805c93c23987aed9e5769d1','','{"camera":"79717aefec637a0267362bbd0d2227917806cc8f2c26bd1c7d634221f56c84bb"}',NULL,NULL,NULL,NULL,NULL,NULL);
INSERT INTO "result" VALUES(9,2,'b81d417ce3c794e169f8152f5d1b6543',3,'a',1795324718264,1,120,1.5,NULL,NULL,NULL,0,30,2,'9298847788e0b770012aceaa199914c9509fdad64e8aedc8e3529e0aaa629b23','6746a4bc8fff91afd1326acc515ead4fd4960165e805c93c23987aed9e5769d1','','{}',NULL,NULL,NULL,NULL,NULL,NULL);
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
INSERT INTO "tally" VALUES(1,5,0,2,1,1,0);
INSERT INTO "tally" VALUES(2,3,0,1,0,1,0);
INSERT INTO "tally" VALUES(3,4,0,0,0,0,0);
INSERT INTO "tally" VALUES(4,0,0,0,0,0,0);
CREATE TABLE worker (
    id               TEXT    PRIMARY KEY CHECK (id <> ''),
    host             TEXT    NOT NULL,
    slots            INTEGER NOT NULL CHECK (slots > 0),
    asset_pack       TEXT    NOT NULL,
    asset_pack_digest TEXT   NOT NULL,
    mujoco_version   TEXT    NOT NULL,
    renderer      TEXT    NOT NULL,
    program_version  TEXT    NOT NULL,
    registered_ms    INTEGER NOT NULL,
    last_seen_ms     INTEGER NOT NULL,
    charged_in_a_row INTEGER NOT NULL DEFAULT 0 CHECK (charged_in_a_row >= 0),
    -- Set when it may lease no more, in the words that it is told.
    stopped_reason   TEXT
, signed_off_ms INTEGER, cores INTEGER CHECK (cores > 0), machine TEXT CHECK (machine <> ''), heartbeat_ms INTEGER) STRICT;
INSERT INTO "worker" VALUES('a','bench',2,'primitives','5451adc8e90babce15e6a7b19520358e71246de78013e77a5feebcd844133ed2','3.3.7','llvmpipe','0.1.0',1795324718261,1795324718264,0,NULL,NULL,NULL,NULL,NULL);
INSERT INTO "worker" VALUES('b','bench',2,'primitives','5451adc8e90babce15e6a7b19520358e71246de78013e77a5feebcd844133ed2','3.3.7','llvmpipe','0.1.0',1795324718243,1795324718243,0,NULL,NULL,NULL,NULL,NULL);
INSERT INTO "worker" VALUES('c','bench',2,'primitives','5451adc8e90babce15e6a7b19520358e71246de78013e77a5feebcd844133ed2','3.3.7','llvmpipe','0.1.0',1795324718244,1795324718244,0,NULL,NULL,NULL,NULL,NULL);
INSERT INTO "worker" VALUES('d','bench',2,'primitives','5451adc8e90babce15e6a7b19520358e71246de78013e77a5feebcd844133ed2','3.3.7','llvmpipe','0.1.0',1795324718247,1795324718247,0,NULL,NULL,NULL,NULL,NULL);
INSERT INTO "worker" VALUES('e','bench',2,'primitives','5451adc8e90babce15e6a7b19520358e71246de78013e77a5feebcd844133ed2','3.3.7','llvmpipe','0.1.0',1795324718250,1795324718258,1,NULL,NULL,NULL,NULL,NULL);
INSERT INTO "worker" VALUES('f','bench',2,'primitives','5451adc8e90babce15e6a7b19520358e71246de78013e77a5feebcd844133ed2','3.3.7','llvmpipe','0.1.0',1795324718253,1795324718253,0,NULL,NULL,NULL,NULL,NULL);
CREATE INDEX campaign_by_policy ON campaign (policy_id);
CREATE TRIGGER campaign_cancelled_is_final
BEFORE UPDATE OF state ON campaign WHEN OLD.state = 'cancelled' AND NEW.state <> 'cancelled'
BEGIN
    SELECT RAISE (ABORT, 'campaign_cancelled_is_final');
END;
CREATE INDEX worker_seen ON worker (last_seen_ms);
CREATE INDEX job_queued ON job (campaign_id, task, unit_order) WHERE state = 'queued';
CREATE INDEX job_backed_off ON job (not_before_ms) WHERE state = 'queued' AND not_before_ms > 0;
CREATE INDEX job_leased ON job (lease_expires_ms) WHERE state = 'leased';
CREATE INDEX job_held ON job (campaign_id, task, lease_owner) WHERE state = 'leased';
CREATE INDEX job_quarantined ON job (campaign_id, rollout_id, replicate)
    WHERE state = 'quarantined';
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
CREATE TRIGGER job_committed_has_a_result
BEFORE UPDATE OF state ON job
WHEN NEW.state = 'committed' AND NOT EXISTS
    (SELECT 1 FROM result WHERE job_id = NEW.id AND attempt = NEW.attempt)
BEGIN
    SELECT RAISE (ABORT, 'job_committed_has_a_result');
END;
CREATE UNIQUE INDEX job_attempt ON job (attempt_id) WHERE state = 'leased';
CREATE INDEX job_claim ON job (claim_id) WHERE state = 'leased';
CREATE INDEX result_by_time ON result (campaign_id, committed_ms, success);
CREATE INDEX result_by_origin ON result (campaign_id, provenance_id);
CREATE TRIGGER result_is_of_the_held_lease
BEFORE INSERT ON result
WHEN NOT EXISTS (SELECT 1 FROM job WHERE id = NEW.job_id AND state = 'leased'
    AND lease_owner = NEW.worker_id AND attempt_id = NEW.attempt_id AND attempt = NEW.attempt)
BEGIN
    SELECT RAISE (ABORT, 'result_is_of_the_held_lease');
END;
CREATE UNIQUE INDEX campaign_folder ON campaign (coalesce(folder, name));
CREATE INDEX former_name_of ON former_name (campaign_id);
CREATE INDEX derivation_of ON derivation (source_id);
CREATE TRIGGER stop_ends_no_cancelled_campaign
BEFORE UPDATE ON stop
WHEN EXISTS (SELECT 1 FROM campaign WHERE id = NEW.campaign_id AND state = 'cancelled')
BEGIN
    SELECT RAISE (ABORT, 'stop_ends_no_cancelled_campaign');
END;
CREATE INDEX worker_of_machine ON worker (machine, registered_ms) WHERE machine IS NOT NULL;
CREATE INDEX job_alone ON job (campaign_id, unit_order) WHERE state = 'queued' AND losses >= 4;
CREATE INDEX failure_cut_off ON failure (job_id) WHERE ceiling_ms IS NOT NULL;
CREATE TRIGGER stop_is_final
BEFORE UPDATE ON stop
WHEN OLD.stopped_ms IS NOT NULL
    AND (NEW.campaign_id <> OLD.campaign_id OR NEW.configurations <> OLD.configurations
        OR NEW.used IS NOT OLD.used OR coalesce(NEW.stopped_ms > OLD.stopped_ms, TRUE))
BEGIN
    SELECT RAISE (ABORT, 'stop_is_final');
END;
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
CREATE INDEX artifact_path ON artifact (path);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('campaign',4);
INSERT INTO "sqlite_sequence" VALUES('job',16);
COMMIT;
