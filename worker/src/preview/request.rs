//! Rows of the protocol to preview, and the fixed motion that shows actuation.

use libero_ctrl::{
    Axis, Condition, Level, ManifestRow, Perturbation, Realisation, RolloutId, TaskRef, presets,
};

/// The severities that the protocol has presets for.
pub(super) const LEVELS: [Level; 3] = [Level::L1, Level::L2, Level::L3];
/// Control steps of the fixed motion that shows the actuation axis.
pub(super) const MOTION_STEPS: usize = 40;

/// Configuration to preview.
pub struct Request {
    pub task: TaskRef,
    /// Index of the configuration, which selects preset and initial state.
    pub config: u16,
    /// Severity of the preset sheets.
    pub level: Level,
    /// Source of random elements.
    pub realisation: Realisation,
}

/// Returns a condition's row. Without a level the row is unperturbed, but has the initial state and
/// id of the perturbed row at L1, so that only the perturbation differs.
pub(super) fn row(
    task: TaskRef,
    condition: Condition,
    level: Option<Level>,
    config: u16,
) -> ManifestRow {
    let mut perturbation = Perturbation::default();
    if let Some(level) = level {
        let axes = match condition {
            Condition::Single(axis) => vec![axis],
            _ => Axis::METRIC.to_vec(),
        };
        for axis in axes {
            presets::apply_preset(&mut perturbation, axis, level, config);
        }
    }
    let id = RolloutId::perturbed(task, condition, level.unwrap_or(Level::L1), config)
        .expect("a perturbed condition with a severity");
    let init_id = task.eval_init_ids()[usize::from(config)];
    ManifestRow::new(id, config, init_id, perturbation)
}

/// Returns the action of a step in a descending circle, which shows gain, bias and misalignment.
pub(super) fn motion(step: usize) -> [f64; 7] {
    let phase = std::f64::consts::TAU * step as f64 / MOTION_STEPS as f64;
    [0.5 * phase.cos(), 0.5 * phase.sin(), -0.25, 0.0, 0.0, 0.1, -1.0]
}
