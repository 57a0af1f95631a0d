//! Encodes videos of rollouts: both cameras side by side at 20 frames per second, as H.264 in MP4
//! for browsers.

use muxide::api::{Muxer, MuxerBuilder, MuxerError, VideoCodec};
use openh264::OpenH264API;
use openh264::encoder::{
    Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, QpRange, RateControlMode,
    VuiConfig,
};
use openh264::formats::YUVBuffer;
use sim::bt709;

pub const PANE_SIDE: usize = 256;
pub const FRAMES_PER_SEC: f64 = 20.0;

const WIDTH: usize = 2 * PANE_SIDE;
const HEIGHT: usize = PANE_SIDE;
const PANE_BYTES: usize = PANE_SIDE * PANE_SIDE * 3;
/// Constant quantiser of every frame: rate control would blur the brief moment that a viewer looks
/// for. At 26, two panes take about 3 kB per frame.
const QUANTISER: u8 = 26;
/// Frames between key frames, to which players can seek: two seconds.
const KEYFRAME_EVERY: u32 = 40;

#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    #[error("add a picture of {given} bytes to a video of {PANE_BYTES} bytes per camera")]
    PaneSize { given: usize },
    #[error("encode a video: OpenH264 fails with code {code}")]
    Encode { code: i64 },
    #[error("write a video as MP4")]
    Mux(#[from] MuxerError),
}

impl From<openh264::Error> for VideoError {
    fn from(error: openh264::Error) -> Self {
        let code = error.native_code();
        Self::Encode { code }
    }
}

pub struct VideoEncoder {
    encoder: Encoder,
    muxer: Muxer<Vec<u8>>,
    frames: u32,
}

impl VideoEncoder {
    pub fn new() -> Result<Self, VideoError> {
        let config = EncoderConfig::new()
            .skip_frames(false)
            .rate_control_mode(RateControlMode::Off)
            .qp(QpRange::new(QUANTISER, QUANTISER))
            .adaptive_quantization(false)
            .max_frame_rate(FrameRate::from_hz(FRAMES_PER_SEC as f32))
            .intra_frame_period(IntraFramePeriod::from_num_frames(KEYFRAME_EVERY))
            .scene_change_detect(false)
            // The other cores belong to other slots.
            .num_threads(1)
            .vui(VuiConfig::bt709());
        let encoder = Encoder::with_api_config(OpenH264API::from_source(), config)?;
        let (width, height) = (WIDTH as u32, HEIGHT as u32);
        let muxer = MuxerBuilder::new(Vec::new())
            .video(VideoCodec::H264, width, height, FRAMES_PER_SEC)
            .build()?;
        Ok(Self { encoder, muxer, frames: 0 })
    }

    /// Adds a frame of the video, which shows the picture of the first camera on the left and that
    /// of the second on the right. Pictures are RGB, 8 bits, [`PANE_SIDE`]², row 0 at the bottom,
    /// as the simulator renders them.
    pub fn add(&mut self, panes: [&[u8]; 2]) -> Result<(), VideoError> {
        if let Some(pane) = panes.iter().find(|pane| pane.len() != PANE_BYTES) {
            return Err(VideoError::PaneSize { given: pane.len() });
        }
        let picture = YUVBuffer::from_vec(bt709(panes, PANE_SIDE), WIDTH, HEIGHT);
        let encoded = self.encoder.encode(&picture)?;
        let keyframe = matches!(encoded.frame_type(), FrameType::IDR | FrameType::I);
        let shown_at_secs = f64::from(self.frames) / FRAMES_PER_SEC;
        self.muxer.write_video(shown_at_secs, &encoded.to_vec(), keyframe)?;
        self.frames += 1;
        Ok(())
    }

    pub fn finish(mut self) -> Result<Vec<u8>, VideoError> {
        self.muxer.finish_in_place()?;
        Ok(self.muxer.into_writer())
    }
}

#[cfg(test)]
mod tests {
    use openh264::decoder::Decoder;
    use openh264::formats::YUVSource;

    use super::*;

    fn pane(top: [u8; 3], bottom: [u8; 3]) -> Vec<u8> {
        let rows = PANE_SIDE * PANE_SIDE / 2;
        let mut pixels = bottom.repeat(rows);
        pixels.extend(top.repeat(rows));
        pixels
    }

    #[test]
    fn a_video_decodes_to_the_frames_that_were_added() {
        let mut encoder = VideoEncoder::new().expect("starts");
        let still = pane([200, 60, 30], [20, 120, 220]);
        for shade in 0..50 {
            let moving = pane([shade * 5; 3], [0, shade * 4, 90]);
            encoder.add([&still, &moving]).expect("encodes");
        }
        let mp4 = encoder.finish().expect("muxes");
        assert_eq!(&mp4[4..8], b"ftyp");
        let samples = mp4_samples(&mp4);
        assert_eq!(samples.len(), 50);

        let mut decoder = Decoder::new().expect("a decoder");
        let (sps, pps) = parameter_sets(&mp4);
        for set in [sps, pps] {
            decoder.decode(&annex_b(&set)).expect("a parameter set");
        }
        let picture = decoder.decode(&units(samples[0])).expect("a picture");
        let picture = picture.expect("the first picture");
        assert_eq!(picture.dimensions(), (WIDTH, HEIGHT));
        let expected = bt709([&still, &pane([0; 3], [0, 0, 90])], PANE_SIDE);
        let off = (0..HEIGHT)
            .flat_map(|y| (0..WIDTH).map(move |x| (x, y)))
            .map(|(x, y)| {
                picture.y()[y * picture.strides().0 + x].abs_diff(expected[y * WIDTH + x])
            })
            .max();
        assert!(off <= Some(8), "luma off by {off:?}");
    }

    #[test]
    fn a_picture_of_another_size_is_refused() {
        let mut encoder = VideoEncoder::new().expect("starts");
        let error = encoder.add([&[0; 12], &[0; 12]]).expect_err("too small");
        assert!(error.to_string().contains("12 bytes"), "{error}");
    }

    /// Returns the payload of the first box called `name`, at any depth.
    fn find<'a>(mp4: &'a [u8], name: &[u8; 4]) -> &'a [u8] {
        let at = mp4.windows(4).position(|window| window == name);
        let at = at.unwrap_or_else(|| panic!("no box {}", String::from_utf8_lossy(name)));
        let size = u32::from_be_bytes(mp4[at - 4..at].try_into().expect("4 bytes")) as usize;
        &mp4[at + 4..at - 4 + size]
    }

    fn number(bytes: &[u8], at: usize) -> usize {
        u32::from_be_bytes(bytes[at..at + 4].try_into().expect("4 bytes")) as usize
    }

    fn mp4_samples(mp4: &[u8]) -> Vec<&[u8]> {
        let sizes = find(mp4, b"stsz");
        let mut rest = find(mp4, b"mdat");
        (0..number(sizes, 8))
            .map(|sample| {
                let size = number(sizes, 12 + 4 * sample);
                let (head, tail) = rest.split_at(size);
                rest = tail;
                head
            })
            .collect()
    }

    fn parameter_sets(mp4: &[u8]) -> (Vec<u8>, Vec<u8>) {
        let config = find(mp4, b"avcC");
        let size = usize::from(u16::from_be_bytes([config[6], config[7]]));
        let sps = config[8..8 + size].to_vec();
        let rest = &config[8 + size + 1..];
        let size = usize::from(u16::from_be_bytes([rest[0], rest[1]]));
        (sps, rest[2..2 + size].to_vec())
    }

    fn annex_b(unit: &[u8]) -> Vec<u8> {
        [&[0, 0, 0, 1], unit].concat()
    }

    /// Converts a sample's length-prefixed units to a byte stream.
    fn units(mut sample: &[u8]) -> Vec<u8> {
        let mut stream = Vec::new();
        while !sample.is_empty() {
            let size = number(sample, 0);
            stream.extend(annex_b(&sample[4..4 + size]));
            sample = &sample[4 + size..];
        }
        stream
    }
}
