mod decisions;
mod interactions;
mod planted;
mod planted_rules;
mod repeats;

use benchmark::{Axis, AxisSet};

fn full(axes: usize) -> AxisSet {
    Axis::ALL.into_iter().take(axes).collect()
}
