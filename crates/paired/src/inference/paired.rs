//! The paper's measures with intervals for each target, rates among the configurations
//! that can change, and independence relative to nominal success.

use std::collections::BTreeMap;

use benchmark::{Directions, TaskRef};
use serde::{Deserialize, Serialize};

use crate::inference::estimate::{Estimate, Scale, defined, share};
use crate::inference::hypotheses::sign_flip_p;
use crate::inference::sample::{Row, Sample};

use crate::measures::Configuration;
use crate::outcomes::Matched;

/// The measures of [`Measures`](crate::Measures) with intervals for each target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairedEstimates {
    /// Product of the axes' success rates.
    pub s_indep: Estimate,
    /// Share that succeeds under every axis alone.
    pub s_conj: Estimate,
    /// Share that succeeds under simultaneous perturbation.
    pub s_sim: Estimate,
    /// `s_conj` − `s_indep`.
    pub d: Estimate,
    /// `s_sim` − `s_conj`.
    pub i: Estimate,
    /// Share of emergent failures.
    pub r_e: Estimate,
    /// Share of compensated successes.
    pub r_c: Estimate,
    /// Share of changed outcomes.
    pub r_d: Estimate,
}

/// Rates among the configurations that can change. Their number depends on the level, so
/// that R_e and R_c of two levels are not comparable.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Eligible {
    /// b / (n·S_conj): share of simultaneous failures among the configurations that succeed
    /// under every axis alone. Absent if no configuration succeeds under every axis alone.
    pub emergent: Option<Estimate>,
    /// c / (n·(1 − S_conj)): share of simultaneous successes among the configurations that fail
    /// under some axis alone. Absent if no configuration fails under an axis alone.
    pub compensated: Option<Estimate>,
}

/// Simultaneous success against the prediction for independent axes relative to nominal
/// success.
///
/// S_indep multiplies the axes' success rates, and so counts nominal failures once per
/// axis. Relative to nominal success N the prediction is N · Π_a (S_a / N), which is exact
/// if each axis preserves a share of the nominal successes independently of the others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Relative {
    /// Complete configurations with a nominal outcome.
    pub n: u64,
    /// N, over these configurations.
    pub nominal: Estimate,
    /// N · Π_a (S_a / N).
    pub prediction: Estimate,
    /// S_sim − `prediction`.
    pub difference: Estimate,
}

/// Columns of a complete configuration's row: 1, conjunction, simultaneous, emergent,
/// compensated, then each axis.
const N: usize = 0;
const CONJUNCTION: usize = 1;
const SIMULTANEOUS: usize = 2;
const EMERGENT: usize = 3;
const COMPENSATED: usize = 4;
const AXES: usize = 5;

fn row(matched: &Matched, configuration: &Configuration) -> Row {
    let number = |value: bool| f64::from(u8::from(value));
    let (conjunction, simultaneous) = (configuration.conjunction(), configuration.simultaneous);
    let mut values = vec![
        1.0,
        number(conjunction),
        number(simultaneous),
        number(conjunction && !simultaneous),
        number(!conjunction && simultaneous),
    ];
    values.extend(configuration.alone.values().copied().map(number));
    Row { task: matched.task, direction: matched.config, values }
}

fn complete_rows(matched: &[Matched]) -> Vec<Row> {
    let rows = matched.iter();
    rows.filter_map(|matched| Some(row(matched, &matched.configuration()?))).collect()
}

fn axis_product(sums: &[f64]) -> f64 {
    sums[AXES..].iter().map(|sum| sum / sums[N]).product()
}

impl PairedEstimates {
    /// Estimates the measures over the complete configurations; `None` if no configuration is
    /// complete.
    pub(crate) fn of(matched: &[Matched], directions: Directions) -> Option<Self> {
        let rows = complete_rows(matched);
        let sample = Sample::new(&rows, directions)?;
        let estimate = |scale, statistic: &dyn Fn(&[f64]) -> f64| {
            defined(Estimate::of(&sample, scale, statistic))
        };
        Some(Self {
            s_indep: estimate(Scale::Product, &axis_product),
            s_conj: estimate(Scale::Share, &share(CONJUNCTION, N)),
            s_sim: estimate(Scale::Share, &share(SIMULTANEOUS, N)),
            d: estimate(Scale::Difference, &|s| s[CONJUNCTION] / s[N] - axis_product(s)),
            i: estimate(Scale::Difference, &|s| (s[SIMULTANEOUS] - s[CONJUNCTION]) / s[N]),
            r_e: estimate(Scale::Share, &share(EMERGENT, N)),
            r_c: estimate(Scale::Share, &share(COMPENSATED, N)),
            r_d: estimate(Scale::Share, &|s| (s[EMERGENT] + s[COMPENSATED]) / s[N]),
        })
    }
}

impl Eligible {
    pub(crate) fn of(matched: &[Matched], directions: Directions) -> Self {
        let rows = complete_rows(matched);
        let sample = Sample::new(&rows, directions);
        let estimate = |statistic: &dyn Fn(&[f64]) -> f64| {
            Estimate::of(sample.as_ref()?, Scale::Share, statistic)
        };
        Self {
            emergent: estimate(&share(EMERGENT, CONJUNCTION)),
            compensated: estimate(&|s| s[COMPENSATED] / (s[N] - s[CONJUNCTION])),
        }
    }
}

impl Relative {
    pub(crate) fn of(matched: &[Matched], directions: Directions) -> Option<Self> {
        let with_nominal = matched.iter().filter_map(|matched| {
            let nominal = matched.nominal.success()?;
            let mut row = row(matched, &matched.configuration()?);
            row.values.push(f64::from(u8::from(nominal)));
            Some(row)
        });
        let rows: Vec<Row> = with_nominal.collect();
        let nominal = rows.first()?.values.len() - 1;
        let sample = Sample::new(&rows, directions)?;
        let prediction = |s: &[f64]| {
            let preserved = s[AXES..nominal].iter().map(|axis| axis / s[nominal]);
            s[nominal] / s[N] * preserved.product::<f64>()
        };
        let difference = |s: &[f64]| s[SIMULTANEOUS] / s[N] - prediction(s);
        Some(Self {
            n: rows.len() as u64,
            nominal: Estimate::of(&sample, Scale::Share, &share(nominal, N))?,
            prediction: Estimate::of(&sample, Scale::Difference, &prediction)?,
            difference: Estimate::of(&sample, Scale::Difference, &difference)?,
        })
    }
}

pub(crate) fn i_sign_flip_p(matched: &[Matched]) -> f64 {
    let mut net: BTreeMap<TaskRef, i64> = BTreeMap::new();
    for configuration in matched.iter().filter_map(Matched::configuration) {
        let change = i64::from(configuration.simultaneous) - i64::from(configuration.conjunction());
        *net.entry(configuration.task).or_default() += change;
    }
    sign_flip_p(&net.into_values().collect::<Vec<_>>())
}
