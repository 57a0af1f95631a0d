//! Comparison of frames with the original's: measures of agreement and their limits.

use std::fmt;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use image::RgbImage;
use proto::checks::CAMERAS;
use sim::{Drawer, Environment, Frame};

use super::reference::ReferenceTask;

/// Side of the reference's frames, pixels.
const SIZE: u32 = 256;
/// Largest difference at which a pixel counts as close, grey levels.
pub const CLOSE_LEVELS: u8 = 2;

/// Name of the OpenGL driver that rendered the reference's frames, including its version and
/// the vector width.
const REFERENCE_DRIVER: &str = "llvmpipe (LLVM 15.0.6, 256 bits)";

/// Relation of the reference's renderer to ours. The original renders through OpenGL, whose
/// drivers give different bits on different processors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RendererRelation {
    /// OpenGL with the reference's driver on another machine.
    AnotherMachine,
    /// OpenGL with another driver, or with the same driver and other processor instructions.
    AnotherDriver,
    /// OpenGL on the machine that recorded the reference.
    ThisMachine,
    AnotherRenderer,
}

/// Limits of the software renderer's differences from frames that llvmpipe drew on an Intel
/// processor, whose arithmetic it reproduces.
pub const SAME_ARITHMETIC: FrameLimits =
    FrameLimits { relation: RendererRelation::AnotherRenderer, equal: 0.999, close: 0.9999 };

/// Reads a picture, with the lowest row first, as in frames. The scripts record it upright.
pub fn read_upright(path: &Path) -> Result<RgbImage> {
    let picture = image::open(path).with_context(|| format!("read {}", path.display()))?;
    Ok(picture.flipv().into_rgb8())
}

/// Limits on the difference of frames from the reference's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameLimits {
    /// Kind of comparison, which determines the limits and appears in messages.
    pub relation: RendererRelation,
    /// Share of pixels that must be equal.
    pub equal: f64,
    /// Share of pixels whose channels must all be within [`CLOSE_LEVELS`].
    pub close: f64,
}

impl RendererRelation {
    pub fn for_drawer(drawer: &Drawer, frames_of_this_machine: bool) -> Self {
        match drawer {
            Drawer::Software => Self::AnotherRenderer,
            Drawer::Gl(_) if frames_of_this_machine => Self::ThisMachine,
            Drawer::Gl(_) if drawer.name() == REFERENCE_DRIVER => Self::AnotherMachine,
            Drawer::Gl(_) => Self::AnotherDriver,
        }
    }

    /// Returns the limits; docs/dev/FIDELITY.md has the measurements behind them.
    pub fn limits(self) -> FrameLimits {
        let (equal, close) = match self {
            Self::ThisMachine => (1.0, 1.0),
            Self::AnotherMachine => (0.94, 1.0),
            // The worst frame of the 23 recorded tasks, rendered without AVX and fused
            // multiply-adds, has 0.9962.
            Self::AnotherDriver => (0.94, 0.995),
            Self::AnotherRenderer => (0.94, 0.9999),
        };
        FrameLimits { relation: self, equal, close }
    }
}

/// Describes the reference frames, and the reason for their bounds.
impl fmt::Display for RendererRelation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::AnotherMachine => {
                "frames that the same OpenGL driver rendered on another machine, within bounds, \
                 because the driver's bits depend on the processor"
            }
            Self::AnotherDriver => {
                "frames that another OpenGL driver rendered, or the same one with other processor \
                 instructions, within bounds: roundings differ, and where surfaces coincide they \
                 decide which one is visible"
            }
            Self::ThisMachine => {
                "frames that OpenGL rendered on this machine, bit for bit, because the same driver \
                 renders the same bits; without --frames-of-this-machine, bounds apply"
            }
            Self::AnotherRenderer => {
                "frames that OpenGL rendered, which the software renderer must match within \
                 bounds: drivers differ too, and at an edge or where surfaces coincide one \
                 rounding decides which surface is visible"
            }
        })
    }
}

#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameFindings {
    /// The frame with the smallest share of equal pixels.
    pub equal: Least,
    /// The frame with the smallest share of pixels within [`CLOSE_LEVELS`].
    pub close: Least,
    /// Largest difference of any channel, grey levels.
    pub largest: u8,
}

/// The smallest share and its location.
#[derive(Debug, Clone, PartialEq)]
pub struct Least {
    /// The share, 0..1.
    pub share: f64,
    /// Name of the frame; empty while every frame has a share of 1.
    pub place: String,
}

impl Default for Least {
    fn default() -> Self {
        Self { share: 1.0, place: String::new() }
    }
}

impl Least {
    /// Returns the share in percent, rounded down to three decimals, so that 100 means all.
    pub fn percent(&self) -> f64 {
        (self.share * 1e5).floor() / 1e3
    }

    fn add(&mut self, share: f64, place: &str) {
        if share < self.share {
            *self = Self { share, place: place.to_owned() };
        }
    }
}

impl fmt::Display for FrameFindings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:.3} % equal, {:.3} % within {CLOSE_LEVELS} levels, largest {}",
            self.equal.percent(),
            self.close.percent(),
            self.largest
        )
    }
}

impl FrameFindings {
    pub fn add(&mut self, ours: &[u8], theirs: &[u8], place: &str) {
        let (mut equal, mut close, mut pixels) = (0_u32, 0_u32, 0_u32);
        for (ours, theirs) in ours.chunks_exact(3).zip(theirs.chunks_exact(3)) {
            let difference = ours.iter().zip(theirs).map(|(a, b)| a.abs_diff(*b));
            let difference = difference.max().unwrap_or_default();
            equal += u32::from(difference == 0);
            close += u32::from(difference <= CLOSE_LEVELS);
            pixels += 1;
            self.largest = self.largest.max(difference);
        }
        let share = |count: u32| f64::from(count) / f64::from(pixels);
        self.equal.add(share(equal), place);
        self.close.add(share(close), place);
    }

    pub fn merge(&mut self, other: &Self) {
        self.equal.add(other.equal.share, &other.equal.place);
        self.close.add(other.close.share, &other.close.place);
        self.largest = self.largest.max(other.largest);
    }

    /// Returns descriptions of the violated limits, including the reason for each limit.
    pub fn violations(&self, limits: &FrameLimits) -> Vec<String> {
        let mut found = Vec::new();
        let mut check = |least: &Least, limit: f64, condition: &str| {
            if least.share < limit {
                found.push(format!(
                    "frames: {:.4} % of pixels {condition} at {}, less than {:.4} %; compared with {}",
                    least.share * 100.0,
                    least.place,
                    limit * 100.0,
                    limits.relation
                ));
            }
        };
        check(&self.equal, limits.equal, "are equal");
        let close = format!(
            "are within {CLOSE_LEVELS} levels (the largest difference is {})",
            self.largest
        );
        check(&self.close, limits.close, &close);
        found
    }
}

/// Compares frames at the recorded steps of a motion.
pub(super) struct Comparison<'a> {
    task: &'a ReferenceTask,
    drawer: &'a Drawer,
    findings: FrameFindings,
    compared: usize,
}

impl<'a> Comparison<'a> {
    pub(super) fn new(task: &'a ReferenceTask, drawer: &'a Drawer) -> Self {
        Self { task, drawer, findings: FrameFindings::default(), compared: 0 }
    }

    /// Compares both cameras after a step if the reference has frames of it.
    pub(super) fn compare(
        &mut self,
        environment: &mut Environment,
        init: usize,
        step: usize,
    ) -> Result<()> {
        for camera in CAMERAS {
            let path = self.task.path(&format!("img_{init}_{step:02}_{camera}.png"));
            if !path.is_file() {
                continue;
            }
            let expected =
                image::open(&path).with_context(|| format!("read {}", path.display()))?.into_rgb8();
            ensure!(expected.dimensions() == (SIZE, SIZE), "{} is not 256 × 256", path.display());
            let Frame { rgb, .. } = environment.draw(self.drawer, camera, SIZE, SIZE)?;
            let place = format!("state {init}, step {step}, {camera}");
            self.findings.add(&rgb, expected.as_raw(), &place);
            self.compared += 1;
        }
        Ok(())
    }

    /// Returns the findings; `None` if the reference has no frames.
    pub(super) fn result(self) -> Option<FrameFindings> {
        (self.compared > 0).then_some(self.findings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: usize = 10_000;

    /// Compares a frame with a black one: for each `(count, levels)`, the next `count` pixels
    /// differ by `levels`.
    fn findings(differing: &[(usize, u8)]) -> FrameFindings {
        let mut ours = vec![0; PIXELS * 3];
        let mut next = 0;
        for &(count, levels) in differing {
            for pixel in ours.chunks_exact_mut(3).skip(next).take(count) {
                pixel[1] = levels;
            }
            next += count;
        }
        let mut findings = FrameFindings::default();
        findings.add(&ours, &vec![0; PIXELS * 3], "state 0, step 60, agentview");
        findings
    }

    fn violations(differing: &[(usize, u8)], relation: RendererRelation) -> Vec<String> {
        findings(differing).violations(&relation.limits())
    }

    #[test]
    fn frames_of_another_machine_are_held_to_bounds() {
        let relation = RendererRelation::AnotherMachine;
        assert_eq!(violations(&[(600, 2)], relation), [""; 0]);
        let found = violations(&[(601, 2)], relation);
        assert_eq!(found.len(), 1);
        assert!(
            found[0].contains("93.9900 % of pixels are equal at state 0, step 60, agentview")
                && found[0].contains("less than 94.0000 %")
                && found[0].contains("on another machine"),
            "{found:?}"
        );
        let found = violations(&[(1, 3)], relation);
        assert_eq!(found.len(), 1);
        assert!(
            found[0].contains("99.9900 % of pixels are within 2 levels")
                && found[0].contains("the largest difference is 3"),
            "{found:?}"
        );
    }

    #[test]
    fn another_driver_may_differ_by_more_where_surfaces_coincide() {
        let relation = RendererRelation::AnotherDriver;
        assert_eq!(violations(&[(50, 19), (500, 2)], relation), [""; 0]);
        let found = violations(&[(51, 19)], relation);
        assert_eq!(found.len(), 1);
        assert!(found[0].contains("another OpenGL driver"), "{found:?}");
    }

    #[test]
    fn frames_of_this_machine_must_be_equal() {
        assert_eq!(violations(&[], RendererRelation::ThisMachine), [""; 0]);
        let found = violations(&[(1, 1)], RendererRelation::ThisMachine);
        assert_eq!(found.len(), 1);
        assert!(found[0].contains("bit for bit"), "{found:?}");
    }

    #[test]
    fn the_software_renderer_may_differ_by_more_in_single_pixels_only() {
        let relation = RendererRelation::AnotherRenderer;
        assert_eq!(violations(&[(1, 255), (500, 2)], relation), [""; 0]);
        let found = violations(&[(2, 3)], relation);
        assert_eq!(found.len(), 1);
        assert!(found[0].contains("the software renderer"), "{found:?}");
        assert_eq!(violations(&[(601, 9)], relation).len(), 2);
    }

    #[test]
    fn findings_name_the_frame_with_the_smallest_share() {
        let mut findings = findings(&[(10, 1)]);
        let black = vec![0; PIXELS * 3];
        findings.add(&black, &black, "state 1, step 0, agentview");
        assert_eq!(findings.equal.place, "state 0, step 60, agentview");
        assert!(findings.equal.share < 1.0 && findings.largest == 1);
    }
}
