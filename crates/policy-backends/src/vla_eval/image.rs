//! Encodes frames as vla-eval's client does (module `protocol.image_codec`). Pure functions.

use std::fmt;

use rmpv::Value;

use crate::numpy::{Keys, array, map};

/// JPEG quality, as in vla-eval.
const JPEG_QUALITY: u8 = 95;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImageFormat {
    /// Lossless compression, the default of vla-eval's client.
    #[default]
    Png,
    /// Uncompressed NumPy array.
    Raw,
    Jpeg,
}

impl ImageFormat {
    pub(super) fn named(name: &str) -> Option<Self> {
        [Self::Png, Self::Raw, Self::Jpeg].into_iter().find(|format| format.to_string() == name)
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

/// Encodes an RGB frame of `side`² pixels, row 0 at the top, as a message's value.
pub(super) fn encode(format: ImageFormat, side: u32, rgb: &[u8]) -> Result<Value, String> {
    let shape = [side as usize, side as usize, 3];
    let mut data = vec![];
    match format {
        ImageFormat::Raw => return Ok(array(Keys::Text, "|u1", &shape, rgb.to_vec())),
        ImageFormat::Png => {
            let mut png = png::Encoder::new(&mut data, side, side);
            png.set_color(png::ColorType::Rgb);
            let writer = png.write_header();
            let written = writer.and_then(|mut writer| writer.write_image_data(rgb));
            written.map_err(|error| error.to_string())?;
        }
        ImageFormat::Jpeg => {
            let side = u16::try_from(side).map_err(|error| error.to_string())?;
            jpeg_encoder::Encoder::new(&mut data, JPEG_QUALITY)
                .encode(rgb, side, side, jpeg_encoder::ColorType::Rgb)
                .map_err(|error| error.to_string())?;
        }
    }
    Ok(map([
        ("__image__", Value::Boolean(true)),
        ("format", Value::from(format.to_string())),
        ("data", Value::Binary(data)),
        ("shape", Value::Array(shape.map(Value::from).into())),
    ]))
}
