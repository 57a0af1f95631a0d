//! The measures of one cell: matched configurations of one level.

use std::collections::BTreeMap;

use benchmark::{Axis, TaskRef};
use serde::{Deserialize, Serialize};

use crate::bootstrap::{Bootstrap, Interval, NoInterval, intervals};
use crate::inference::hypotheses::mcnemar_exact;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Configuration {
    /// Task of the configuration: the cluster that the bootstrap draws.
    pub task: TaskRef,
    pub alone: BTreeMap<Axis, bool>,
    /// Success under simultaneous perturbation of all axes.
    pub simultaneous: bool,
}

impl Configuration {
    /// Returns true if the configuration succeeds under every axis alone: Π_a Y_a.
    pub fn conjunction(&self) -> bool {
        self.alone.values().all(|&success| success)
    }
}

/// Measures over matched configurations. Rates are fractions; names and
/// formulas are those of section 6 of the protocol (arXiv 2609.15940).
///
/// The interval of a measure (`…_ci95`) is by a percentile cluster bootstrap
/// ([`Bootstrap::intervals`]). An interval that would mislead is absent, and
/// `no_interval` gives the reason.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    pub n: u64,
    pub tasks: u64,
    /// Success rate under each axis alone.
    pub s_axis: BTreeMap<Axis, f64>,
    /// Π `s_axis`: the prediction for independent axes.
    pub s_indep: f64,
    /// Share of configurations that succeed under every axis alone.
    pub s_conj: f64,
    /// Success rate under simultaneous perturbation.
    pub s_sim: f64,
    /// `s_conj` − `s_indep`: the dependence of the axes' failures.
    pub d: f64,
    pub d_ci95: Option<Interval>,
    /// `s_sim` − `s_conj` = `r_c` − `r_e`: the net effect of simultaneity.
    pub i: f64,
    pub i_ci95: Option<Interval>,
    /// Emergent failures: every axis alone succeeds, the simultaneous rollout
    /// fails.
    pub b: u64,
    /// Compensated successes: some axis alone fails, the simultaneous rollout
    /// succeeds.
    pub c: u64,
    /// `b` / `n`.
    pub r_e: f64,
    pub r_e_ci95: Option<Interval>,
    /// `c` / `n`.
    pub r_c: f64,
    pub r_c_ci95: Option<Interval>,
    /// `r_e` + `r_c`: share of outcomes that simultaneity changes.
    pub r_d: f64,
    pub r_d_ci95: Option<Interval>,
    /// Reason why intervals are absent; `None` if all are present.
    pub no_interval: Option<NoInterval>,
    /// `b` / number of simultaneous failures; absent if there are none.
    pub emergent_share: Option<f64>,
    /// Exact two-sided McNemar test of `b` against `c`.
    pub mcnemar_p: f64,
}

impl Measures {
    /// Computes the measures of some configurations; `None` without a configuration. The result
    /// does not depend on the order of the configurations or on the names of tasks and axes.
    ///
    /// # Panics
    /// If two configurations have different axes.
    pub fn of(configurations: &[Configuration], bootstrap: &Bootstrap) -> Option<Self> {
        let axes: Vec<Axis> = configurations.first()?.alone.keys().copied().collect();
        let clusters = Tally::of_tasks(configurations, &axes);
        let total = Tally::resampled(&clusters, &vec![1; clusters.len()]);
        let point = total.rates();
        let (shown, no_interval) = intervals(bootstrap, clusters.len(), |draws| {
            Tally::resampled(&clusters, draws).rates().measures_with_intervals()
        });
        let [d_ci95, i_ci95, r_e_ci95, r_c_ci95, r_d_ci95] = shown;
        let failures = total.n - total.simultaneous;
        Some(Self {
            n: total.n,
            tasks: clusters.len() as u64,
            s_axis: axes.into_iter().zip(point.s_axis).collect(),
            s_indep: point.s_indep,
            s_conj: point.s_conj,
            s_sim: point.s_sim,
            d: point.s_conj - point.s_indep,
            d_ci95,
            i: point.s_sim - point.s_conj,
            i_ci95,
            b: total.b,
            c: total.c,
            r_e: point.r_e,
            r_e_ci95,
            r_c: point.r_c,
            r_c_ci95,
            r_d: point.r_e + point.r_c,
            r_d_ci95,
            no_interval,
            emergent_share: (failures > 0).then(|| total.b as f64 / failures as f64),
            mcnemar_p: mcnemar_exact(total.b, total.c),
        })
    }
}

/// Counts of successes, from which all measures follow; additive over clusters.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tally {
    n: u64,
    alone: Vec<u64>,
    conjunction: u64,
    simultaneous: u64,
    b: u64,
    c: u64,
}

/// Rates over the configurations of a [`Tally`].
pub(crate) struct Rates {
    s_axis: Vec<f64>,
    s_indep: f64,
    s_conj: f64,
    pub(crate) s_sim: f64,
    r_e: f64,
    r_c: f64,
}

impl Tally {
    /// Returns the tally of each task, ordered by task.
    pub(crate) fn of_tasks(configurations: &[Configuration], axes: &[Axis]) -> Vec<Self> {
        let mut clusters: BTreeMap<TaskRef, Self> = BTreeMap::new();
        for configuration in configurations {
            let tally = clusters.entry(configuration.task).or_default();
            tally.add(configuration, axes);
        }
        clusters.into_values().collect()
    }

    /// Sums the tallies, each weighted by the number of times that the resampling drew its task.
    pub(crate) fn resampled(clusters: &[Self], draws: &[u32]) -> Self {
        let mut total = Self::default();
        for (tally, &times) in clusters.iter().zip(draws) {
            total.merge(tally, u64::from(times));
        }
        total
    }

    fn add(&mut self, configuration: &Configuration, axes: &[Axis]) {
        let same_axes = configuration.alone.keys().eq(axes);
        assert!(same_axes, "configurations of one cell have the same axes");
        self.alone.resize(axes.len(), 0);
        for (count, &success) in self.alone.iter_mut().zip(configuration.alone.values()) {
            *count += u64::from(success);
        }
        let conjunction = configuration.conjunction();
        let simultaneous = configuration.simultaneous;
        self.n += 1;
        self.conjunction += u64::from(conjunction);
        self.simultaneous += u64::from(simultaneous);
        self.b += u64::from(conjunction && !simultaneous);
        self.c += u64::from(!conjunction && simultaneous);
    }

    fn merge(&mut self, other: &Self, times: u64) {
        self.alone.resize(other.alone.len(), 0);
        for (count, more) in self.alone.iter_mut().zip(&other.alone) {
            *count += times * more;
        }
        self.n += times * other.n;
        self.conjunction += times * other.conjunction;
        self.simultaneous += times * other.simultaneous;
        self.b += times * other.b;
        self.c += times * other.c;
    }

    pub(crate) fn rates(&self) -> Rates {
        let rate = |count: u64| count as f64 / self.n as f64;
        let s_axis: Vec<f64> = self.alone.iter().map(|&count| rate(count)).collect();
        Rates {
            s_indep: s_axis.iter().product(),
            s_axis,
            s_conj: rate(self.conjunction),
            s_sim: rate(self.simultaneous),
            r_e: rate(self.b),
            r_c: rate(self.c),
        }
    }
}

impl Rates {
    /// Returns the measures that get an interval: d, i, r_e, r_c, r_d.
    pub(crate) fn measures_with_intervals(&self) -> [f64; 5] {
        [
            self.s_conj - self.s_indep,
            self.s_sim - self.s_conj,
            self.r_e,
            self.r_c,
            self.r_e + self.r_c,
        ]
    }
}
