//! Postures of the arm at a reset; LIBERO-Plus has a robot class for each. All 500 follow from a
//! rule: a displacement in joint space whose direction is drawn from NumPy's generator with seed
//! 42, and whose length increases with each hundred of numbers.

use std::sync::OnceLock;

use crate::numpy::LegacyRng;

pub const ROBOTS: u16 = 500;
const JOINTS: usize = 7;
const SEED: u32 = 42;
/// Length of the displacements of robots 1 to 100, rad; it increases by this amount with each
/// further hundred.
const RADIUS_STEP: f64 = 0.1;
/// LIBERO's posture at a reset, rad.
const HOME: [f64; JOINTS] =
    [0.0, -0.161_037_389, 0.0, -2.444_597_47, 0.0, 2.226_752_2, std::f64::consts::FRAC_PI_4];

/// Returns the joint angles, rad, at the reset of robot `number`, 1 to 500 (`_initstate_K` of a
/// variant's name); `None` for other numbers.
pub fn start_posture(number: u16) -> Option<[f64; JOINTS]> {
    static POSTURES: OnceLock<Vec<[f64; JOINTS]>> = OnceLock::new();
    let postures = POSTURES.get_or_init(|| {
        let mut rng = LegacyRng::seed(SEED);
        (1..=ROBOTS).map(|number| posture(number, &mut rng)).collect()
    });
    postures.get(usize::from(number.checked_sub(1)?)).copied()
}

fn posture(number: u16, rng: &mut LegacyRng) -> [f64; JOINTS] {
    let direction: [f64; JOINTS] = std::array::from_fn(|_| rng.randn());
    let length = direction.iter().map(|part| part * part).sum::<f64>().sqrt();
    let radius = RADIUS_STEP * f64::from(number.div_ceil(100));
    std::array::from_fn(|joint| {
        let angle = HOME[joint] + radius * direction[joint] / length;
        // The released classes contain the angles as text with eight decimals.
        let text = format!("{angle:.8}");
        text.parse().expect("a number that was just written")
    })
}
