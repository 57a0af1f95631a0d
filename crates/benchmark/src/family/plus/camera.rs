//! Pose of `agentview` in LIBERO-Plus: rotated about a pivot above the floor, moved to a multiple
//! of the distance from the pivot, and rotated in place, rounded to four decimals after every step.
//! The pose of every variant is rounded, so that no variant has exactly LIBERO's camera.

use std::fmt;

/// Height of the pivot, m: that of the table, also used in scenes without a table.
const PIVOT_HEIGHT: f64 = 0.8;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraPose {
    /// Position, world frame, m.
    pub pos: [f64; 3],
    /// Orientation, w x y z; normalised only to four decimals.
    pub quat: [f64; 4],
}

/// View of a variant: the five integers `H_V_S_R_T` of its name. Angles are in degrees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct View {
    /// Rotation about the vertical axis through the pivot.
    pub horizontal: u16,
    /// Upward rotation about a horizontal axis through the pivot.
    pub vertical: u16,
    /// Distance from the pivot, percent.
    pub scale: u16,
    /// Rotation in place about the world's vertical axis.
    pub pan: u16,
    /// Rotation in place about the world's y axis.
    pub tilt: u16,
}

impl View {
    /// LIBERO's view, except for rounding.
    pub const NOMINAL: Self = Self { horizontal: 0, vertical: 0, scale: 100, pan: 0, tilt: 0 };

    pub fn is_nominal(&self) -> bool {
        *self == Self::NOMINAL
    }

    /// Creates a view from the five numbers of a name; `None` if they are invalid.
    pub(crate) fn from_numbers(numbers: &[u16]) -> Option<Self> {
        let [horizontal, vertical, scale, pan, tilt] = *numbers else {
            return None;
        };
        let angles = [horizontal, vertical, pan, tilt];
        (scale > 0 && angles.iter().all(|angle| *angle < 360)).then_some(Self {
            horizontal,
            vertical,
            scale,
            pan,
            tilt,
        })
    }

    pub fn apply(&self, nominal: CameraPose) -> CameraPose {
        let mut pose = nominal;
        if self.vertical != 0 {
            pose = pose.swing_up(f64::from(self.vertical)).rounded();
        }
        pose = pose.swing_around(f64::from(self.horizontal)).rounded();
        if self.scale != 100 {
            pose.pos = [0, 1, 2].map(|axis| {
                let pivot = PIVOT[axis];
                pivot + (pose.pos[axis] - pivot) * (f64::from(self.scale) / 100.0)
            });
            pose = pose.rounded();
        }
        if self.pan != 0 {
            pose.quat = rotate(f64::from(self.pan), 3, pose.quat);
            pose = pose.rounded();
        }
        if self.tilt != 0 {
            pose.quat = rotate(-f64::from(self.tilt), 2, pose.quat);
            pose = pose.rounded();
        }
        pose
    }
}

impl fmt::Display for View {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { horizontal, vertical, scale, pan, tilt } = self;
        write!(f, "{horizontal}_{vertical}_{scale}_{pan}_{tilt}")
    }
}

const PIVOT: [f64; 3] = [0.0, 0.0, PIVOT_HEIGHT];

impl CameraPose {
    fn swing_up(self, degrees: f64) -> Self {
        let (sin, cos) = libm::sincos((-degrees).to_radians());
        let [x, y, z] = self.pos;
        let height = z - PIVOT_HEIGHT;
        Self {
            pos: [x * cos + height * sin, y, -x * sin + height * cos + PIVOT_HEIGHT],
            quat: rotate(-degrees, 2, self.quat),
        }
    }

    fn swing_around(self, degrees: f64) -> Self {
        let (sin, cos) = libm::sincos(degrees.to_radians());
        let [x, y, z] = self.pos;
        Self { pos: [x * cos - y * sin, x * sin + y * cos, z], quat: rotate(degrees, 3, self.quat) }
    }

    fn rounded(self) -> Self {
        Self { pos: self.pos.map(round4), quat: self.quat.map(round4) }
    }
}

/// Normalises an orientation and rotates it about an axis of the world: 1 is x, 2 is y, 3 is z.
fn rotate(degrees: f64, axis: usize, quat: [f64; 4]) -> [f64; 4] {
    let length = quat.iter().map(|part| part * part).sum::<f64>().sqrt();
    let [w, x, y, z] = quat.map(|part| part / length);
    let (sin, c) = libm::sincos(degrees.to_radians() / 2.0);
    let mut s = [0.0; 4];
    s[axis] = sin;
    let [_, a, b, d] = s;
    [
        c * w - a * x - b * y - d * z,
        c * x + a * w + b * z - d * y,
        c * y - a * z + b * w + d * x,
        c * z + a * y - b * x + d * w,
    ]
}

fn round4(value: f64) -> f64 {
    let text = format!("{value:.4}");
    text.parse().expect("a number that was just written")
}
