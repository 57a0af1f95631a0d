//! Power analysis before a campaign runs: the smallest differences that a two-sided test at
//! 5 % detects with a power of 80 %, assuming outcomes like known ones. Tasks are clusters
//! if the figures are to hold for new tasks.

use std::collections::BTreeMap;

use libero_ctrl::Level;

use crate::design::{
    PairedDesign, Z_POWER, Z_TEST, correlation, minimum_detectable_effect, task_correlation,
};
use crate::interval::MIN_TASKS;
use crate::measures::Configuration;
use crate::outcomes::{DuplicateRecord, Record, Records};

/// Number of bisection steps, enough for the precision of an `f64`.
const BISECTIONS: u32 = 60;

/// Assumed outcomes of a level. Rates are fractions; correlations
/// are those of configurations of one task, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Assumed {
    /// The level.
    pub level: Level,
    /// Success rate under simultaneous perturbation.
    pub s_sim: f64,
    /// Share of configurations whose outcome simultaneity changes.
    pub r_d: f64,
    /// Correlation of simultaneous success within a task.
    pub success_correlation: f64,
    /// Correlation within a task of simultaneous − conjunction, which is −1, 0 or 1.
    pub change_correlation: f64,
    /// Correlation within a task of the indicator that the outcome changes.
    pub changed_correlation: f64,
}

/// Number of configurations planned at a level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Planned {
    /// Tasks.
    pub tasks: u32,
    /// Configurations per task, on average.
    pub configs_per_task: f64,
}

/// The measure that `R_d` is compared with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Against {
    /// The `R_d` of another policy, over the same number of configurations.
    AnotherPolicy,
    /// The `R_d` of the placebo level.
    Floor {
        /// Assumed `R_d` of the placebo level, a fraction.
        r_d: f64,
        /// Configurations planned at the placebo level.
        planned: Planned,
    },
}

/// The smallest detectable differences, as fractions. `None` if even the largest possible
/// difference is too small, or if there are too few tasks for intervals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detectable {
    /// Difference of the success rates of two policies under simultaneous perturbation, assuming
    /// that the outcomes of the two policies are independent of each other. If they are positively
    /// correlated, smaller differences are detectable.
    pub difference: Option<f64>,
    /// Difference of I from 0.
    pub i: Option<f64>,
    /// Difference of `R_d` from the reference given by [`Against`].
    pub r_d: Option<f64>,
}

impl Assumed {
    /// Summary, by [`Assumed::of`], of the student's published outcomes (`examples/student`): all
    /// rollouts of LIBERO-CTRL v0.1, and the placebo level.
    pub const STUDENT: [Self; 4] = [
        Self {
            level: Level::L0,
            s_sim: 0.95,
            r_d: 0.065,
            success_correlation: 0.5274,
            change_correlation: 0.1444,
            changed_correlation: 0.1457,
        },
        Self {
            level: Level::L1,
            s_sim: 0.7225,
            r_d: 0.2075,
            success_correlation: 0.3487,
            change_correlation: 0.0404,
            changed_correlation: 0.0765,
        },
        Self {
            level: Level::L2,
            s_sim: 0.4175,
            r_d: 0.27,
            success_correlation: 0.2765,
            change_correlation: 0.0462,
            changed_correlation: 0.0852,
        },
        Self {
            level: Level::L3,
            s_sim: 0.0875,
            r_d: 0.155,
            success_correlation: 0.1527,
            change_correlation: 0.0512,
            changed_correlation: 0.0404,
        },
    ];

    /// Summarises the outcomes of complete configurations in replicate 0, by ascending level;
    /// empty with fewer than two axes.
    ///
    /// # Errors
    /// If a rollout and replicate is recorded twice.
    pub fn of(records: &[Record]) -> Result<Vec<Self>, DuplicateRecord> {
        let records = Records::new(records)?;
        let first = records.configurations().iter();
        let first = first.filter(|matched| matched.replicate == 0 && matched.alone.len() > 1);
        let mut levels: BTreeMap<Level, Vec<Configuration>> = BTreeMap::new();
        for matched in first {
            if let Some(configuration) = matched.configuration() {
                levels.entry(matched.level).or_default().push(configuration);
            }
        }
        let levels = levels.into_iter();
        Ok(levels
            .map(|(level, configurations)| Self::from_configurations(level, &configurations))
            .collect())
    }

    fn from_configurations(level: Level, configurations: &[Configuration]) -> Self {
        let share = |predicate: fn(&Configuration) -> bool| {
            let count =
                configurations.iter().filter(|configuration| predicate(configuration)).count();
            count as f64 / configurations.len() as f64
        };
        let task_correlation_of = |predicate: fn(&Configuration) -> bool| {
            correlation(configurations, |configuration| f64::from(predicate(configuration)))
                .unwrap_or_default()
        };
        let is_changed: fn(&Configuration) -> bool =
            |configuration| configuration.simultaneous != configuration.conjunction();
        Self {
            level,
            s_sim: share(|configuration| configuration.simultaneous),
            r_d: share(is_changed),
            success_correlation: task_correlation_of(|configuration| configuration.simultaneous),
            change_correlation: task_correlation(configurations).unwrap_or_default(),
            changed_correlation: task_correlation_of(is_changed),
        }
    }

    /// Returns the entry whose level, other than L0, has the radius nearest to that of `level`;
    /// `None` if there is none.
    pub fn nearest(all: &[Self], level: Level) -> Option<&Self> {
        let perturbed = all.iter().filter(|assumed| assumed.level != Level::L0);
        perturbed.min_by(|a, b| {
            let distance = |assumed: &Self| (assumed.level.radius() - level.radius()).abs();
            distance(a).total_cmp(&distance(b))
        })
    }

    /// Returns the assumptions for inference about the given tasks only, where the
    /// correlation within tasks does not contribute to the error.
    pub const fn of_these_tasks(self) -> Self {
        Self { success_correlation: 0.0, change_correlation: 0.0, changed_correlation: 0.0, ..self }
    }

    /// Returns the smallest differences that the planned configurations can detect.
    pub fn detectable(&self, planned: Planned, against: Against) -> Detectable {
        if (planned.tasks as usize) < MIN_TASKS {
            return Detectable { difference: None, i: None, r_d: None };
        }
        let paired = |r_d, task_correlation| {
            minimum_detectable_effect(&PairedDesign {
                tasks: planned.tasks,
                configs_per_task: planned.configs_per_task,
                r_d,
                task_correlation,
            })
        };
        let (base, reference) = match against {
            Against::AnotherPolicy => (self.r_d, planned),
            Against::Floor { r_d, planned: floor } => (r_d, floor),
        };
        Detectable {
            difference: paired(2.0 * self.s_sim * (1.0 - self.s_sim), self.success_correlation),
            i: paired(self.r_d, self.change_correlation),
            r_d: excess(base, self.changed_correlation, [planned, reference]),
        }
    }
}

impl Planned {
    /// Returns the variance of a share over these configurations: the binomial variance
    /// times the design effect 1 + (m − 1)·ρ.
    fn variance(self, share: f64, correlation: f64) -> f64 {
        let effect = 1.0 + (self.configs_per_task - 1.0).max(0.0) * correlation;
        share * (1.0 - share) * effect / self.total()
    }

    /// Returns the number of configurations of all tasks.
    pub fn count(self) -> u32 {
        self.total().round() as u32
    }

    fn total(self) -> f64 {
        f64::from(self.tasks) * self.configs_per_task
    }
}

/// Returns the smallest detectable excess of a share over `base`. The two shares are of separate
/// configurations: those of the level and those of the reference. Solves δ = z₀.₉₇₅·σ(pooled,
/// pooled) + z₀.₈·σ(base + δ, base), with σ(p, q) the standard error of the difference of shares p
/// and q, and `pooled` the share over all of these configurations. Smaller differences are
/// detectable if both shares are of the same, positively correlated configurations. `None` if
/// either has no configurations, or not even a share of 1 is detectable.
///
/// Source: J. L. Fleiss, B. Levin, M. C. Paik, Statistical Methods for Rates and Proportions,
/// third edition (2003), section 4.2.
fn excess(base: f64, correlation: f64, [compared, reference]: [Planned; 2]) -> Option<f64> {
    let spread = |share: f64, reference_share: f64| {
        (compared.variance(share, correlation) + reference.variance(reference_share, correlation))
            .sqrt()
    };
    // Required minus given excess: negative if the given excess is detectable.
    let shortfall = |excess: f64| {
        let share = base + excess;
        let all = compared.total() + reference.total();
        let pooled = (compared.total() * share + reference.total() * base) / all;
        Z_TEST * spread(pooled, pooled) + Z_POWER * spread(share, base) - excess
    };
    let (mut low, mut high) = (0.0, 1.0 - base);
    if !(compared.total() > 0.0 && reference.total() > 0.0) || shortfall(high) > 0.0 {
        return None;
    }
    for _ in 0..BISECTIONS {
        let middle = f64::midpoint(low, high);
        match shortfall(middle) > 0.0 {
            true => low = middle,
            false => high = middle,
        }
    }
    Some(high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    fn planned(tasks: u32, configs_per_task: f64) -> Planned {
        Planned { tasks, configs_per_task }
    }

    fn assumed(r_d: f64, correlation: f64) -> Assumed {
        Assumed {
            level: Level::L2,
            s_sim: 0.6,
            r_d,
            success_correlation: correlation,
            change_correlation: correlation,
            changed_correlation: correlation,
        }
    }

    #[test]
    fn a_detectable_excess_is_found_in_four_of_five_campaigns() {
        let [compared, reference] = [planned(40, 10.0), planned(40, 2.0)];
        let base = 0.05;
        let excess = excess(base, 0.0, [compared, reference]).expect("detectable");
        let mut rng = ChaCha8Rng::seed_from_u64(33);
        let mut share = |planned: Planned, rate: f64| {
            let uniform = || f64::from(rng.next_u32()) / f64::from(u32::MAX);
            let n = planned.total();
            let hits = std::iter::repeat_with(uniform).take(n as usize);
            hits.filter(|draw| *draw < rate).count() as f64 / n
        };
        let campaigns = 2_000;
        let is_found = |_: &u32| {
            let (rate, reference_rate) = (share(compared, base + excess), share(reference, base));
            let pooled = (rate * compared.total() + reference_rate * reference.total()) / 480.0;
            let variance = compared.variance(pooled, 0.0) + reference.variance(pooled, 0.0);
            (rate - reference_rate).abs() > Z_TEST * variance.sqrt()
        };
        let count = (0..campaigns).filter(is_found).count();
        let power = count as f64 / f64::from(campaigns);
        assert!((0.75..0.85).contains(&power), "{power} for {excess}");
    }

    #[test]
    fn more_configurations_and_less_correlation_detect_smaller_effects() {
        let floor = |configs| Against::Floor { r_d: 0.05, planned: planned(40, configs) };
        let usual = assumed(0.27, 0.05);
        let all = |detectable: Detectable| {
            [detectable.difference, detectable.i, detectable.r_d]
                .map(|value| value.expect("detectable"))
        };
        let smallest = |assumed: Assumed, tasks, against| {
            all(assumed.detectable(planned(tasks, 10.0), against))
        };
        let baseline = smallest(usual, 40, floor(10.0));
        for (better, worse) in [
            (
                smallest(usual, 100, Against::AnotherPolicy),
                smallest(usual, 40, Against::AnotherPolicy),
            ),
            (smallest(assumed(0.27, 0.0), 40, floor(10.0)), baseline),
        ] {
            for (better, worse) in better.into_iter().zip(worse) {
                assert!(0.0 < better && better < worse, "{better} {worse}");
            }
        }
        let fewer = smallest(usual, 40, floor(2.0));
        assert!(fewer[2] > baseline[2] && fewer[..2] == baseline[..2]);
        let few_tasks = usual.detectable(planned(9, 10.0), Against::AnotherPolicy);
        assert_eq!(few_tasks.i, None);
    }

    #[test]
    fn assumptions_of_a_level_are_those_of_the_nearest_known_level() {
        let at = |text: &str| text.parse::<Level>().expect("a level");
        let all =
            [at("L0"), at("L1"), at("L3")].map(|level| Assumed { level, ..assumed(0.2, 0.0) });
        for (level, nearest) in [("L2", "L1"), ("r7", "L3"), ("r0.1", "L1"), ("L3", "L3")] {
            let assumed = Assumed::nearest(&all, at(level)).expect("a perturbed level");
            assert_eq!(assumed.level, at(nearest), "{level}");
        }
        assert_eq!(Assumed::nearest(&all[..1], Level::L2), None);
    }
}
