//! Prepares observations for servers of other protocols: rotates frames and extracts robot
//! readings.

use proto::policy::{CameraRequest, Observation, StateField};

/// Side of the requested frames, pixels, as in LIBERO.
pub(super) const FRAME_SIDE: u32 = 256;

pub(super) fn camera(name: &str) -> CameraRequest {
    CameraRequest { name: name.to_owned(), width: FRAME_SIDE, height: FRAME_SIDE }
}

/// Returns a camera's frame, RGB of [`FRAME_SIDE`]² pixels, rotated by 180°: the simulator's row 0
/// is the bottom of the picture, and LIBERO's checkpoints were trained on frames that are upright
/// and mirrored.
pub(super) fn frame(observation: Option<&Observation>, camera: &str) -> Result<Vec<u8>, String> {
    let mut frames = observation.iter().flat_map(|observation| &observation.images);
    let frame = frames
        .find(|frame| frame.camera == camera)
        .filter(|frame| (frame.width, frame.height) == (FRAME_SIDE, FRAME_SIDE))
        .filter(|frame| frame.rgb.len() == 3 * (FRAME_SIDE * FRAME_SIDE) as usize);
    let frame = frame.ok_or_else(|| {
        format!("the observation has no frame of {camera} with {FRAME_SIDE} × {FRAME_SIDE} pixels")
    })?;
    Ok(rotated(&frame.rgb))
}

pub(super) fn rotated(rgb: &[u8]) -> Vec<u8> {
    rgb.rchunks_exact(3).flatten().copied().collect()
}

pub(super) fn reading<const N: usize>(
    observation: Option<&Observation>,
    field: StateField,
) -> Result<[f64; N], String> {
    numbers(observation, field)?.try_into().map_err(|_| lacks(field))
}

pub(super) fn numbers(
    observation: Option<&Observation>,
    field: StateField,
) -> Result<&[f64], String> {
    let mut readings = observation.into_iter().flat_map(|observation| &observation.state);
    let reading = readings.find(|reading| reading.field() == field);
    reading.map(|reading| reading.values.as_slice()).ok_or_else(|| lacks(field))
}

fn lacks(field: StateField) -> String {
    format!("the observation lacks {}", field.as_str_name())
}
