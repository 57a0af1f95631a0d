//! Recording a rollout, if anybody wants a video: photographs both cameras
//! after every control step. The pictures are the scene as it is, without the
//! sensor's corruption. A video that cannot be made costs the video, never the
//! outcome.

use std::path::{Path, PathBuf};

use sim::{Episode, SimError};

use crate::video::{PANE_SIDE, Recorder, VideoError};

/// Left and right in the video.
const CAMERAS: [&str; 2] = ["agentview", "robot0_eye_in_hand"];

/// A video in the making, or none.
pub(crate) struct Recording(Option<(Recorder, PathBuf)>);

impl Recording {
    /// Starts a recording that will be written to `file`.
    pub(crate) fn begin(file: Option<&Path>) -> Self {
        let Some(file) = file else { return Self(None) };
        match Recorder::new() {
            Ok(recorder) => Self(Some((recorder, file.to_owned()))),
            Err(error) => {
                give_up(&error);
                Self(None)
            }
        }
    }

    /// Adds the scene as it is now.
    ///
    /// # Errors
    /// If the simulator cannot draw.
    pub(crate) fn add(&mut self, episode: &mut Episode<'_>) -> Result<(), SimError> {
        let Some((recorder, _)) = &mut self.0 else {
            return Ok(());
        };
        let side = PANE_SIDE as u32;
        let left = episode.photograph(CAMERAS[0], side, side)?;
        let right = episode.photograph(CAMERAS[1], side, side)?;
        if let Err(error) = recorder.add([&left.rgb, &right.rgb]) {
            give_up(&error);
            self.0 = None;
        }
        Ok(())
    }

    /// Writes the file; returns where it is, if there is one.
    pub(crate) fn finish(self) -> Option<PathBuf> {
        let (recorder, file) = self.0?;
        let mp4 = recorder.finish().map_err(|error| give_up(&error)).ok()?;
        match std::fs::write(&file, mp4) {
            Ok(()) => Some(file),
            Err(error) => {
                tracing::warn!("no video: failed to write {}: {error}", file.display());
                None
            }
        }
    }
}

fn give_up(error: &VideoError) {
    let cause = std::error::Error::source(error).map(|cause| format!(": {cause}"));
    tracing::warn!("no video: failed to {error}{}", cause.unwrap_or_default());
}
