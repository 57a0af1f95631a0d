//! Recording a rollout, if anybody wants a video: simulates it a second time
//! from the actions that were executed, and photographs both cameras after
//! every control step. So the rollout itself draws only what the policy looks
//! at, a video of failures costs nothing where the rollout succeeds, and what
//! goes wrong here costs the video, never the outcome.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::{fs, io};

use protocol::{ManifestRow, Realisation};
use sim::{Episode, Frame, SimError};

use crate::policy::Action;
use crate::rollout::Stage;
use crate::video::{PANE_SIDE, Recorder, VideoError};

/// Left and right in the video.
const CAMERAS: [&str; 2] = ["agentview", "robot0_eye_in_hand"];

/// Why there is no video.
#[derive(Debug, thiserror::Error)]
pub(crate) enum RecordError {
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
    /// Nobody wants it any more.
    #[error("finish the video: it was abandoned")]
    Abandoned,
}

/// A rollout that is over.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Take<'a> {
    /// What was simulated.
    pub(crate) row: &'a ManifestRow,
    /// Where the perturbation's random elements came from.
    pub(crate) realisation: Realisation,
    /// What the robot was told.
    pub(crate) actions: &'a [Action],
    /// Whether the goal was reached.
    pub(crate) success: bool,
}

/// Records a rollout again, to `file`. The pictures are the scene as it is,
/// without the sensor's corruption. `step` is called after every control step,
/// settling included.
pub(crate) fn record(
    stage: &mut Stage<'_>,
    take: Take<'_>,
    file: &Path,
    step: &mut dyn FnMut(u32) -> ControlFlow<()>,
) -> Result<(), RecordError> {
    let mut recorder = Recorder::new()?;
    let row = take.row;
    let mut episode = stage.begin(row, take.realisation)?;
    episode.settle()?;
    add_picture(&mut episode, &mut recorder)?;
    let mut success = false;
    for (done, action) in (1..).zip(take.actions) {
        if step(row.settle_steps + done).is_break() {
            return Err(RecordError::Abandoned);
        }
        success = episode.step(action)?;
        add_picture(&mut episode, &mut recorder)?;
    }
    if success != take.success {
        return Err(RecordError::Differs);
    }
    fs::write(file, recorder.finish()?).map_err(|source| RecordError::Write {
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

fn add_picture(episode: &mut Episode<'_>, recorder: &mut Recorder) -> Result<(), RecordError> {
    let [left, right] = photograph(episode)?;
    Ok(recorder.add([&left.rgb, &right.rgb])?)
}
