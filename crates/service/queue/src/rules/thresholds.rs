//! Next rollouts of a campaign that measures another one's thresholds. The radii are `thresholds`'
//! business; here they become rows of the design.

use libero_ctrl::{Design, DesignError, ManifestRow, Thresholds};
use paired::Record;
use thresholds::Measurement;

/// The rows that follow from the records of the campaign that is measured, which has
/// this design, and from those of the one that measures it; none where everything is
/// found, or asked for.
pub(crate) fn wanted(
    design: &Design,
    source: &[Record],
    own: &[Record],
    thresholds: &Thresholds,
) -> Result<Vec<ManifestRow>, DesignError> {
    let plan = Measurement::of(source, own, thresholds).plan();
    let row = |(ray, level): (thresholds::Ray, _)| {
        design.row_at(ray.task, ray.condition, level, ray.config)
    };
    plan.into_iter().map(row).collect()
}
