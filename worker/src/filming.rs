//! Filming a rollout, if a video is wanted: simulates it a second time from
//! the actions that were executed, and looks through both cameras after every
//! control step, as a policy does. So the rollout itself draws only what the
//! policy looks at, a video of failures costs nothing where the rollout succeeds,
//! and what goes wrong here costs the video, never the outcome.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::{fs, io};

use libero_ctrl::{ManifestRow, Realisation};
use policy_protocol::CAMERAS;
use sim::{CameraRequest, Episode, Frame, ObservationRequest, SimError};

use crate::actor::Action;
use crate::message::Assignment;
use crate::rollout::Simulated;
use crate::stage::Stage;
use crate::video::{PANE_SIDE, VideoEncoder, VideoError};

/// Reason for which there is no video.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FilmingError {
    /// The simulator failed, or cannot draw.
    #[error(transparent)]
    Simulator(#[from] SimError),
    /// The pictures could not be made a video.
    #[error(transparent)]
    Video(#[from] VideoError),
    /// The file cannot be written.
    #[error("write {}", path.display())]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: io::Error,
    },
    /// The same actions led somewhere else.
    #[error("simulate the rollout again: its goal held at another step; this is a defect")]
    Differs,
    /// It is no longer wanted.
    #[error("finish the video: it was abandoned")]
    Abandoned,
}

/// A rollout to simulate again.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Replay<'a> {
    /// Row that was simulated.
    pub(crate) row: &'a ManifestRow,
    /// Source of the perturbation's random elements.
    pub(crate) realisation: Realisation,
    /// The actions that the robot executed.
    pub(crate) actions: &'a [Action],
    /// After how many of them perturbations were lifted, if they were.
    pub(crate) lifted_after: Option<usize>,
    /// True if the goal was reached.
    pub(crate) success: bool,
}

/// Films a rollout that has just been simulated, if a video of it is wanted;
/// returns the file. `progress` gets the number of pictures so far, and may end
/// the filming.
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

/// Films a rollout from its actions, to `file`: at rest and after every action,
/// what [`observe_both`] sees. `progress` gets the number of pictures so far, and
/// may end the filming.
pub(crate) fn film_again(
    stage: &mut Stage<'_>,
    replay: Replay<'_>,
    file: &Path,
    progress: &mut dyn FnMut(u32) -> ControlFlow<()>,
) -> Result<(), FilmingError> {
    let mut encoder = VideoEncoder::new()?;
    let mut pictures = 0;
    watch_again(stage, replay, &mut |[left, right]| {
        encoder.add([&left.rgb, &right.rgb])?;
        pictures += 1;
        match progress(pictures) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(FilmingError::Abandoned),
        }
    })?;
    fs::write(file, encoder.finish()?).map_err(|source| FilmingError::Write {
        path: file.to_owned(),
        source,
    })
}

/// Simulates a rollout from its actions, and shows what [`observe_both`] sees at
/// rest and after every action.
pub(crate) fn watch_again(
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
    match success == replay.success {
        true => Ok(()),
        false => Err(FilmingError::Differs),
    }
}

/// Renders both cameras at [`PANE_SIDE`] as a policy would see them: left and
/// right of a video. To a policy that asks for another size, the sensor's
/// corruption is of that size; it grows with the picture, and its noise has other
/// values.
pub(crate) fn observe_both(episode: &mut Episode<'_>) -> Result<[Frame; 2], SimError> {
    let camera = |name: &str| CameraRequest {
        name: name.to_owned(),
        width: PANE_SIDE as u32,
        height: PANE_SIDE as u32,
    };
    let request = ObservationRequest {
        cameras: CAMERAS.map(camera).to_vec(),
        privileged: false,
    };
    let frames = episode.observe(&request)?.frames;
    Ok(frames.try_into().expect("as many as were asked for"))
}
