//! Configurations as rows of numbers, and the grouped jackknife over them, which estimates
//! a statistic's variance over tasks, directions and rollouts.

use std::collections::{BTreeMap, BTreeSet};

use benchmark::{Directions, Suite, TaskRef};

/// One configuration of one replicate as a row of addends.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    pub(crate) task: TaskRef,
    /// Number of the configuration, which is also the number of the shared direction.
    pub(crate) direction: u16,
    /// Addends; every row has the same columns. A statistic is a function of their sums.
    pub(crate) values: Vec<f64>,
}

/// Variances up to this are rounding errors of equal values.
pub(crate) const NO_VARIANCE: f64 = 1e-24;

/// Rows with their sums by group, computed once for all statistics.
#[derive(Clone, Debug)]
pub(crate) struct Sample {
    rows: usize,
    sums: Vec<f64>,
    tasks: BTreeSet<TaskRef>,
    directions: Directions,
    /// Strata are suites, groups are tasks.
    tasks_in_suites: Vec<Stratum>,
    /// Strata are suites, groups are single rows.
    rows_in_suites: Vec<Stratum>,
    /// Strata are tasks, groups are single rows.
    rows_in_tasks: Vec<Stratum>,
    /// A single stratum, whose groups are directions.
    by_direction: Stratum,
}

/// Groups that the jackknife leaves out one at a time.
#[derive(Clone, Debug)]
struct Stratum {
    /// The sums of each group.
    groups: Vec<Vec<f64>>,
    /// The sums over all groups.
    whole: Vec<f64>,
}

impl Stratum {
    fn new(groups: Vec<Vec<f64>>) -> Self {
        Self { whole: sums(groups.iter()), groups }
    }
}

/// A variance and its degrees of freedom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Variance {
    pub(crate) value: f64,
    pub(crate) df: f64,
}

/// The variances of a statistic for each target of inference; `None` if the rows do not
/// determine one.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Variances {
    pub(crate) these_tasks: Option<Variance>,
    pub(crate) new_tasks: Option<Variance>,
    pub(crate) new_tasks_and_directions: Option<Variance>,
}

impl Sample {
    /// Sums the rows by group; `None` if there are no rows. The replicates of a configuration are
    /// one row, because their outcomes depend on one another.
    pub(crate) fn new(rows: &[Row], directions: Directions) -> Option<Self> {
        if rows.is_empty() {
            return None;
        }
        let mut units: BTreeMap<(TaskRef, u16), Row> = BTreeMap::new();
        for row in rows {
            let add = |unit: &mut Row| unit.values = sums([&unit.values, &row.values].into_iter());
            let unit = units.entry((row.task, row.direction));
            unit.and_modify(add).or_insert_with(|| row.clone());
        }
        let rows: Vec<Row> = units.into_values().collect();
        let in_suites = tasks_in_suites(&rows);
        let values = |row: &&Row| row.values.clone();
        let total = |task: &Vec<&Row>| sums(task.iter().map(|row| &row.values));
        let tasks_in_suites = in_suites.iter();
        let tasks_in_suites =
            tasks_in_suites.map(|tasks| Stratum::new(tasks.iter().map(total).collect()));
        let rows_in_suites = in_suites.iter();
        let rows_in_suites =
            rows_in_suites.map(|tasks| Stratum::new(tasks.iter().flatten().map(values).collect()));
        let rows_in_tasks = in_suites.iter().flatten();
        let rows_in_tasks =
            rows_in_tasks.map(|task| Stratum::new(task.iter().map(values).collect()));
        let mut by_direction: BTreeMap<u16, Vec<&Row>> = BTreeMap::new();
        for row in &rows {
            by_direction.entry(row.direction).or_default().push(row);
        }
        Some(Self {
            rows: rows.len(),
            sums: sums(rows.iter().map(|row| &row.values)),
            tasks: rows.iter().map(|row| row.task).collect(),
            directions,
            tasks_in_suites: tasks_in_suites.collect(),
            rows_in_suites: rows_in_suites.collect(),
            rows_in_tasks: rows_in_tasks.collect(),
            by_direction: Stratum::new(by_direction.values().map(total).collect()),
        })
    }

    pub(crate) fn sums(&self) -> &[f64] {
        &self.sums
    }

    pub(crate) fn tasks(&self) -> usize {
        self.tasks.len()
    }

    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// Returns the variances of a statistic, which must be a function of sums that is
    /// invariant under scaling all of them by the same factor.
    ///
    /// V_T leaves out one task at a time and V_TD one configuration, both within strata of
    /// suites; V_D leaves out one direction at a time. The variance for new tasks is V_T; for
    /// new tasks and new directions it is V_T too if tasks have directions of their own, otherwise
    /// V_T + V_D − V_TD, at least the greater of V_T and V_D, with Satterthwaite's degrees of
    /// freedom. The variance for the sampled tasks
    /// themselves (`these_tasks`) leaves out one configuration at a time within its task. This
    /// variance counts effects of directions within a task as chance, and so is never too small.
    ///
    /// Sources: J. N. K. Rao and J. Shao, Jackknife variance estimation with survey data,
    /// Biometrika 79 (1992), 811–822 (strata); A. C. Cameron, J. B. Gelbach and
    /// D. L. Miller, Robust inference with multiway clustering, Journal of Business and
    /// Economic Statistics 29 (2011), 238–249 (crossed clusters); F. E. Satterthwaite,
    /// Biometrics Bulletin 2 (1946), 110–114.
    pub(crate) fn variances(&self, statistic: &dyn Fn(&[f64]) -> f64) -> Variances {
        let new_tasks = self.jackknife(statistic, &self.tasks_in_suites);
        let these_tasks = self.jackknife(statistic, &self.rows_in_tasks);
        let new_tasks_and_directions = match self.directions {
            Directions::Own => new_tasks,
            Directions::Shared => new_tasks.and_then(|tasks| {
                let directions =
                    self.jackknife(statistic, std::slice::from_ref(&self.by_direction))?;
                let cells = self.jackknife(statistic, &self.rows_in_suites)?;
                Some(crossed(tasks, directions, cells))
            }),
        };
        Variances { these_tasks, new_tasks, new_tasks_and_directions }
    }

    /// Returns Σ_h (G_h − 1)/G_h · Σ_i (θ_(hi) − θ̄_h)² for G_h groups in stratum h, with θ_(hi)
    /// the statistic without group i of stratum h, and Σ_h (G_h − 1) degrees of freedom. `None` if
    /// a stratum has fewer than two groups, or if a θ_(hi) is undefined.
    fn jackknife(&self, statistic: &dyn Fn(&[f64]) -> f64, strata: &[Stratum]) -> Option<Variance> {
        let (mut value, mut df) = (0.0, 0.0);
        for stratum in strata {
            let groups = stratum.groups.len() as f64;
            if stratum.groups.len() < 2 {
                return None;
            }
            let without = self.without_each(statistic, stratum);
            let mean = without.iter().sum::<f64>() / groups;
            let squares = without.iter().map(|value| (value - mean).powi(2));
            value += (groups - 1.0) / groups * squares.sum::<f64>();
            df += groups - 1.0;
        }
        value.is_finite().then_some(Variance { value, df })
    }

    /// Returns the statistic without each group of a stratum in turn. The other groups of
    /// the stratum are scaled up, so that strata keep their weights.
    fn without_each(&self, statistic: &dyn Fn(&[f64]) -> f64, stratum: &Stratum) -> Vec<f64> {
        let groups = stratum.groups.len() as f64;
        let scale = groups / (groups - 1.0);
        let mut sums = self.sums.clone();
        let without = stratum.groups.iter().map(|group| {
            let columns = self.sums.iter().zip(&stratum.whole).zip(group);
            for (column, ((sum, whole), group)) in sums.iter_mut().zip(columns) {
                *column = sum + (whole - group) * scale - whole;
            }
            statistic(&sums)
        });
        without.collect()
    }
}

/// Returns the two-way clustered variance V_T + V_D − V_TD, at least max(V_T, V_D).
fn crossed(tasks: Variance, directions: Variance, cells: Variance) -> Variance {
    let value =
        (tasks.value + directions.value - cells.value).max(tasks.value).max(directions.value);
    let part = |variance: Variance| variance.value.powi(2) / variance.df;
    let df = match value > NO_VARIANCE {
        true => value.powi(2) / (part(tasks) + part(directions) + part(cells)),
        false => tasks.df.min(directions.df),
    };
    Variance { value, df }
}

/// Groups rows by task in strata of suites, or in a single stratum if any suite has only one
/// task.
fn tasks_in_suites(rows: &[Row]) -> Vec<Vec<Vec<&Row>>> {
    let mut suites: BTreeMap<Suite, BTreeMap<TaskRef, Vec<&Row>>> = BTreeMap::new();
    for row in rows {
        let tasks = suites.entry(row.task.suite()).or_default();
        tasks.entry(row.task).or_default().push(row);
    }
    let strata: Vec<Vec<Vec<&Row>>> =
        suites.into_values().map(|tasks| tasks.into_values().collect()).collect();
    match strata.iter().any(|tasks| tasks.len() < 2) {
        true => vec![strata.into_iter().flatten().collect()],
        false => strata,
    }
}

fn sums<'a>(rows: impl Iterator<Item = &'a Vec<f64>>) -> Vec<f64> {
    let mut total = Vec::new();
    for row in rows {
        total.resize(row.len(), 0.0);
        for (total, value) in total.iter_mut().zip(row) {
            *total += value;
        }
    }
    total
}
