//! RGB pictures, and their files as PNG.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

use sim::Frame;

pub(crate) type Colour = [u8; 3];

/// Picture with row 0 at the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Picture {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) pixels: Vec<Colour>,
}

impl Picture {
    pub(crate) fn filled(width: usize, height: usize, colour: Colour) -> Self {
        Self { width, height, pixels: vec![colour; width * height] }
    }

    /// Converts a frame, whose row 0 is the bottom row.
    pub(crate) fn upright(frame: &Frame) -> Self {
        let (width, height) = (frame.width as usize, frame.height as usize);
        let rows = frame.rgb.as_chunks::<3>().0.chunks(width.max(1)).rev();
        Self { width, height, pixels: rows.flatten().copied().collect() }
    }

    /// Sets a pixel, unless it lies outside.
    pub(crate) fn set(&mut self, x: usize, y: usize, colour: Colour) {
        if x < self.width && y < self.height {
            self.pixels[y * self.width + x] = colour;
        }
    }

    /// Copies a picture with its upper left corner at this place.
    pub(crate) fn paste(&mut self, picture: &Self, left: usize, top: usize) {
        for (at, colour) in picture.pixels.iter().enumerate() {
            self.set(left + at % picture.width, top + at / picture.width, *colour);
        }
    }

    pub(crate) fn save(&self, path: &Path) -> io::Result<()> {
        let size = [self.width, self.height].map(|side| u32::try_from(side).expect("small"));
        let mut png = png::Encoder::new(BufWriter::new(File::create(path)?), size[0], size[1]);
        png.set_color(png::ColorType::Rgb);
        let mut writer = png.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        Ok(writer.finish()?)
    }
}
