//! The fifty corruptions of `agentview`'s pictures in LIBERO-Plus, reproduced byte for byte:
//! five kinds with ten severities each, computed like NumPy 1.26, SciPy, scikit-image 0.24 and
//! ImageMagick 6.9.11-60 Q16. The random kinds draw from NumPy's global generator, which
//! the placement of objects and the corruption of every picture share.

mod exponential;
mod fog;
mod gaussian;
mod glass;
mod motion;
mod zoom;

use std::fmt;

use crate::numpy::LegacyRng;

const SEVERITIES: u8 = 10;
const CHANNELS: usize = 3;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// ImageMagick's motion blur, whose angle is drawn for each picture.
    Motion,
    Gaussian,
    /// Mean of magnified pictures.
    Zoom,
    /// Fog as a plasma fractal, drawn for each picture.
    Fog,
    /// Gaussian blur, then pixels copied from nearby, then a second Gaussian blur.
    Glass,
}

impl Kind {
    /// All kinds, in the order of their numbers.
    pub const ALL: [Self; 5] = [Self::Motion, Self::Gaussian, Self::Zoom, Self::Fog, Self::Glass];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Motion => "motion",
            Self::Gaussian => "gaussian",
            Self::Zoom => "zoom",
            Self::Fog => "fog",
            Self::Glass => "glass",
        }
    }

    const fn supported_pictures(self) -> &'static str {
        match self {
            Self::Motion | Self::Gaussian | Self::Glass => "pictures of one pixel or more",
            Self::Zoom => "square pictures of at least 2 pixels a side",
            Self::Fog => "pictures of at most 256 pixels a side",
        }
    }
}

/// A corruption by its number: `_noise_K` of a variant's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Corruption {
    kind: Kind,
    /// Index into the tables of the kinds: severity − 1.
    severity_index: usize,
}

impl Corruption {
    /// Returns corruption `number`, 1 to 50; `None` for other numbers.
    pub fn new(number: u8) -> Option<Self> {
        let index = number.checked_sub(1)?;
        let kind = *Kind::ALL.get(usize::from(index / SEVERITIES))?;
        let severity_index = usize::from(index % SEVERITIES);
        Some(Self { kind, severity_index })
    }

    /// Returns the number, 1 to 50.
    pub const fn number(self) -> u8 {
        self.kind as u8 * SEVERITIES + self.severity_index as u8 + 1
    }

    pub const fn kind(self) -> Kind {
        self.kind
    }

    /// Returns the severity, 1 to 10.
    pub const fn severity(self) -> usize {
        self.severity_index + 1
    }

    /// Advances the generator as if a picture of the given size were corrupted.
    pub fn skip(self, height: usize, width: usize, rng: &mut LegacyRng) {
        match self.kind {
            Kind::Motion => motion::skip(rng),
            Kind::Gaussian | Kind::Zoom => {}
            Kind::Fog => fog::skip(rng),
            Kind::Glass => glass::skip(height, width, self.severity_index, rng),
        }
    }

    pub fn check(self, height: usize, width: usize, bytes: usize) -> Result<(), UnsuitedPicture> {
        let is_complete = bytes == height * width * CHANNELS && bytes > 0;
        let is_supported = match self.kind {
            Kind::Motion | Kind::Gaussian | Kind::Glass => true,
            Kind::Zoom => height == width && height > 1,
            Kind::Fog => height.max(width) <= fog::SIDE,
        };
        match is_complete && is_supported {
            true => Ok(()),
            false => Err(UnsuitedPicture { kind: self.kind, height, width, bytes }),
        }
    }

    pub fn apply(
        self,
        picture: &mut Picture<'_>,
        rng: &mut LegacyRng,
    ) -> Result<(), UnsuitedPicture> {
        self.check(picture.height, picture.width, picture.rgb.len())?;
        match self.kind {
            Kind::Motion => motion::blur(picture, self.severity_index, rng),
            Kind::Gaussian => gaussian::blur_picture(picture, self.severity_index),
            Kind::Zoom => zoom::blur(picture, self.severity_index),
            Kind::Fog => fog::add_fog(picture, self.severity_index, rng),
            Kind::Glass => glass::blur(picture, self.severity_index, rng),
        }
        Ok(())
    }
}

impl fmt::Display for Corruption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.kind.name(), self.severity())
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "corrupt a picture of {width}×{height} pixels and {bytes} bytes with `{}`, which supports only {}, \
     with three bytes per pixel; have the policy request a supported size",
    kind.name(),
    kind.supported_pictures()
)]
pub struct UnsuitedPicture {
    kind: Kind,
    height: usize,
    width: usize,
    bytes: usize,
}

/// A picture: rows of pixels of three bytes, from the bottom up like LIBERO's arrays; corruptions process them
/// in this order.
#[derive(Debug)]
pub struct Picture<'a> {
    pub height: usize,
    pub width: usize,
    /// `height × width × 3` bytes.
    pub rgb: &'a mut [u8],
}

/// Converts a number to a byte by truncation, like NumPy's `astype(uint8)`.
fn truncated(value: f64) -> u8 {
    value as u8
}

fn unit(picture: &Picture<'_>) -> Vec<f64> {
    let bytes = picture.rgb.iter();
    bytes.map(|byte| f64::from(*byte) / 255.0).collect()
}
