//! The sensor axis: corrupts rendered pictures before the policy sees them, by motion blur,
//! defocus, compression and read-out noise, in this order.
//!
//! The arithmetic follows NumPy and SciPy (`ndimage.convolve`,
//! `gaussian_filter`, mode `nearest`, truncated at 4 σ) in double precision.

use std::f64::consts::PI;

use benchmark::SensorCorruption;
use benchmark::numpy::DefaultRng;
use benchmark::streams::{MatchedStream, Randomness};

use super::jpeg;

/// Picture size at which the parameters' lengths in pixels apply.
const REFERENCE_PX: f64 = 128.0;
const SHORTEST_MOTION_PX: f64 = 1.5;
/// Gaussian blur up to this standard deviation is not applied, pixels.
const NEGLIGIBLE_BLUR_PX: f64 = 1e-3;
/// Compression up to this is not applied, log2 of 100 over the quality.
const NEGLIGIBLE_JPEG_LOG2: f64 = 1e-3;
/// Noise up to this standard deviation is not applied, for values in [0, 1].
const NEGLIGIBLE_NOISE: f64 = 1e-5;
const TRUNCATE_SIGMAS: f64 = 4.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FrameSource {
    Agentview,
    Wrist,
    /// A camera of another simulator, by the lane of its noise.
    Other(u32),
}

impl FrameSource {
    /// LIBERO's cameras in the order in which they draw from NumPy's stream.
    pub const ALL: [Self; 2] = [Self::Agentview, Self::Wrist];

    /// Returns a camera of another simulator, whose lane follows from its name (FNV-1a).
    pub fn other(name: &str) -> Self {
        let mix = |hash: u32, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        Self::Other(name.bytes().fold(0x811c_9dc5, mix) | 1 << 31)
    }

    const fn lane(self) -> u32 {
        match self {
            Self::Agentview => 0,
            Self::Wrist => 1,
            Self::Other(lane) => lane,
        }
    }
}

/// A picture: RGB, row by row, in the renderer's orientation.
#[derive(Debug)]
pub struct Frame<'a> {
    pub source: FrameSource,
    pub step: u32,
    pub width: usize,
    pub height: usize,
    /// `width` × `height` × 3 bytes.
    pub rgb: &'a mut [u8],
}

#[derive(Clone)]
pub struct SensorStage {
    corruption: SensorCorruption,
    /// Direction of the motion blur, rad, in [0, π).
    motion_angle: f64,
    noise: FrameNoise,
}

#[derive(Clone)]
enum FrameNoise {
    Matched(MatchedStream),
    Reference(NumpyFrames),
}

impl SensorStage {
    pub fn new(corruption: &SensorCorruption, randomness: &Randomness) -> Self {
        let (motion_angle, noise) = match *randomness {
            Randomness::Matched(stream) => {
                (stream.fixed().line_angle(), FrameNoise::Matched(stream))
            }
            Randomness::Reference { seed } => (
                DefaultRng::seed(seed).uniform(0.0, PI),
                FrameNoise::Reference(NumpyFrames::new(seed + 1)),
            ),
        };
        Self { corruption: *corruption, motion_angle, noise }
    }

    /// Corrupts a picture in place.
    ///
    /// The result depends only on the picture, its step and its camera, not on earlier pictures: a
    /// policy that requests few pictures, or one camera, gets the same pixels as a policy that
    /// requests all. In the `reference` realisation, both cameras draw from one stream at every
    /// step, so noise for pictures that were not requested is drawn and discarded; both cameras
    /// must then have the same size. Cameras of other simulators get the first one's noise.
    ///
    /// # Panics
    /// If `rgb` is not `width` × `height` × 3 bytes.
    pub fn apply(&mut self, frame: &mut Frame<'_>) {
        assert_eq!(
            frame.rgb.len(),
            frame.width * frame.height * 3,
            "bytes of an RGB picture of {} x {}",
            frame.width,
            frame.height
        );
        let scale = frame.width.min(frame.height) as f64 / REFERENCE_PX;
        let mut picture = Picture::from_rgb(frame);

        let motion_px = self.corruption.motion_len.abs() * scale;
        if motion_px >= SHORTEST_MOTION_PX {
            picture = picture.motion_blurred(&motion_kernel(motion_px, self.motion_angle));
        }
        let blur_px = self.corruption.blur_sigma.abs() * scale;
        if blur_px > NEGLIGIBLE_BLUR_PX {
            picture = picture.gaussian_blurred(&gaussian_kernel(blur_px));
        }
        if let Some(quality) = self.jpeg_quality() {
            let mut bytes = picture.to_bytes();
            jpeg::round_trip(&mut bytes, frame.width, frame.height, quality);
            picture.set_bytes(&bytes);
        }
        self.add_noise(frame.source, frame.step, &mut picture.values);
        frame.rgb.copy_from_slice(&picture.to_bytes());
    }

    /// Returns the drawn elements to store with the result: the blur's angle, and four noise values
    /// per camera: in the `matched` realisation the first of the camera's first picture, in the
    /// `reference` realisation the first of the stream that both cameras share.
    pub fn realised(&self) -> Vec<f64> {
        let mut realised = vec![self.motion_angle];
        for source in FrameSource::ALL {
            match &self.noise {
                FrameNoise::Matched(stream) => {
                    let mut rng = stream.at(0, source.lane());
                    realised.extend((0..4).map(|_| rng.standard_normal()));
                }
                // The start of a single stream identifies the whole stream.
                FrameNoise::Reference(frames) => {
                    let mut rng = frames.first.clone();
                    realised.extend((0..4).map(|_| rng.standard_normal()));
                }
            }
        }
        realised
    }

    fn jpeg_quality(&self) -> Option<u8> {
        let strength = self.corruption.jpeg_log2.abs();
        let quality = (100.0 * (-strength).exp2()).round_ties_even();
        (strength > NEGLIGIBLE_JPEG_LOG2).then_some(quality.clamp(1.0, 100.0) as u8)
    }

    fn add_noise(&mut self, source: FrameSource, step: u32, values: &mut [f64]) {
        let sigma = self.corruption.noise_sigma.abs();
        if sigma <= NEGLIGIBLE_NOISE {
            return;
        }
        match &mut self.noise {
            FrameNoise::Matched(stream) => {
                let mut rng = stream.at(step, source.lane());
                for value in values {
                    *value += sigma * rng.standard_normal();
                }
            }
            FrameNoise::Reference(frames) => {
                let place = FrameSource::ALL.iter().position(|known| *known == source);
                let index = step as usize * FrameSource::ALL.len() + place.unwrap_or(0);
                let mut rng = frames.generator_at(index, values.len());
                for value in values {
                    *value += rng.normal(0.0, sigma);
                }
            }
        }
    }
}

/// NumPy's single noise stream, saved at the start of every picture. A normal number consumes a
/// varying number of random words, so a picture's position in the stream is known only after
/// drawing all earlier pictures; saved positions take 32 bytes per picture.
#[derive(Clone)]
struct NumpyFrames {
    first: DefaultRng,
    starts: Vec<DefaultRng>,
    values_per_frame: usize,
}

impl NumpyFrames {
    fn new(seed: u64) -> Self {
        Self { first: DefaultRng::seed(seed), starts: Vec::new(), values_per_frame: 0 }
    }

    fn generator_at(&mut self, index: usize, values_per_frame: usize) -> DefaultRng {
        if self.values_per_frame != values_per_frame {
            self.values_per_frame = values_per_frame;
            self.starts = vec![self.first.clone()];
        }
        while self.starts.len() <= index {
            let mut next = self.starts[self.starts.len() - 1].clone();
            for _ in 0..values_per_frame {
                next.standard_normal();
            }
            self.starts.push(next);
        }
        self.starts[index].clone()
    }
}

/// A picture with values in [0, 1], channels interleaved.
struct Picture {
    width: usize,
    height: usize,
    values: Vec<f64>,
}

/// A square kernel with `weight` at some elements and zero elsewhere.
struct LineKernel {
    size: usize,
    /// Row and column of each non-zero element.
    places: Vec<(usize, usize)>,
    weight: f64,
}

impl Picture {
    fn from_rgb(frame: &Frame<'_>) -> Self {
        Self {
            width: frame.width,
            height: frame.height,
            values: frame.rgb.iter().map(|&b| f64::from(b) / 255.0).collect(),
        }
    }

    fn set_bytes(&mut self, bytes: &[u8]) {
        for (value, &byte) in self.values.iter_mut().zip(bytes) {
            *value = f64::from(byte) / 255.0;
        }
    }

    fn to_bytes(&self) -> Vec<u8> {
        let byte = |value: &f64| (value.clamp(0.0, 1.0) * 255.0) as u8;
        self.values.iter().map(byte).collect()
    }

    fn padded(&self, margin: usize) -> Self {
        let width = self.width + 2 * margin;
        let height = self.height + 2 * margin;
        let mut values = Vec::with_capacity(width * height * 3);
        for y in 0..height {
            let y = y.saturating_sub(margin).min(self.height - 1);
            let row = &self.values[y * self.width * 3..(y + 1) * self.width * 3];
            for _ in 0..margin {
                values.extend_from_slice(&row[..3]);
            }
            values.extend_from_slice(row);
            for _ in 0..margin {
                values.extend_from_slice(&row[row.len() - 3..]);
            }
        }
        Self { width, height, values }
    }

    /// Convolves with a kernel centred at its element `size / 2`.
    fn motion_blurred(&self, kernel: &LineKernel) -> Self {
        let margin = kernel.size;
        let padded = self.padded(margin);
        let centre = kernel.size / 2;
        let row_len = self.width * 3;
        let mut values = vec![0.0; self.values.len()];
        for (y, output) in values.chunks_exact_mut(row_len).enumerate() {
            // Convolution mirrors the kernel, and SciPy sums in that order.
            for &(row, column) in kernel.places.iter().rev() {
                let y = y + margin + centre - row;
                let x = margin + centre - column;
                let start = (y * padded.width + x) * 3;
                add_scaled(output, &padded.values[start..start + row_len], kernel.weight);
            }
        }
        Self { values, ..*self }
    }

    /// `kernel` is symmetric, from its centre outwards; columns first, then rows, as in SciPy.
    fn gaussian_blurred(&self, kernel: &[f64]) -> Self {
        let radius = kernel.len() - 1;
        let row_len = self.width * 3;
        let mut columns = vec![0.0; self.values.len()];
        for (y, output) in columns.chunks_exact_mut(row_len).enumerate() {
            let row = |offset: isize| {
                let y = y.saturating_add_signed(offset).min(self.height - 1);
                &self.values[y * row_len..(y + 1) * row_len]
            };
            symmetric_sum(output, kernel, |k| (row(-k), row(k)));
        }
        let mut values = vec![0.0; self.values.len()];
        let mut padded = vec![0.0; row_len + 2 * radius * 3];
        for (output, input) in values.chunks_exact_mut(row_len).zip(columns.chunks_exact(row_len)) {
            replicate_ends(&mut padded, input, radius);
            let shifted = |offset: isize| {
                let start = (radius as isize + offset) as usize * 3;
                &padded[start..start + row_len]
            };
            symmetric_sum(output, kernel, |k| (shifted(-k), shifted(k)));
        }
        Self { values, ..*self }
    }
}

/// Computes `output` = centre · kernel\[0\] + Σ (left + right) · kernel\[k\], from the outermost
/// pair inwards, in SciPy's order.
fn symmetric_sum<'a>(
    output: &mut [f64],
    kernel: &[f64],
    pair: impl Fn(isize) -> (&'a [f64], &'a [f64]),
) {
    let (centre, _) = pair(0);
    for (out, value) in output.iter_mut().zip(centre) {
        *out = value * kernel[0];
    }
    for (k, &weight) in kernel.iter().enumerate().skip(1).rev() {
        let (left, right) = pair(k as isize);
        for ((out, l), r) in output.iter_mut().zip(left).zip(right) {
            *out += (l + r) * weight;
        }
    }
}

fn add_scaled(output: &mut [f64], input: &[f64], weight: f64) {
    for (out, value) in output.iter_mut().zip(input) {
        *out += value * weight;
    }
}

fn replicate_ends(padded: &mut [f64], row: &[f64], margin: usize) {
    let (left, rest) = padded.split_at_mut(margin * 3);
    let (middle, right) = rest.split_at_mut(row.len());
    middle.copy_from_slice(row);
    for pixel in left.chunks_exact_mut(3) {
        pixel.copy_from_slice(&row[..3]);
    }
    for pixel in right.chunks_exact_mut(3) {
        pixel.copy_from_slice(&row[row.len() - 3..]);
    }
}

/// A line through the centre: the distinct elements among n samples, normalised.
fn motion_kernel(length_px: f64, angle: f64) -> LineKernel {
    let size = length_px.round_ties_even() as usize;
    let centre = (size as f64 - 1.0) / 2.0;
    let place = |along: f64| (centre + along).round_ties_even();
    let mut places = Vec::with_capacity(size);
    for i in 0..size {
        let t = i as f64 - centre;
        let (row, column) = (place(t * angle.sin()), place(t * angle.cos()));
        let inside = |index: f64| index >= 0.0 && index < size as f64;
        if inside(row) && inside(column) {
            places.push((row as usize, column as usize));
        }
    }
    places.sort_unstable();
    places.dedup();
    let weight = 1.0 / places.len() as f64;
    LineKernel { size, places, weight }
}

/// Returns a normalised Gaussian from its centre outwards.
fn gaussian_kernel(sigma_px: f64) -> Vec<f64> {
    let radius = (TRUNCATE_SIGMAS * sigma_px + 0.5) as usize;
    let exponent = -0.5 / (sigma_px * sigma_px);
    let weight = |x: usize| (exponent * (x * x) as f64).exp();
    let weights: Vec<f64> = (0..=2 * radius).map(|i| weight(i.abs_diff(radius))).collect();
    let sum = numpy_sum(&weights);
    weights[radius..].iter().map(|weight| weight / sum).collect()
}

/// NumPy's order is eight parallel sums for 8 to 128 values. A uniform patch can lie exactly
/// between two grey levels, where the last bit of the weights decides.
fn numpy_sum(values: &[f64]) -> f64 {
    let (whole, rest) = values.split_at(values.len() / 8 * 8);
    let mut lanes = whole.chunks_exact(8);
    let Some(first) = lanes.next() else {
        return values.iter().sum();
    };
    let mut s: [f64; 8] = first.try_into().expect("chunks of eight");
    for lane in lanes {
        for (sum, value) in s.iter_mut().zip(lane) {
            *sum += value;
        }
    }
    let paired = ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7]));
    rest.iter().fold(paired, |sum, value| sum + value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use benchmark::{Axis, Realisation, RolloutId};

    const SIZE: usize = 48;

    fn stage(id: &str, corruption: &SensorCorruption) -> SensorStage {
        let id: RolloutId = id.parse().expect("an id");
        let randomness = Randomness::of(&id, Axis::Sensor, Realisation::Matched);
        SensorStage::new(corruption, &randomness)
    }

    fn corrupted(stage: &mut SensorStage, source: FrameSource, step: u32) -> Vec<u8> {
        let mut rgb: Vec<u8> = (0..SIZE * SIZE * 3).map(|i| (i * 7 % 256) as u8).collect();
        stage.apply(&mut Frame { source, step, width: SIZE, height: SIZE, rgb: &mut rgb });
        rgb
    }

    const STRONG: [f64; 4] = [0.05, 1.5, 1.8, 6.0];

    #[test]
    fn single_axis_and_simultaneous_give_equal_pictures_in_any_order() {
        let corruption = SensorCorruption::from(STRONG);
        let mut single_axis = stage("goal/t3/sensor/L3/c02", &corruption);
        let mut combined = stage("goal/t3/simultaneous/L3/c02", &corruption);
        assert_eq!(single_axis.realised(), combined.realised());
        let requests =
            [(FrameSource::Wrist, 4), (FrameSource::Agentview, 0), (FrameSource::Agentview, 4)];
        let pictures = requests.map(|(source, step)| corrupted(&mut single_axis, source, step));
        let expected = corrupted(&mut combined, FrameSource::Agentview, 4);
        assert_eq!(pictures[2], expected);
        assert_ne!(pictures[1], expected, "different steps have different noise");
        assert_ne!(pictures[0], expected, "different cameras have different noise");
        let [front, side] =
            ["front", "side"].map(|name| corrupted(&mut combined, FrameSource::other(name), 4));
        assert!(front != side && front != expected && side != expected);
    }

    #[test]
    fn signs_of_the_parameters_do_not_matter() {
        let id = "goal/t3/sensor/L3/c02";
        let positive = SensorCorruption::from(STRONG);
        let negative = SensorCorruption::from(STRONG.map(|x| -x));
        let picture = |corruption| corrupted(&mut stage(id, corruption), FrameSource::Wrist, 1);
        assert_eq!(picture(&positive), picture(&negative));
    }

    #[test]
    fn a_diagonal_motion_kernel_lies_on_the_diagonal() {
        let kernel = motion_kernel(3.2, PI / 4.0);
        assert_eq!(kernel.size, 3);
        assert_eq!(kernel.places, [(0, 0), (1, 1), (2, 2)]);
        assert_eq!(kernel.weight, 1.0 / 3.0);
    }

    #[test]
    fn gaussian_kernels_have_unit_sum() {
        for sigma in [0.2, 0.5, 2.386, 9.0] {
            let kernel = gaussian_kernel(sigma);
            let sum = kernel[0] + 2.0 * kernel[1..].iter().sum::<f64>();
            assert!((sum - 1.0).abs() < 1e-14, "{sigma}: {sum}");
        }
    }
}
