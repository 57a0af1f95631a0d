//! Loss of success under each condition, relative to the nominal rollouts of the same
//! initial states.

use std::collections::BTreeMap;

use benchmark::{Condition, Directions, TaskRef};
use serde::{Deserialize, Serialize};

use crate::inference::estimate::{Estimate, Scale, share};
use crate::inference::hypotheses::{equivalence_p, holm, sign_flip_p};
use crate::inference::sample::{Row, Sample};
use crate::outcomes::Matched;

pub type Losses = BTreeMap<Condition, Loss>;

/// Nominal success minus success under a condition, over the configurations with a nominal outcome
/// and an outcome under the condition. Every condition of a level uses the same initial states.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Loss {
    /// Configurations with both outcomes.
    pub n: u64,
    /// Nominal success over these configurations.
    pub nominal: Estimate,
    /// Success under the condition over these configurations.
    pub success: Estimate,
    /// `nominal` − `success`.
    pub loss: Estimate,
    /// Configurations in which only the nominal rollout succeeds.
    pub nominal_only: u64,
    /// Configurations in which only the rollout under the condition succeeds.
    pub condition_only: u64,
    /// Exact two-sided sign-flip p-value of the loss over tasks.
    pub sign_flip_p: f64,
    /// `sign_flip_p` after Holm's correction for the conditions of the level.
    pub holm_p: f64,
    /// Equivalence p-value of the hypothesis that the loss lies outside
    /// ±[`EQUIVALENCE_MARGIN`]. Absent without a standard error.
    ///
    /// [`EQUIVALENCE_MARGIN`]: crate::EQUIVALENCE_MARGIN
    pub equivalence_p: Option<f64>,
}

/// Columns of a row: the constant 1, nominal success, success under the condition.
const N: usize = 0;
const NOMINAL: usize = 1;
const SUCCESS: usize = 2;

impl Loss {
    /// Computes the loss under each axis alone and under simultaneous perturbation. Conditions for
    /// which no configuration has both outcomes are left out, and so are subsets and axes that are not
    /// combined.
    pub(crate) fn of_each(matched: &[Matched], directions: Directions) -> Losses {
        let axes = matched.iter().flat_map(Matched::combined);
        let conditions = axes.map(|(axis, _)| Condition::Single(axis));
        let conditions = conditions.chain([Condition::Simultaneous]);
        let mut losses: Losses = BTreeMap::new();
        for condition in conditions {
            if losses.contains_key(&condition) {
                continue;
            }
            if let Some(loss) = Self::under(matched, condition, directions) {
                losses.insert(condition, loss);
            }
        }
        let p_values: Vec<f64> = losses.values().map(|loss| loss.sign_flip_p).collect();
        for (loss, p) in losses.values_mut().zip(holm(&p_values)) {
            loss.holm_p = p;
        }
        losses
    }

    /// Computes the loss under one condition; `None` if no configuration has both outcomes.
    fn under(matched: &[Matched], condition: Condition, directions: Directions) -> Option<Self> {
        let mut net: BTreeMap<TaskRef, i64> = BTreeMap::new();
        let (mut nominal_only, mut condition_only) = (0, 0);
        let rows = matched.iter().filter_map(|matched| {
            let nominal = matched.nominal.success()?;
            let success = matched.outcome(condition).success()?;
            *net.entry(matched.task).or_default() += i64::from(nominal) - i64::from(success);
            nominal_only += u64::from(nominal && !success);
            condition_only += u64::from(success && !nominal);
            Some(Row {
                task: matched.task,
                direction: matched.config,
                values: vec![1.0, f64::from(u8::from(nominal)), f64::from(u8::from(success))],
            })
        });
        let rows: Vec<Row> = rows.collect();
        let sample = Sample::new(&rows, directions)?;
        let difference = |s: &[f64]| (s[NOMINAL] - s[SUCCESS]) / s[N];
        let loss = Estimate::of(&sample, Scale::Difference, &difference)?;
        let sign_flip_p = sign_flip_p(&net.into_values().collect::<Vec<_>>());
        Some(Self {
            n: rows.len() as u64,
            nominal: Estimate::of(&sample, Scale::Share, &share(NOMINAL, N))?,
            success: Estimate::of(&sample, Scale::Share, &share(SUCCESS, N))?,
            equivalence_p: equivalence_p(&loss),
            loss,
            nominal_only,
            condition_only,
            sign_flip_p,
            holm_p: sign_flip_p,
        })
    }
}
