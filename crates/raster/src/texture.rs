//! Textures and their mipmap levels, computed once. Levels are averaged as in Mesa: by sampling the
//! previous level at the centre of each texel.

use bytes::Bytes;

use crate::error::ModelError;
use crate::lanes::LANES;
use crate::values::Values;

const MAX_SIDE: usize = 1 << 14;

/// Mapping of a texture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextureKind {
    /// Flat, repeated in both directions.
    Flat { srgb: bool },
    /// Six square faces around the scene: +x, −x, +y, −y, +z, −z.
    Cube,
}

/// A texture, ready to be sampled. The caller keeps the bytes of its largest level.
#[derive(Debug)]
pub struct Texture {
    pub(crate) kind: TextureKind,
    pub(crate) levels: Vec<Level>,
    channels: usize,
    /// Number of texels in the largest level.
    largest: usize,
    /// Bytes of the smaller levels, level by level and image by image, plus one byte, so that four
    /// bytes can be read at the last texel, which has three.
    smaller: Values<u8>,
}

#[derive(Clone, Copy)]
pub(crate) struct Texels<'a> {
    pub(crate) texture: &'a Texture,
    largest: &'a [u8],
    smaller: &'a [u8],
}

impl<'a> Texels<'a> {
    pub(crate) fn new(texture: &'a Texture, largest: &'a [u8]) -> Self {
        Self { texture, largest, smaller: &texture.smaller }
    }

    /// Red, green, blue and opacity, from the lowest byte. Texels are numbered through all levels.
    #[inline(always)]
    pub(crate) fn at(self, index: usize) -> u32 {
        const OPAQUE: u32 = 0xff00_0000;
        let texture = self.texture;
        let (bytes, at) = match index < texture.largest {
            true => (self.largest, index * texture.channels),
            false => (self.smaller, (index - texture.largest) * texture.channels),
        };
        let four = match bytes.get(at..at + 4) {
            Some(four) => u32::from_le_bytes([four[0], four[1], four[2], four[3]]),
            None => u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], 0]),
        };
        match texture.channels {
            3 => four | OPAQUE,
            _ => four,
        }
    }
}

impl Texels<'_> {
    /// Usually all or none are of the largest level, so that the byte slice is chosen once.
    #[inline(always)]
    pub(crate) fn eight(self, at: &[i32; LANES]) -> [u32; LANES] {
        let largest = self.texture.largest as i32;
        let smaller = at.iter().fold(0, |count, at| count + u32::from(*at >= largest));
        match smaller {
            0 => self.eight_of(self.largest, 0, at),
            8 => self.eight_of(self.smaller, largest, at),
            _ => {
                let mut texels = [0; LANES];
                for (texel, at) in texels.iter_mut().zip(at) {
                    *texel = self.at(*at as usize);
                }
                texels
            }
        }
    }

    /// Returns eight texels and their successors, each pair with one load; `None` if the pairs are
    /// in different byte slices, or one is too close to a slice's end.
    #[inline(always)]
    pub(crate) fn eight_pairs(self, at: &[i32; LANES]) -> Option<[[u32; LANES]; 2]> {
        let largest = self.texture.largest as i32;
        let smaller = at.iter().fold(0, |count, at| count + u32::from(*at >= largest));
        let (bytes, first) = match smaller {
            0 => (self.largest, 0),
            8 => (self.smaller, largest),
            _ => return None,
        };
        match self.texture.channels {
            3 => eight_pairs::<3>(bytes, first, at),
            _ => eight_pairs::<4>(bytes, first, at),
        }
    }

    /// Returns eight texels from bytes that start with texel `first`.
    #[inline(always)]
    fn eight_of(self, bytes: &[u8], first: i32, at: &[i32; LANES]) -> [u32; LANES] {
        let (channels, opaque) = match self.texture.channels {
            3 => (3, 0xff00_0000),
            _ => (4, 0),
        };
        let mut texels = [0; LANES];
        for (texel, at) in texels.iter_mut().zip(at) {
            let place = (at - first) as usize * channels;
            let rest = &bytes[place..];
            *texel = opaque
                | match rest.first_chunk() {
                    Some(four) => u32::from_le_bytes(*four),
                    None => u32::from_le_bytes([rest[0], rest[1], rest[2], 0]),
                };
        }
        texels
    }
}

/// See [`Texels::eight_pairs`]; the bytes start with texel `first`.
#[inline(always)]
fn eight_pairs<const CHANNELS: usize>(
    bytes: &[u8],
    first: i32,
    at: &[i32; LANES],
) -> Option<[[u32; LANES]; 2]> {
    let opaque = if CHANNELS == 3 { 0xff00_0000 } else { 0 };
    let mut pairs = [[0; LANES]; 2];
    for (lane, at) in at.iter().enumerate() {
        let place = (at - first).cast_unsigned() as usize * CHANNELS;
        let eight = bytes.get(place..place + 8)?;
        let pair = u64::from_le_bytes(*eight.first_chunk()?);
        pairs[0][lane] = opaque | pair as u32;
        pairs[1][lane] = opaque | (pair >> (8 * CHANNELS)) as u32;
    }
    Some(pairs)
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Level {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Index of the first image's first texel.
    pub(crate) start: usize,
    /// Texels from one image to the next; 0 if all faces share one image.
    pub(crate) image: usize,
}

impl Texture {
    /// Creates a texture from its largest level, row by row, with 3 or 4 bytes per texel. A cube
    /// has either one square for all its faces, or six below one another.
    pub fn new(
        kind: TextureKind,
        width: usize,
        height: usize,
        channels: usize,
        bytes: &[u8],
    ) -> Result<Self, ModelError> {
        let images = image_count(kind, width, height, channels)
            .filter(|_| bytes.len() == width * height * channels)
            .ok_or(ModelError::Texture { width, height, channels, bytes: bytes.len() })?;
        let mut texture = Self::with_sizes(kind, [width, height, channels], images);
        texture.smaller = Values::with_capacity(texture.smaller_bytes(images));
        texture.add_smaller_levels(images, bytes);
        texture.smaller.push(0);
        Ok(texture)
    }

    /// Returns the smaller levels as bytes, for [`Texture::with_smaller`] with the same
    /// [`SOURCES`](crate::SOURCES).
    pub fn smaller(&self) -> &[u8] {
        &self.smaller
    }

    /// Creates a texture from smaller levels that were computed earlier, without copying them.
    pub fn with_smaller(
        kind: TextureKind,
        [width, height, channels]: [usize; 3],
        smaller: Bytes,
    ) -> Result<Self, ModelError> {
        let images = image_count(kind, width, height, channels).ok_or(ModelError::Bytes)?;
        let texture = Self {
            smaller: Values::Shared(smaller),
            ..Self::with_sizes(kind, [width, height, channels], images)
        };
        match texture.smaller.len() == texture.smaller_bytes(images) {
            true => Ok(texture),
            false => Err(ModelError::Bytes),
        }
    }

    fn with_sizes(kind: TextureKind, [width, height, channels]: [usize; 3], images: usize) -> Self {
        let first = Level::new(width, height / images, 0, images);
        let next = |last: &Level| last.next(images);
        Self {
            kind,
            levels: std::iter::successors(Some(first), next).collect(),
            channels,
            largest: width * height,
            smaller: Values::default(),
        }
    }

    fn smaller_bytes(&self, images: usize) -> usize {
        let end = self.levels.last().map_or(0, |last| last.end(images));
        (end - self.largest) * self.channels + 1
    }

    pub(crate) fn bytes(&self) -> usize {
        self.largest * self.channels
    }

    fn add_smaller_levels(&mut self, images: usize, bytes: &[u8]) {
        for at in 1..self.levels.len() {
            let (last, Level { width, height, .. }) = (self.levels[at - 1], self.levels[at]);
            for image in 0..images {
                for y in 0..height {
                    let t = (y as f32 + 0.5) / height as f32;
                    for x in 0..width {
                        let s = (x as f32 + 0.5) / width as f32;
                        let texel = Texels::new(self, bytes).downsampled(&last, image, s, t);
                        self.smaller.extend(&texel.to_le_bytes()[..self.channels]);
                    }
                }
            }
        }
    }
}

impl Texels<'_> {
    /// Colour at a point, 0 to 1 in both directions, as a texel of the next smaller level.
    fn downsampled(&self, level: &Level, image: usize, s: f32, t: f32) -> u32 {
        let first = level.start + image * level.image;
        let texel = |x: usize, y: usize| self.at(first + y * level.width + x).to_le_bytes();
        let is_srgb = self.texture.kind == (TextureKind::Flat { srgb: true });
        if !is_srgb {
            let (x0, x1, u) = neighbours_in_256ths(s, level.width);
            let (y0, y1, v) = neighbours_in_256ths(t, level.height);
            let (a, b, c, d) = (texel(x0, y0), texel(x1, y0), texel(x0, y1), texel(x1, y1));
            return u32::from_le_bytes(std::array::from_fn(|channel| {
                let top = blend(a[channel], b[channel], u);
                blend(top, blend(c[channel], d[channel], u), v)
            }));
        }
        let (x0, x1, u) = neighbours_clamped(s, level.width);
        let (y0, y1, v) = neighbours_clamped(t, level.height);
        let (a, b, c, d) = (texel(x0, y0), texel(x1, y0), texel(x0, y1), texel(x1, y1));
        u32::from_le_bytes(std::array::from_fn(|channel| {
            let is_colour = channel < 3;
            let decoded = |value: u8| match is_colour {
                true => linear(value),
                false => f32::from(value) * (1.0 / 255.0),
            };
            let mix = |a: f32, b: f32, weight: f32| weight.mul_add(b - a, a);
            let top = mix(decoded(a[channel]), decoded(b[channel]), u);
            let bottom = mix(decoded(c[channel]), decoded(d[channel]), u);
            let value = mix(top, bottom, v);
            match is_colour {
                true => encoded(value),
                false => (value.clamp(0.0, 1.0) * 255.0).round_ties_even() as u8,
            }
        }))
    }
}

impl Level {
    fn new(width: usize, height: usize, start: usize, images: usize) -> Self {
        Self { width, height, start, image: if images == 1 { 0 } else { width * height } }
    }

    fn end(&self, images: usize) -> usize {
        self.start + images * self.width * self.height
    }

    fn next(&self, images: usize) -> Option<Self> {
        let half = |side: usize| (side / 2).max(1);
        let is_last = self.width == 1 && self.height == 1;
        (!is_last).then(|| Self::new(half(self.width), half(self.height), self.end(images), images))
    }
}

/// Returns the number of images in the largest level; `None` if the dimensions are invalid.
fn image_count(kind: TextureKind, width: usize, height: usize, channels: usize) -> Option<usize> {
    let is_sized = (1..=MAX_SIDE).contains(&width)
        && (1..=6 * MAX_SIDE).contains(&height)
        && matches!(channels, 3 | 4);
    match kind {
        _ if !is_sized => None,
        TextureKind::Flat { .. } => (height <= MAX_SIDE).then_some(1),
        TextureKind::Cube => (height == width || height == 6 * width).then(|| height / width),
    }
}

/// Returns the two texels around a point between 0 and 1 of a repeating texture, and the point's
/// distance from the first texel in 256ths.
fn neighbours_in_256ths(at: f32, size: usize) -> (usize, usize, i32) {
    let place = (at * (size * 256) as f32).round_ties_even() as i32 - 128;
    let first = (place >> 8).rem_euclid(size as i32) as usize;
    (first, (first + 1) % size, place & 255)
}

/// Variant of [`neighbours_in_256ths`] with a fraction, and clamped instead of repeated.
fn neighbours_clamped(at: f32, size: usize) -> (usize, usize, f32) {
    let place = at * size as f32 - 0.5;
    let floor = place.floor();
    let inside = |index: f32| (index.max(0.0) as usize).min(size - 1);
    (inside(floor), inside(floor + 1.0), place - floor)
}

/// Interpolates between two values of 0 to 255, by a weight in 256ths.
fn blend(from: u8, to: u8, weight: i32) -> u8 {
    let (from, to) = (i32::from(from), i32::from(to));
    (from + ((weight * (to - from) + 128) >> 8)) as u8
}

/// Mesa's polynomial for decoding values of 0 to 255, constant first; small ones are linear.
pub(crate) const SRGB_POLYNOMIAL: [f32; 4] =
    [0.0023, 0.0030 / 255.0, 0.6935 / (255.0 * 255.0), 0.3012 / (255.0 * 255.0 * 255.0)];
/// Largest sRGB value that is decoded linearly, with [`SRGB_LINEAR_FACTOR`].
pub(crate) const SRGB_LINEAR_TO: f32 = 15.0;
pub(crate) const SRGB_LINEAR_FACTOR: f32 = 1.0 / (12.6 * 255.0);

fn linear(value: u8) -> f32 {
    let x = f32::from(value);
    if x <= SRGB_LINEAR_TO {
        return x * SRGB_LINEAR_FACTOR;
    }
    let square = x * x;
    let even = square.mul_add(SRGB_POLYNOMIAL[2], SRGB_POLYNOMIAL[0]);
    let odd = square.mul_add(SRGB_POLYNOMIAL[3], SRGB_POLYNOMIAL[1]);
    odd.mul_add(x, even)
}

/// Mesa approximates the power by reciprocal square roots of low precision.
fn encoded(value: f32) -> u8 {
    let value = value.clamp(0.0, 1.0);
    let scaled = if value <= 0.003_130_8 {
        value * (12.92 * 255.0)
    } else {
        let root = value * reciprocal_sqrt(value);
        let power = reciprocal_sqrt(reciprocal_sqrt(root * value));
        let factor = |share: f32| (f64::from(share) * 1.0622 * 255.0) as f32;
        factor(0.675) * power + factor(0.325).mul_add(root, -0.0620 * 255.0)
    };
    scaled.round_ties_even() as u8
}

/// Intel's estimate: at the centre of one of 1,024 intervals per octave, rounded to 12 bits. Mipmap
/// levels of sRGB textures equal Mesa's only with it.
fn reciprocal_sqrt(value: f32) -> f32 {
    /// Width of an interval, in units of the mantissa's last bit.
    const PART: u32 = 1 << 13;
    let bits = value.to_bits();
    // Scales by an even power of two into the range from 1/4 to 1.
    let exponent = (bits >> 23) as i32 - 127;
    let halved = (exponent + 2).div_euclid(2);
    let scaled =
        f32::from_bits((((exponent - 2 * halved + 127) as u32) << 23) | bits & 0x007f_ffff);
    let middle = f32::from_bits((scaled.to_bits() & !(PART - 1)) | (PART / 2));
    let root = (4096.0 / f64::from(middle).sqrt()).round() / 4096.0;
    (root * 2f64.powi(-halved)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn estimated_reciprocal_roots_have_errors_below_one_in_two_thousand() {
        for value in [0.0032f32, 0.01, 0.2499, 0.25, 0.3, 0.5, 0.99, 1.0, 2.0, 17.3] {
            let expected = 1.0 / value.sqrt();
            assert!((reciprocal_sqrt(value) / expected - 1.0).abs() < 5e-4, "{value}");
        }
        assert_eq!(reciprocal_sqrt(1.0), 4095.0 / 4096.0);
    }

    #[test]
    fn levels_halve_down_to_one_texel() {
        let bytes: Vec<u8> = (0..12 * 5 * 3).map(|byte| byte as u8).collect();
        let flat = TextureKind::Flat { srgb: false };
        let texture = Texture::new(flat, 12, 5, 3, &bytes).expect("a texture");
        let sizes = texture.levels.iter().map(|level| (level.width, level.height));
        assert_eq!(sizes.collect::<Vec<_>>(), [(12, 5), (6, 2), (3, 1), (1, 1)]);
        assert_eq!(texture.smaller.len(), (12 + 3 + 1) * 3 + 1);
        let texels = Texels::new(&texture, &bytes);
        assert_eq!(texels.at(0), u32::from_le_bytes([0, 1, 2, 255]));
        assert_eq!(texels.at(59), u32::from_le_bytes([177, 178, 179, 255]));
    }

    #[test]
    fn a_texture_of_one_colour_has_that_colour_on_every_level() {
        for kind in
            [TextureKind::Flat { srgb: false }, TextureKind::Flat { srgb: true }, TextureKind::Cube]
        {
            for value in [0u8, 1, 15, 16, 100, 254, 255] {
                let bytes = vec![value; 8 * 8 * 3];
                let texture = Texture::new(kind, 8, 8, 3, &bytes).expect("a texture");
                let expected = u32::from_le_bytes([value, value, value, 255]);
                let texels = Texels::new(&texture, &bytes);
                let all = texture.levels.iter().map(|level| level.width * level.height);
                assert!((0..all.sum()).all(|at| texels.at(at) == expected), "{kind:?} {value}");
            }
        }
    }

    #[test]
    fn sizes_and_bytes_that_do_not_fit_are_refused() {
        let flat = TextureKind::Flat { srgb: false };
        for (kind, width, height, channels, bytes) in [
            (flat, 0, 0, 3, 0),
            (flat, 2, 2, 2, 8),
            (flat, 2, 2, 3, 11),
            (flat, 1 << 20, 1, 3, 3 << 20),
            (flat, usize::MAX, 3, 3, 9),
            (flat, 2, 2, usize::MAX, 12),
            (TextureKind::Cube, 2, 6, 3, 36),
            (TextureKind::Cube, usize::MAX, 6, 3, 36),
        ] {
            let texture = Texture::new(kind, width, height, channels, &vec![0; bytes]);
            assert!(texture.is_err(), "{kind:?} {width} {height}");
        }
    }
}
