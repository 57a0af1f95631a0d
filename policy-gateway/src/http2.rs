//! Sizes of HTTP/2 connections, as server and as client.

/// HTTP/2 window of one call, bytes: an observation of two 256×256 frames fits
/// twenty times, so that no call waits for a window update.
pub const STREAM_WINDOW_BYTES: u32 = 8 << 20;
/// HTTP/2 window of one connection, bytes.
pub const CONNECTION_WINDOW_BYTES: u32 = 32 << 20;
/// Largest HTTP/2 frame taken, bytes: an observation comes in one, where the
/// usual 16 KiB make two dozen, each with its own write and its own waking of
/// the reader.
pub const MAX_FRAME_BYTES: u32 = 1 << 20;
