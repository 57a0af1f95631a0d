//! A picture, and its numbers.

/// Channels of a pixel.
pub(super) const CHANNELS: usize = 3;

/// A picture: rows of pixels of three bytes, in the order in which they are given.
#[derive(Debug)]
pub struct Picture<'a> {
    /// Rows.
    pub height: usize,
    /// Pixels of a row.
    pub width: usize,
    /// `height × width × 3` bytes.
    pub rgb: &'a mut [u8],
}

/// A byte as NumPy makes one of a number in 0..=255 and a little more: by truncation.
pub(super) fn truncated(value: f64) -> u8 {
    value as u8
}

/// The picture in [0, 1].
pub(super) fn unit(picture: &Picture<'_>) -> Vec<f64> {
    let bytes = picture.rgb.iter();
    bytes.map(|byte| f64::from(*byte) / 255.0).collect()
}
