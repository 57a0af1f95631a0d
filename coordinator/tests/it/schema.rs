//! The database schema itself refuses states that the state enums cannot express.

use crate::harness::{Bench, small_spec};

const INVALID_STATEMENTS: &[(&str, &str)] = &[
    ("UPDATE job SET state = 'lost' WHERE state = 'queued'", "CHECK"),
    ("UPDATE job SET state = 'queued' WHERE state = 'leased'", "CHECK"),
    ("UPDATE job SET lease_owner = 'a' WHERE state = 'queued'", "CHECK"),
    ("UPDATE job SET lease_owner = NULL WHERE state = 'leased'", "CHECK"),
    ("UPDATE job SET lease_expires_ms = NULL WHERE state = 'leased'", "CHECK"),
    ("UPDATE job SET attempt_id = NULL WHERE state = 'leased'", "CHECK"),
    ("UPDATE job SET attempt_id = 'short' WHERE state = 'leased'", "CHECK"),
    ("UPDATE job SET claim_id = 'a' WHERE state = 'queued'", "CHECK"),
    (
        "INSERT INTO artifact VALUES (hex(zeroblob(16)), 'video', 'of no outcome', 1, 1)",
        "FOREIGN KEY",
    ),
    ("UPDATE job SET not_before_ms = NULL WHERE state = 'queued'", "CHECK"),
    ("UPDATE job SET charged_attempts = attempt + 1", "CHECK"),
    ("UPDATE job SET attempt = attempt - 1 WHERE attempt > 0", "only_rises"),
    (
        "UPDATE job SET state = 'queued', not_before_ms = 0 WHERE state = 'committed'",
        "job_committed_is_final",
    ),
    (
        "UPDATE job SET state = 'committed', attempt_id = NULL, claim_id = NULL,
             acknowledged = NULL, ceiling_ms = NULL, lease_owner = NULL, leased_ms = NULL,
             lease_expires_ms = NULL, control_steps = NULL WHERE state = 'leased'",
        "job_committed_has_a_result",
    ),
    ("UPDATE job SET state = 'quarantined', not_before_ms = NULL WHERE state = 'queued'", "CHECK"),
    (
        "INSERT INTO job (campaign_id, rollout_id, replicate, task, init_id, unit_order,
             manifest_row, policy_seed)
         SELECT campaign_id, rollout_id, replicate, task, init_id, unit_order,
             manifest_row, policy_seed FROM job LIMIT 1",
        "UNIQUE",
    ),
    ("UPDATE policy SET state = 'paused'", "CHECK"),
    ("UPDATE policy SET resume_ms = 5", "CHECK"),
    ("UPDATE policy SET probe_attempt_id = '1'", "CHECK"),
    ("UPDATE campaign SET mujoco_version = NULL", "CHECK"),
    ("UPDATE campaign SET renderer = NULL", "CHECK"),
    ("UPDATE provenance SET origin = json_remove(origin, '$.fingerprint')", "NOT NULL"),
    ("UPDATE provenance SET origin = 'x'", "malformed JSON"),
    ("UPDATE result SET outcome = json_remove(outcome, '$.wall_secs')", "NOT NULL"),
    ("UPDATE result SET outcome = json_set(outcome, '$.success', 'no')", "INTEGER"),
    ("UPDATE result SET outcome = json_set(outcome, '$.steps', -1)", "CHECK"),
    ("UPDATE result SET outcome = '[]'", "NOT NULL"),
    ("UPDATE result SET success = 0", "generated column"),
    ("UPDATE worker SET cores = 0", "CHECK"),
    ("UPDATE worker SET machine = ''", "CHECK"),
    ("UPDATE job SET losses = -1", "CHECK"),
    ("UPDATE job SET state = 'quarantined', not_before_ms = NULL WHERE attempt = 0", "CHECK"),
    (
        "INSERT INTO failure VALUES (hex(zeroblob(16)), 1, 1, 'a', 0, 'draining', 1, 'charged',
             NULL, NULL)",
        "CHECK",
    ),
    (
        "INSERT INTO result (job_id, campaign_id, attempt_id, attempt, worker_id, committed_ms,
             provenance_id, outcome)
         SELECT j.id, r.campaign_id, hex(zeroblob(16)), 1, r.worker_id, r.committed_ms,
             r.provenance_id, r.outcome
         FROM result r JOIN job j ON j.state = 'queued' LIMIT 1",
        "result_is_of_the_held_lease",
    ),
];

#[tokio::test]
async fn rows_that_no_state_describes_cannot_be_stored() {
    let bench = Bench::with(&small_spec("strict")).await;
    let (mut worker, lease) = bench.worker_with_lease("a").await;
    worker.commit(&lease, true).await;
    worker.claim_one().await;
    let pool = bench.database().await;
    for (statement, refusal) in INVALID_STATEMENTS.iter().copied() {
        let error = sqlx::query(statement).execute(&pool).await.expect_err(statement);
        assert!(error.to_string().contains(refusal), "{statement}: {error}");
    }
    pool.close().await;
}
