//! Correction of stored instants after the system clock was set back while no coordinator ran, or
//! after an import from a coordinator whose clock was ahead.
//!
//! The clock of a running coordinator never goes back, but the next coordinator may start earlier
//! than stored instants. Without the correction, a policy that is recorded as available since a
//! future instant would ignore outages until then, and a worker that has gone would count as alive.
//! Stored instants in the past need no correction, however far the clock jumped ahead.

use sqlx::SqliteConnection;

use super::{Doing, StoreError};
use crate::clock::UnixMillis;

/// Statements that move future instants back to the current one, `?1`. Back-offs and pauses end at
/// `?2`, the end of the longest possible wait, at the latest.
const SET_BACK: &[&str] = &[
    "UPDATE campaign SET created_ms = min(created_ms, ?1),
         state_since_ms = min(state_since_ms, ?1), pinned_ms = min(pinned_ms, ?1)
     WHERE created_ms > ?1 OR state_since_ms > ?1 OR pinned_ms > ?1",
    "UPDATE stop SET stopped_ms = ?1 WHERE stopped_ms > ?1",
    "UPDATE policy SET available_ms = ?1 WHERE available_ms > ?1",
    "UPDATE policy SET resume_ms = ?2 WHERE resume_ms > ?2",
    "UPDATE worker SET registered_ms = min(registered_ms, ?1),
         last_seen_ms = min(last_seen_ms, ?1), signed_off_ms = min(signed_off_ms, ?1),
         heartbeat_ms = min(heartbeat_ms, ?1)
     WHERE last_seen_ms > ?1 OR registered_ms > ?1 OR signed_off_ms > ?1 OR heartbeat_ms > ?1",
    // Keeps the duration from the attempt's start to its ceiling.
    "UPDATE job SET leased_ms = ?1, ceiling_ms = ?1 + ceiling_ms - leased_ms
     WHERE state = 'leased' AND leased_ms > ?1",
    "UPDATE job SET not_before_ms = ?2
     WHERE state = 'queued' AND not_before_ms > 0 AND not_before_ms > ?2",
    "UPDATE failure SET failed_ms = ?1 WHERE failed_ms > ?1",
    "UPDATE failure SET leased_ms = ?1, ceiling_ms = ?1 + ceiling_ms - leased_ms
     WHERE leased_ms > ?1",
    "UPDATE result SET committed_ms = ?1
     WHERE campaign_id IN (SELECT id FROM campaign) AND committed_ms > ?1",
    "UPDATE divergence SET reported_ms = ?1 WHERE reported_ms > ?1",
    "UPDATE artifact SET stored_ms = ?1 WHERE stored_ms > ?1",
];

/// Moves instants that lie after `now` back to `now`, and ends of back-offs and pauses that lie
/// after `latest` back to `latest`.
pub(crate) async fn set_back(
    tx: &mut SqliteConnection,
    now: UnixMillis,
    latest: UnixMillis,
) -> Result<(), StoreError> {
    for statement in SET_BACK.iter().copied() {
        sqlx::query(statement)
            .bind(now)
            .bind(latest)
            .execute(&mut *tx)
            .await
            .doing("correct instants that lie in the future")?;
    }
    Ok(())
}
