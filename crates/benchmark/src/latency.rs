//! The latency axis: the policy's responses are delayed by whole control steps. Its rows run under
//! the execution model `overlap` with the delay of their level.

use crate::axis::Axis;
use crate::execution::{Delays, Execution};
use crate::level::Level;

/// Control steps of delay per unit of radius: L1, L2 and L3 are 1, 2 and 4 steps.
pub const STEPS_PER_RADIUS: f64 = 0.5;

/// Returns the delay of the latency axis at a level, control steps; `None` unless the delay is a
/// whole number of at least 1.
pub fn delay_at(level: Level) -> Option<u16> {
    // The delay fits, because the largest radius is 100.
    let is_run = Axis::Latency.def().radii.contains(level);
    is_run.then_some((level.radius() * STEPS_PER_RADIUS) as u16)
}

pub fn execution_at(level: Level) -> Option<Execution> {
    let delays = Delays::fixed(delay_at(level)?)?;
    Some(Execution::Overlap { delays, rtc: false })
}

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
}
