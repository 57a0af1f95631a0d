//! Frames as vla-eval's client sends them (its module `protocol.image_codec`).
//! Pure.

use std::fmt;

use image::{
    ExtendedColorType, ImageEncoder, ImageError,
    codecs::{jpeg::JpegEncoder, png::PngEncoder},
};
use rmpv::Value;

use crate::backend::numpy::{Keys, array, map};

/// JPEG quality, as vla-eval has it.
const JPEG_QUALITY: u8 = 95;

/// Encoding of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImageFormat {
    /// Compressed without loss: what vla-eval's client sends.
    #[default]
    Png,
    /// NumPy array.
    Raw,
    /// Compressed with loss.
    Jpeg,
}

impl ImageFormat {
    /// The format of this name.
    pub(super) fn named(name: &str) -> Option<Self> {
        [Self::Png, Self::Raw, Self::Jpeg]
            .into_iter()
            .find(|it| it.to_string() == name)
    }
}

impl fmt::Display for ImageFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Png => "png",
            Self::Raw => "raw",
            Self::Jpeg => "jpeg",
        })
    }
}

/// An RGB frame of `side`² pixels, row 0 at the top, as its value in a message.
///
/// # Errors
/// If the encoder fails; the text says why.
pub(super) fn encode(format: ImageFormat, side: u32, rgb: &[u8]) -> Result<Value, ImageError> {
    let shape = [side as usize, side as usize, 3];
    let mut data = vec![];
    let color = ExtendedColorType::Rgb8;
    match format {
        ImageFormat::Raw => return Ok(array(Keys::Text, "|u1", &shape, rgb.to_vec())),
        ImageFormat::Png => PngEncoder::new(&mut data).write_image(rgb, side, side, color)?,
        ImageFormat::Jpeg => JpegEncoder::new_with_quality(&mut data, JPEG_QUALITY)
            .write_image(rgb, side, side, color)?,
    }
    Ok(map([
        ("__image__", Value::Boolean(true)),
        ("format", Value::from(format.to_string())),
        ("data", Value::Binary(data)),
        ("shape", Value::Array(shape.map(Value::from).into())),
    ]))
}
