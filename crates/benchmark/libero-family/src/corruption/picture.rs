//! A picture and conversions of its channel values.

/// Channels of a pixel.
pub(super) const CHANNELS: usize = 3;

/// A picture: rows of pixels of three bytes, in the order in which corruptions process them.
#[derive(Debug)]
pub struct Picture<'a> {
    /// Number of rows.
    pub height: usize,
    /// Number of pixels in a row.
    pub width: usize,
    /// `height × width × 3` bytes.
    pub rgb: &'a mut [u8],
}

/// Converts a number to a byte by truncation, like NumPy's `astype(uint8)`.
pub(super) fn truncated(value: f64) -> u8 {
    value as u8
}

/// Returns the channel values scaled to [0, 1].
pub(super) fn unit(picture: &Picture<'_>) -> Vec<f64> {
    let bytes = picture.rgb.iter();
    bytes.map(|byte| f64::from(*byte) / 255.0).collect()
}
