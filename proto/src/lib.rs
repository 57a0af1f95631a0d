//! The wire protocols: [`policy`] between workers, gateways and policy servers,
//! [`coordinator`] between workers, operators and the coordinator. Generated
//! from the `.proto` files beside this crate, whose comments are the reference.

#![forbid(unsafe_code)]
#![allow(missing_docs, clippy::all, reason = "generated code")]

/// `rollout.policy.v1`.
pub mod policy {
    tonic::include_proto!("rollout.policy.v1");
}

/// `rollout.coordinator.v1`.
pub mod coordinator {
    tonic::include_proto!("rollout.coordinator.v1");
}

/// Version of [`policy`], exchanged on `Describe`.
pub const PROTOCOL_VERSION: u32 = 1;
/// Version of [`coordinator`], exchanged on `Register`. Since 2, a worker
/// registers with its renderer, and a result carries a fingerprint. Since 3,
/// every attempt has an id, claims are idempotent, and realised values take the
/// place of their digests.
pub const COORDINATOR_PROTOCOL_VERSION: u32 = 3;
/// Most control steps of which a motion is sent: ten times LIBERO's longest
/// rollout. Of a longer one the outcome goes without.
pub const MAX_MOTION_STEPS: usize = 5_200;
/// Largest message accepted, bytes: an observation of two 512×512 frames fits
/// four times. tonic's own default of 4 MiB does not hold a batch.
pub const MAX_MESSAGE_BYTES: usize = 32 << 20;
