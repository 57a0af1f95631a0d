//! The latency axis, an addition to the protocol's six axes: the policy's responses are delayed by
//! whole control steps. The axis perturbs no value of the scene. Its rows run under the execution
//! model `overlap` with the delay of their level. Simultaneous perturbation excludes the axis.

use std::fmt;
use std::str::FromStr;

use crate::axis::{Axis, LATENCY};
use crate::execution::{Delays, Execution};
use crate::level::Level;
use crate::names::{UnknownName, serde_as_text};

/// Control steps of delay per unit of radius: L1, L2 and L3 are 1, 2 and 4 steps.
pub const STEPS_PER_RADIUS: f64 = 0.5;

/// Returns the delay of the latency axis at a level, control steps; `None` unless the delay is a
/// whole number of at least 1.
pub fn delay_at(level: Level) -> Option<u16> {
    let steps = level.radius() * STEPS_PER_RADIUS;
    // The delay fits, because the largest radius is 100.
    (steps >= 1.0 && steps.fract() == 0.0).then_some(steps as u16)
}

/// Returns the execution model of the latency axis at a level.
pub(crate) fn execution_at(level: Level) -> Option<Execution> {
    let delays = Delays::fixed(delay_at(level)?)?;
    Some(Execution::Overlap { delays, rtc: false })
}

/// An axis of a specification: one of the protocol's six, or latency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AnyAxis {
    Protocol(Axis),
    Latency,
}

impl fmt::Display for AnyAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Protocol(axis) => axis.fmt(f),
            Self::Latency => f.pad(LATENCY),
        }
    }
}

impl FromStr for AnyAxis {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        if text == LATENCY {
            return Ok(Self::Latency);
        }
        let mut valid = Axis::ALL.map(Axis::name).to_vec();
        valid.push(LATENCY);
        let axis = text.parse().map(Self::Protocol);
        axis.map_err(|_| UnknownName::new("axis", text, &valid))
    }
}

serde_as_text!(AnyAxis);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_delays_of_whole_control_steps() {
        let delay = |level: &str| delay_at(level.parse().expect("a level"));
        assert_eq!(["L1", "L2", "L3"].map(delay), [Some(1), Some(2), Some(4)]);
        assert_eq!(["r16", "r6", "r100"].map(delay), [Some(8), Some(3), Some(50)]);
        assert_eq!(["L0", "r1", "r3", "r2.5"].map(delay), [None; 4]);
        let model = execution_at(Level::L3).expect("a model");
        assert_eq!(model.to_string(), "overlap:4");
    }

    #[test]
    fn latency_is_a_valid_axis_of_specifications() {
        assert_eq!("latency".parse(), Ok(AnyAxis::Latency));
        assert_eq!("robot".parse(), Ok(AnyAxis::Protocol(Axis::Robot)));
        let error = "lag".parse::<AnyAxis>().expect_err("no axis").to_string();
        assert!(error.ends_with("actuation, language, latency"), "{error}");
    }
}
