//! Next rollouts of a campaign that measures another one's thresholds. `thresholds` decides the
//! radii; this module turns them into rows of the design.

use libero_ctrl::{Design, DesignError, ManifestRow, Thresholds};
use paired::Record;
use thresholds::Measurement;

/// Returns the rows to add, given the records of the measured campaign, which has this design, and
/// those of the measuring one; empty if everything is found or already requested.
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
