//! Makes the video of a rollout, if one is wanted: simulates the rollout a second time from the
//! executed actions and renders both cameras after every control step, as a policy sees them. The
//! rollout itself renders only the policy's frames, videos of failures cost nothing when the
//! rollout succeeds, and an error here loses the video but never the outcome.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::{fs, io};

use crate::video::{PANE_SIDE, VideoEncoder, VideoError};
use benchmark::{ManifestRow, Realisation};
use proto::checks::CAMERAS;
use sim::{CameraRequest, Episode, Frame, ObservationRequest, SimError};

use crate::actor::Action;
use crate::message::Assignment;
use crate::rollout::Simulated;
use crate::stage::Stage;

/// Reason why a rollout has no video.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FilmingError {
    #[error(transparent)]
    Simulator(#[from] SimError),
    #[error(transparent)]
    Video(#[from] VideoError),
    #[error("write {}", path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error(
        "simulate the rollout again: its outcome differs from the first time; this is a defect"
    )]
    Differs,
    #[error("finish the video: it was abandoned")]
    Abandoned,
}

/// A rollout to simulate again.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Replay<'a> {
    /// Manifest row that was simulated.
    pub(crate) row: &'a ManifestRow,
    /// Source of the perturbation's random elements.
    pub(crate) realisation: Realisation,
    /// The actions that the robot executed.
    pub(crate) actions: &'a [Action],
    /// Number of actions after which the perturbations were lifted; `None` if they were not.
    pub(crate) lifted_after: Option<usize>,
    /// True if the goal was reached.
    pub(crate) success: bool,
}

/// Films a rollout that has just been simulated, if a video of it is wanted; returns the video's
/// path. `progress` receives the number of frames so far, and may abandon the video.
pub(crate) fn film(
    stage: &mut Stage<'_>,
    assignment: &Assignment,
    simulated: &Simulated,
    progress: &mut dyn FnMut(u32) -> ControlFlow<()>,
) -> Result<Option<PathBuf>, FilmingError> {
    let result = &simulated.finished.result;
    let Some(video) = assignment.video_of(result.success) else {
        return Ok(None);
    };
    let replay = Replay {
        row: &assignment.row,
        realisation: assignment.realisation,
        actions: &simulated.actions,
        lifted_after: None,
        success: result.success,
    };
    film_again(stage, replay, &video.file, progress)?;
    Ok(Some(video.file.clone()))
}

/// Films a rollout from its actions, to `file`: the frames of [`observe_both`] at rest and after
/// every action. `progress` receives the number of frames so far, and may abandon the video.
pub(crate) fn film_again(
    stage: &mut Stage<'_>,
    replay: Replay<'_>,
    file: &Path,
    progress: &mut dyn FnMut(u32) -> ControlFlow<()>,
) -> Result<(), FilmingError> {
    let mut encoder = VideoEncoder::new()?;
    let mut pictures = 0;
    render_again(stage, replay, &mut |[left, right]| {
        encoder.add([&left.rgb, &right.rgb])?;
        pictures += 1;
        match progress(pictures) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(FilmingError::Abandoned),
        }
    })?;
    fs::write(file, encoder.finish()?)
        .map_err(|source| FilmingError::Write { path: file.to_owned(), source })
}

/// Simulates a rollout from its actions, and passes the frames of [`observe_both`] to `show`, at
/// rest and after every action.
pub(crate) fn render_again(
    stage: &mut Stage<'_>,
    replay: Replay<'_>,
    show: &mut dyn FnMut([Frame; 2]) -> Result<(), FilmingError>,
) -> Result<(), FilmingError> {
    let mut episode = stage.begin(replay.row, replay.realisation)?;
    episode.settle()?;
    show(observe_both(&mut episode)?)?;
    let mut success = false;
    for (step, action) in replay.actions.iter().enumerate() {
        if replay.lifted_after == Some(step) {
            episode.lift();
        }
        success = episode.step(action)?;
        show(observe_both(&mut episode)?)?;
    }
    if success == replay.success { Ok(()) } else { Err(FilmingError::Differs) }
}

/// Renders both cameras at [`PANE_SIDE`] as a policy sees them, for the left and right halves of a
/// video. If the policy asks for another size, the policy's frames differ from these in the
/// sensor's corruption, which scales with the frame, and in the values of the noise.
pub(crate) fn observe_both(episode: &mut Episode<'_>) -> Result<[Frame; 2], SimError> {
    let camera = |name: &str| CameraRequest {
        name: name.to_owned(),
        width: PANE_SIDE as u32,
        height: PANE_SIDE as u32,
    };
    let request = ObservationRequest { cameras: CAMERAS.map(camera).to_vec(), privileged: false };
    let frames = episode.observe(&request)?.frames;
    Ok(frames.try_into().expect("one frame for each requested camera"))
}
