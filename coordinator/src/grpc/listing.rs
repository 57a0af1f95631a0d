//! Conversion of workers to messages. Durations such as the age of a result are
//! computed here, since a client's clock may be wrong.

use proto::coordinator as wire;
use queue::clock::UnixMillis;
use queue::read::WorkerLine;

pub(super) fn worker(line: WorkerLine, now: UnixMillis) -> wire::WorkerStatus {
    wire::WorkerStatus {
        worker_id: line.id.0,
        host: line.host,
        slots: line.slots,
        leases: line.leases,
        asset_pack: line.asset_pack,
        mujoco_version: line.mujoco_version,
        renderer: line.renderer,
        look: line.look,
        program_version: line.program_version,
        silent_secs: now.since(line.last_seen_ms).as_secs_f64(),
        alive: line.is_alive,
        charged_in_a_row: line.charged_in_a_row,
        stopped_reason: line.stopped_reason.unwrap_or_default(),
        filming: line.filming,
        last_seen_unix_ms: line.last_seen_ms.0,
        registered_unix_ms: line.registered_ms.0,
        signed_off: line.has_signed_off,
    }
}
