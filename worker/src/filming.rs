//! Filming a rollout, if a video is wanted: simulates it a second time from
//! the actions that were executed, and photographs both cameras after every
//! control step. So the rollout itself draws only what the policy looks at, a
//! video of failures costs nothing where the rollout succeeds, and what goes
//! wrong here costs the video, never the outcome.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::{fs, io};

use protocol::{ManifestRow, Realisation};
use sim::{Episode, Frame, SimError};

use crate::actor::Action;
use crate::message::Assignment;
use crate::rollout::Simulated;
use crate::stage::Stage;
use crate::video::{PANE_SIDE, VideoEncoder, VideoError};

/// Left and right in the video.
const CAMERAS: [&str; 2] = ["agentview", "robot0_eye_in_hand"];

/// Why there is no video.
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
        /// Which.
        path: PathBuf,
        /// What happened.
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
    /// What was simulated.
    pub(crate) row: &'a ManifestRow,
    /// Where the perturbation's random elements came from.
    pub(crate) realisation: Realisation,
    /// The actions that the robot executed.
    pub(crate) actions: &'a [Action],
    /// Whether the goal was reached.
    pub(crate) success: bool,
}

/// Films a rollout that has just been simulated, if a video of it is wanted;
/// returns the file. `progress` gets the control steps since the rollout
/// began, and may end the filming.
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
    let done = assignment.row.settle_steps + result.steps;
    let replay = Replay {
        row: &assignment.row,
        realisation: assignment.realisation,
        actions: &simulated.actions,
        success: result.success,
    };
    film_again(stage, replay, &video.file, &mut |step| {
        progress(done + step)
    })?;
    Ok(Some(video.file.clone()))
}

/// Films a rollout from its actions, to `file`. The pictures are the scene as it
/// is, without the sensor's corruption. `progress` is called after every control
/// step, settling included.
pub(crate) fn film_again(
    stage: &mut Stage<'_>,
    replay: Replay<'_>,
    file: &Path,
    progress: &mut dyn FnMut(u32) -> ControlFlow<()>,
) -> Result<(), FilmingError> {
    let mut encoder = VideoEncoder::new()?;
    let row = replay.row;
    let mut episode = stage.begin(row, replay.realisation)?;
    episode.settle()?;
    add_picture(&mut episode, &mut encoder)?;
    let mut success = false;
    for (done, action) in (1..).zip(replay.actions) {
        if progress(row.settle_steps + done).is_break() {
            return Err(FilmingError::Abandoned);
        }
        success = episode.step(action)?;
        add_picture(&mut episode, &mut encoder)?;
    }
    if success != replay.success {
        return Err(FilmingError::Differs);
    }
    fs::write(file, encoder.finish()?).map_err(|source| FilmingError::Write {
        path: file.to_owned(),
        source,
    })
}

/// Both cameras' pictures of the scene as it is, without the sensor's
/// corruption: left and right of a video.
pub(crate) fn photograph(episode: &mut Episode<'_>) -> Result<[Frame; 2], SimError> {
    let side = PANE_SIDE as u32;
    let left = episode.photograph(CAMERAS[0], side, side)?;
    let right = episode.photograph(CAMERAS[1], side, side)?;
    Ok([left, right])
}

fn add_picture(episode: &mut Episode<'_>, encoder: &mut VideoEncoder) -> Result<(), FilmingError> {
    let [left, right] = photograph(episode)?;
    Ok(encoder.add([&left.rgb, &right.rgb])?)
}
