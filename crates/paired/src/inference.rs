//! Statistical inference about one level: intervals for each target of inference, matched
//! losses, predictions under independence, and the excess over the noise floor. The paper's
//! own measures and intervals are in `measures`.

pub(crate) mod direction;
pub(crate) mod estimate;
pub(crate) mod floor;
pub(crate) mod hypotheses;
pub(crate) mod loss;
pub(crate) mod paired;
pub(crate) mod sample;
pub(crate) mod student_t;

use benchmark::{Directions, Level};
use serde::{Deserialize, Serialize};

use crate::inference::direction::DirectionTest;
use crate::inference::floor::Excess;
use crate::inference::loss::{Loss, Losses};
use crate::inference::paired::{Eligible, PairedEstimates, Relative};
use crate::outcomes::Matched;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Inference {
    /// The paper's measures over complete configurations, with intervals for each target.
    pub paired: PairedEstimates,
    /// Rates of change among the configurations that can change.
    pub eligible: Eligible,
    /// Exact two-sided sign-flip p-value of I over tasks.
    pub i_sign_flip_p: f64,
    /// Simultaneous success against the prediction for independent axes relative to nominal
    /// success; absent without a successful matched nominal rollout.
    pub relative: Option<Relative>,
    /// The loss under each axis alone and under simultaneous perturbation, against the nominal
    /// rollouts of the same initial states; empty without such nominal rollouts.
    pub losses: Losses,
    /// Test of whether simultaneous success depends on the direction; absent if directions are not
    /// shared between tasks, with fewer than two directions or tasks, and for the placebo.
    pub directions: Option<DirectionTest>,
    /// The noise floor and the excess over it; absent without a complete configuration of the
    /// placebo, if the placebo has another number of axes, and for the placebo itself.
    pub excess: Option<Excess>,
}

impl Inference {
    /// Computes the inference from the configurations of one level and those of
    /// the placebo; `None` if no configuration is complete.
    pub(crate) fn of(
        matched: &[Matched],
        placebo: Option<&[Matched]>,
        directions: Directions,
    ) -> Option<Self> {
        let paired = PairedEstimates::of(matched, directions)?;
        let is_placebo = matched.iter().all(|configuration| configuration.level == Level::L0);
        let placebo = placebo.filter(|_| !is_placebo);
        Some(Self {
            paired,
            eligible: Eligible::of(matched, directions),
            i_sign_flip_p: paired::i_sign_flip_p(matched),
            relative: Relative::of(matched, directions),
            losses: Loss::of_each(matched, directions),
            directions: if is_placebo { None } else { DirectionTest::of(matched, directions) },
            excess: placebo.and_then(|placebo| Excess::of(matched, placebo, directions)),
        })
    }
}
