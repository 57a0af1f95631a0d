//! Captures frames and the trace of a running rollout, and writes them afterwards as PNG and NPZ.
//! A frame that cannot be rendered is logged; the rollout continues.

use std::fs;
use std::ops::ControlFlow;
use std::path::Path;

use sim::{Episode, Frame, Observation};
use transport::chain;

use super::error::{SingleError, write_error};
use super::trace::Trace;
use crate::filming::observe_both;
use crate::picture::Picture;
use crate::rollout::{Step, Watcher};

/// Trace and frames of one rollout.
pub(super) struct Capture {
    renders_ends: bool,
    trace: Trace,
    /// Frames of both cameras, before the first control step and after the last one.
    ends: Vec<(&'static str, Vec<Frame>)>,
    first_query: Option<(u32, Vec<Frame>)>,
    last_query: Option<(u32, Vec<Frame>)>,
}

impl Capture {
    /// Creates a capture; the first and the last frame are rendered only if `renders_ends`.
    pub(super) fn new(renders_ends: bool) -> Self {
        Self {
            renders_ends,
            trace: Trace::default(),
            ends: Vec::new(),
            first_query: None,
            last_query: None,
        }
    }

    /// Writes `frames/` and `trace.npz`. A folder or trace that would be empty is not written.
    pub(super) fn write(&self, output: &Path) -> Result<(), SingleError> {
        let queries = self.first_query.iter().chain(&self.last_query);
        let queries = queries.map(|(query, frames)| (format!("query-{query:03}"), frames));
        let ends = self.ends.iter();
        let ends = ends.map(|(end, frames)| ((*end).to_owned(), frames));
        let folder = output.join("frames");
        for (title, frames) in ends.chain(queries) {
            for frame in frames {
                fs::create_dir_all(&folder).map_err(|source| write_error(&folder, source))?;
                let path = folder.join(format!("{title}-{}.png", frame.camera));
                let saved = Picture::upright(frame).save(&path);
                saved.map_err(|source| write_error(&path, source))?;
            }
        }
        if self.trace.is_empty() {
            return Ok(());
        }
        let path = output.join("trace.npz");
        let written = self.trace.write(&path);
        written.map_err(|source| write_error(&path, source))
    }

    fn capture_end(&mut self, title: &'static str, episode: &mut Episode<'_>) {
        if !self.renders_ends {
            return;
        }
        match observe_both(episode) {
            Ok(frames) => self.ends.push((title, frames.into())),
            Err(error) => {
                let problem = chain(&error);
                tracing::warn!("no {title} picture of the rollout: failed to {problem}");
            }
        }
    }
}

impl Watcher for Capture {
    fn progress(&mut self, _control_steps: u32) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    fn observed(&mut self, query_index: u32, observation: &Observation) {
        let query = Some((query_index, observation.frames.clone()));
        if self.first_query.is_none() {
            self.first_query = query;
        } else {
            self.last_query = query;
        }
    }

    fn moved(&mut self, step: Option<&Step>, episode: &mut Episode<'_>) {
        self.trace.add(step, episode.environment());
        if step.is_none() {
            self.capture_end("first", episode);
        }
    }

    fn ended(&mut self, episode: &mut Episode<'_>) {
        self.capture_end("last", episode);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_written_upright() {
        let frame = Frame {
            camera: "agentview".to_owned(),
            width: 1,
            height: 2,
            rgb: vec![1, 2, 3, 4, 5, 6],
        };
        assert_eq!(Picture::upright(&frame).pixels, [[4, 5, 6], [1, 2, 3]]);
    }
}
