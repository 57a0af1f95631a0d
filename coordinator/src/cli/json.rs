//! Output of `--json`. The schema is documented in docs/JSON.md, and a test compares the two.
//! Fields may be added but never changed or removed. Absent values are `null`; every key is always
//! present.

use proto::coordinator as wire;
use queue::clock::{UnixMillis, rfc3339};
use serde::Serialize;

use super::command::{CommandError, failure, print_line};

/// Declares structs of the output with their conversions from messages, so that each key is written
/// once.
macro_rules! forms {
    ($($name:ident from $value:ident: $from:ty {
        $($key:ident: $type:ty = $expression:expr,)*
    })*) => {$(
        #[derive(Serialize)]
        pub(super) struct $name {
            $($key: $type,)*
        }

        impl $name {
            pub(super) fn from_message($value: &$from) -> $name {
                $name { $($key: $expression,)* }
            }
        }
    )*};
}
pub(super) use forms;

/// Output of `workers`.
#[derive(Serialize)]
pub(super) struct Workers {
    workers: Vec<Worker>,
}

forms! {
    Worker from worker: wire::WorkerStatus {
        worker_id: String = worker.worker_id.clone(),
        host: String = worker.host.clone(),
        slots: u32 = worker.slots,
        leases: u32 = worker.leases,
        asset_pack: String = worker.asset_pack.clone(),
        mujoco_version: String = worker.mujoco_version.clone(),
        renderer: String = worker.renderer.clone(),
        look: String = worker.look.clone(),
        program_version: String = worker.program_version.clone(),
        is_alive: bool = worker.alive,
        has_signed_off: bool = worker.signed_off,
        failures_in_a_row: u32 = worker.charged_in_a_row,
        stopped_reason: Option<String> = non_empty(&worker.stopped_reason),
        registered_at: String = instant(worker.registered_unix_ms),
        last_call_at: String = instant(worker.last_seen_unix_ms),
    }
}

/// Prints an answer as indented JSON.
pub(super) fn print(answer: &impl Serialize) -> Result<(), CommandError> {
    let text = serde_json::to_string_pretty(answer).map_err(failure)?;
    Ok(print_line(&text)?)
}

fn non_empty(text: &str) -> Option<String> {
    (!text.is_empty()).then(|| text.to_owned())
}

fn instant(unix_ms: i64) -> String {
    rfc3339::text(UnixMillis(unix_ms))
}

impl Workers {
    pub(super) fn from_messages<'a>(
        workers: impl Iterator<Item = &'a wire::WorkerStatus>,
    ) -> Workers {
        Workers { workers: workers.map(Worker::from_message).collect() }
    }
}
