//! Observations for servers of other protocols: frames turned upright, and
//! robot readings.

use proto::policy::{CameraRequest, Observation, StateField};

/// Side of the frames asked for, pixels: LIBERO's.
pub(super) const FRAME_SIDE: u32 = 256;

/// The frames that are asked for of a camera.
pub(super) fn camera(name: &str) -> CameraRequest {
    CameraRequest {
        name: name.to_owned(),
        width: FRAME_SIDE,
        height: FRAME_SIDE,
    }
}

/// A camera's frame, RGB of [`FRAME_SIDE`]² pixels, turned by 180°: the
/// simulator's row 0 is the BOTTOM of the picture, and LIBERO's checkpoints were
/// trained on what is upright and mirrored.
///
/// # Errors
/// If there is no frame of that size.
pub(super) fn frame(observation: Option<&Observation>, camera: &str) -> Result<Vec<u8>, String> {
    let mut frames = observation.iter().flat_map(|it| &it.images);
    let frame = frames
        .find(|it| it.camera == camera)
        .filter(|it| (it.width, it.height) == (FRAME_SIDE, FRAME_SIDE))
        .filter(|it| it.rgb.len() == 3 * (FRAME_SIDE * FRAME_SIDE) as usize);
    let frame = frame.ok_or_else(|| format!("the observation has no frame of {camera}"))?;
    Ok(turned(&frame.rgb))
}

/// A frame turned by 180°.
pub(super) fn turned(rgb: &[u8]) -> Vec<u8> {
    rgb.rchunks_exact(3).flatten().copied().collect()
}

/// A reading of `N` numbers.
///
/// # Errors
/// If there is no reading of so many numbers.
pub(super) fn reading<const N: usize>(
    observation: Option<&Observation>,
    field: StateField,
) -> Result<[f64; N], String> {
    let mut readings = observation.iter().flat_map(|it| &it.state);
    let reading = readings.find(|it| it.field() == field);
    reading
        .and_then(|it| it.values.as_slice().try_into().ok())
        .ok_or_else(|| format!("the observation lacks {}", field.as_str_name()))
}
