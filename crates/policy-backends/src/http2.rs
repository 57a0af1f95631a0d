//! HTTP/2 settings of servers and clients.

/// HTTP/2 window of one call, bytes: about twenty observations of two 256 × 256 frames, so that no
/// call waits for a window update.
pub const STREAM_WINDOW_BYTES: u32 = 8 << 20;
/// HTTP/2 window of one connection, bytes.
pub const CONNECTION_WINDOW_BYTES: u32 = 32 << 20;
/// Largest HTTP/2 frame, bytes: an observation fits in one frame. The default of 16 KiB would split
/// an observation into two dozen frames, each with its own write and wake-up of the reader.
pub const MAX_FRAME_BYTES: u32 = 1 << 20;
