//! Open-loop actions for tests and benchmarks.

/// The reference data's smooth actions: a sine per component; the gripper
/// closes after 30 steps.
pub fn smooth_action(step: usize) -> [f64; 7] {
    const AMPLITUDE: [f64; 6] = [0.6, 0.6, 0.6, 0.35, 0.35, 0.35];
    const PERIOD: [f64; 6] = [20.0, 30.0, 24.0, 40.0, 36.0, 28.0];
    const PHASE: [f64; 6] = [0.0, 0.7, 1.4, 0.3, 1.1, 2.0];
    let mut action = [0.0; 7];
    for axis in 0..6 {
        let angle = std::f64::consts::TAU * step as f64 / PERIOD[axis] + PHASE[axis];
        action[axis] = AMPLITUDE[axis] * angle.sin();
    }
    action[6] = if step < 30 { -1.0 } else { 1.0 };
    action
}
