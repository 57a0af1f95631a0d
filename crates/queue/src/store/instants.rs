//! The newest instant of a database, with which a coordinator's clock begins at the earliest.
//!
//! The clock of a running coordinator never goes back, but the next coordinator may start while the
//! machine's clock is earlier than stored instants. With such a clock, a policy that is recorded as
//! available since a future instant would ignore outages until then, and a worker that has gone
//! would count as alive.

use sqlx::SqliteConnection;

use super::{Doing, StoreError};
use crate::clock::UnixMillis;

/// Returns the newest instant at which something was stored; the epoch if nothing was.
pub(crate) async fn newest(tx: &mut SqliteConnection) -> Result<UnixMillis, StoreError> {
    sqlx::query_scalar(
        "SELECT coalesce(max(at), 0) FROM (
             SELECT max(max(created_ms, state_since_ms, coalesce(pinned_ms, 0))) AS at FROM campaign
             UNION ALL SELECT max(stopped_ms) FROM stop
             UNION ALL SELECT max(available_ms) FROM policy
             UNION ALL SELECT max(max(registered_ms, last_seen_ms, coalesce(heartbeat_ms, 0),
                 coalesce(signed_off_ms, 0))) FROM worker
             UNION ALL SELECT max(leased_ms) FROM job WHERE state = 'leased'
             UNION ALL SELECT max(max(failed_ms, coalesce(leased_ms, 0))) FROM failure
             UNION ALL SELECT max((SELECT max(committed_ms) FROM result
                 WHERE campaign_id = c.id)) FROM campaign c
             UNION ALL SELECT max(reported_ms) FROM divergence
             UNION ALL SELECT max(stored_ms) FROM artifact)",
    )
    .fetch_one(tx)
    .await
    .doing("find the newest stored instant")
}
