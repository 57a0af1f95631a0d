//! Frames against the original's.

use anyhow::{Context, Result, ensure};
use sim::{Drawer, Environment};

use super::reference::ReferenceTask;

const CAMERAS: [&str; 2] = ["agentview", "robot0_eye_in_hand"];
const SIZE: u32 = 256;

/// Compares frames as the motion passes their instants.
pub(super) struct Comparison<'a> {
    task: &'a ReferenceTask,
    drawer: &'a Drawer,
    equal: f64,
    channel: u8,
    seen: usize,
}

impl<'a> Comparison<'a> {
    pub(super) fn new(task: &'a ReferenceTask, drawer: &'a Drawer) -> Self {
        Self {
            task,
            drawer,
            equal: 1.0,
            channel: 0,
            seen: 0,
        }
    }

    /// Compares both cameras after a step, where the reference has frames.
    pub(super) fn see(
        &mut self,
        environment: &mut Environment,
        init: usize,
        step: usize,
    ) -> Result<()> {
        for camera in CAMERAS {
            let path = self
                .task
                .path(&format!("img_{init}_{step:02}_{camera}.png"));
            if !path.is_file() {
                continue;
            }
            let expected = image::open(&path)
                .with_context(|| format!("read {}", path.display()))?
                .into_rgb8();
            ensure!(
                expected.dimensions() == (SIZE, SIZE),
                "{} is not 256 × 256",
                path.display()
            );
            let frame = environment.draw(self.drawer, camera, SIZE, SIZE)?;
            let mut equal = 0;
            for (ours, theirs) in frame.rgb.chunks_exact(3).zip(expected.chunks_exact(3)) {
                equal += usize::from(ours == theirs);
                for (a, b) in ours.iter().zip(theirs) {
                    self.channel = self.channel.max(a.abs_diff(*b));
                }
            }
            self.equal = self.equal.min(equal as f64 / f64::from(SIZE * SIZE));
            self.seen += 1;
        }
        Ok(())
    }

    /// Smallest share of equal pixels and largest channel difference; none if
    /// the reference has no frames.
    pub(super) fn result(&self) -> Option<(f64, u8)> {
        (self.seen > 0).then_some((self.equal, self.channel))
    }
}
