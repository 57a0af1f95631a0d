//! Configurations as rows of numbers, and the grouped jackknife over them: how far a
//! statistic would move with other tasks, other directions or other rollouts.

use std::collections::{BTreeMap, BTreeSet};

use protocol::TaskRef;

/// One configuration: what is added up of it.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    /// Its task.
    pub(crate) task: TaskRef,
    /// Its number, which is the direction's that all tasks share.
    pub(crate) direction: u16,
    /// Numbers, the same for every row. A statistic is a function of their sums.
    pub(crate) values: Vec<f64>,
}

/// How directions are assigned to configurations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Directions {
    /// Configuration c of every task shares its directions, as in the paper.
    #[default]
    Shared,
    /// Every task has directions of its own, so that new tasks are new directions too.
    Own,
}

/// Rows, grouped once.
#[derive(Clone, Debug)]
pub(crate) struct Sample<'a> {
    rows: &'a [Row],
    directions: Directions,
    sums: Vec<f64>,
    tasks: BTreeSet<TaskRef>,
}

/// A variance and its degrees of freedom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Variance {
    pub(crate) value: f64,
    pub(crate) df: f64,
}

/// The variances of a statistic for each target of inference; absent where the rows
/// cannot tell.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Variances {
    pub(crate) these_tasks: Option<Variance>,
    pub(crate) new_tasks: Option<Variance>,
    pub(crate) new_tasks_and_directions: Option<Variance>,
}

impl<'a> Sample<'a> {
    /// None of no row.
    pub(crate) fn new(rows: &'a [Row], directions: Directions) -> Option<Self> {
        let columns = rows.first()?.values.len();
        Some(Self {
            rows,
            directions,
            sums: sums(rows.iter(), columns),
            tasks: rows.iter().map(|row| row.task).collect(),
        })
    }

    pub(crate) fn sums(&self) -> &[f64] {
        &self.sums
    }

    pub(crate) fn tasks(&self) -> usize {
        self.tasks.len()
    }

    pub(crate) fn rows(&self) -> usize {
        self.rows.len()
    }

    /// The variances of a statistic: a function of sums that does not change when all of
    /// them are multiplied by one number.
    ///
    /// V_T and V_TD leave out a task and a configuration at a time, within strata of
    /// suites, V_D a direction at a time. Of new tasks the variance is V_T; of new tasks
    /// and new directions it is V_T + V_D − V_TD, at least the greater of V_T and V_D,
    /// with Satterthwaite's degrees of freedom. Of these tasks, configurations are left
    /// out within their tasks; that counts what directions do within a task as chance,
    /// so that it is never too small.
    ///
    /// Sources: J. N. K. Rao and J. Shao, Jackknife variance estimation with survey data,
    /// Biometrika 79 (1992), 811–822 (strata); A. C. Cameron, J. B. Gelbach and
    /// D. L. Miller, Robust inference with multiway clustering, Journal of Business and
    /// Economic Statistics 29 (2011), 238–249 (crossed clusters); F. E. Satterthwaite,
    /// Biometrics Bulletin 2 (1946), 110–114.
    pub(crate) fn variances(&self, statistic: &dyn Fn(&[f64]) -> f64) -> Variances {
        let tasks = self.jackknife(statistic, &self.tasks_in_suites());
        let within = self.jackknife(statistic, &self.rows_in_tasks());
        let both = match self.directions {
            Directions::Own => tasks,
            Directions::Shared => tasks.and_then(|tasks| {
                let directions = self.jackknife(statistic, &[self.by_direction()])?;
                let cells = self.jackknife(statistic, &self.rows_in_suites())?;
                Some(crossed(tasks, directions, cells))
            }),
        };
        Variances {
            these_tasks: within,
            new_tasks: tasks,
            new_tasks_and_directions: both,
        }
    }

    /// How far the statistic moves when a task is left out, times −(G − 1), in the order
    /// of the tasks: the mean of these pseudo-values' squares over G is the variance.
    pub(crate) fn pseudo_values(
        &self,
        statistic: &dyn Fn(&[f64]) -> f64,
    ) -> BTreeMap<TaskRef, f64> {
        let mut pseudo = BTreeMap::new();
        for stratum in self.tasks_in_suites() {
            let groups = stratum.len() as f64;
            let without: Vec<f64> = self.without_each(statistic, &stratum);
            let mean = without.iter().sum::<f64>() / groups;
            for (group, value) in stratum.iter().zip(without) {
                let task = self.rows[group[0]].task;
                pseudo.insert(task, (groups - 1.0).max(1.0) * (mean - value));
            }
        }
        pseudo
    }

    /// Σ_h (G_h − 1)/G_h · Σ_i (θ_(hi) − θ̄_h)², G_h groups in stratum h, with
    /// Σ_h (G_h − 1) degrees of freedom. None where a stratum has one group.
    fn jackknife(
        &self,
        statistic: &dyn Fn(&[f64]) -> f64,
        strata: &[Vec<Vec<usize>>],
    ) -> Option<Variance> {
        let (mut value, mut df) = (0.0, 0.0);
        for stratum in strata {
            let groups = stratum.len() as f64;
            if stratum.len() < 2 {
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

    /// The statistic without each group of a stratum; the others of that stratum stand in
    /// for it, so that strata keep their weights.
    fn without_each(&self, statistic: &dyn Fn(&[f64]) -> f64, stratum: &[Vec<usize>]) -> Vec<f64> {
        let columns = self.sums.len();
        let of_groups: Vec<Vec<f64>> = stratum
            .iter()
            .map(|group| sums(group.iter().map(|&row| &self.rows[row]), columns))
            .collect();
        let mut whole = vec![0.0; columns];
        for group in &of_groups {
            add(&mut whole, group, 1.0);
        }
        let groups = stratum.len() as f64;
        let stand_in = groups / (groups - 1.0).max(1.0);
        let without = of_groups.iter().map(|group| {
            let mut rest = self.sums.clone();
            for ((rest, whole), group) in rest.iter_mut().zip(&whole).zip(group) {
                *rest += (whole - group) * stand_in - whole;
            }
            statistic(&rest)
        });
        without.collect()
    }

    /// Tasks in strata of suites; in one stratum where a suite has a single task.
    fn tasks_in_suites(&self) -> Vec<Vec<Vec<usize>>> {
        let mut suites: BTreeMap<_, BTreeMap<TaskRef, Vec<usize>>> = BTreeMap::new();
        for (index, row) in self.rows.iter().enumerate() {
            let tasks = suites.entry(row.task.suite()).or_default();
            tasks.entry(row.task).or_default().push(index);
        }
        let of_suites = suites
            .into_values()
            .map(|tasks| tasks.into_values().collect());
        merged_if_single(of_suites.collect())
    }

    fn rows_in_suites(&self) -> Vec<Vec<Vec<usize>>> {
        let tasks = self.tasks_in_suites().into_iter();
        let rows =
            tasks.map(|stratum| stratum.into_iter().flatten().map(|row| vec![row]).collect());
        rows.collect()
    }

    fn rows_in_tasks(&self) -> Vec<Vec<Vec<usize>>> {
        let tasks = self.tasks_in_suites().into_iter().flatten();
        tasks
            .map(|task| task.into_iter().map(|row| vec![row]).collect())
            .collect()
    }

    fn by_direction(&self) -> Vec<Vec<usize>> {
        let mut directions: BTreeMap<u16, Vec<usize>> = BTreeMap::new();
        for (index, row) in self.rows.iter().enumerate() {
            directions.entry(row.direction).or_default().push(index);
        }
        directions.into_values().collect()
    }
}

/// V_T + V_D − V_TD, at least the greater of V_T and V_D.
fn crossed(tasks: Variance, directions: Variance, cells: Variance) -> Variance {
    let value = (tasks.value + directions.value - cells.value)
        .max(tasks.value)
        .max(directions.value);
    let parts = tasks.value.powi(2) / tasks.df + directions.value.powi(2) / directions.df;
    let df = match parts > 0.0 {
        true => (tasks.value + directions.value).powi(2) / parts,
        false => tasks.df.min(directions.df),
    };
    Variance { value, df }
}

fn merged_if_single<T>(strata: Vec<Vec<T>>) -> Vec<Vec<T>> {
    match strata.iter().any(|groups| groups.len() < 2) {
        true => vec![strata.into_iter().flatten().collect()],
        false => strata,
    }
}

fn sums<'a>(rows: impl Iterator<Item = &'a Row>, columns: usize) -> Vec<f64> {
    let mut total = vec![0.0; columns];
    for row in rows {
        add(&mut total, &row.values, 1.0);
    }
    total
}

fn add(total: &mut [f64], values: &[f64], times: f64) {
    for (total, value) in total.iter_mut().zip(values) {
        *total += times * value;
    }
}
