//! Manifests in JSON Lines: one row per line, in the format of the reference implementation.
//! Parses, validates, writes and compares manifests; the caller opens files, and `row` defines
//! the rows.
//!
//! An imported manifest is authoritative: its values and instructions are run unchanged, under the
//! rows' execution model. Inconsistent rows are therefore rejected, with their line numbers.

use std::collections::BTreeMap;
use std::fmt::{self, Write};

use serde_json::Value;

use crate::axis::Axis;
use crate::execution::Execution;
use crate::level::Level;
use crate::presets::unit;
use crate::rollout_id::RolloutId;
use crate::row::{MAX_ROWS, ManifestRow};
use crate::simulated::{ShortRow, TaskPlaces};
use crate::suite::TaskRef;
use crate::task_key::TaskKey;
use crate::wording::JsonError;

/// Largest number of errors listed; further errors are only counted.
const MAX_LISTED: usize = 20;

/// Largest relative deviation of the radius of a row's parameters from that of its level;
/// the published directions have only four or five decimals.
const RADIUS_TOLERANCE: f64 = 2e-3;

/// Rounding error of a parameter: half a unit of its sixth decimal, which matters at small
/// radii.
const ROUNDING: f64 = 0.5e-6;

/// Parses a manifest. Empty lines are skipped. Rows of other simulators may have their short form,
/// which `docs/SIMULATORS.md` describes. The error lists up to 20 faults, each with its line.
pub fn parse(text: &str) -> Result<Vec<ManifestRow>, ManifestErrors> {
    let mut rows = Vec::new();
    let mut checker = Checker::default();
    let mut places = TaskPlaces::default();
    for (index, text) in text.lines().enumerate() {
        if text.trim().is_empty() {
            continue;
        }
        let line = index + 1;
        match parse_row(text, &mut places) {
            Ok(row) => {
                checker.check(line, &row);
                rows.push(row);
            }
            Err(problem) => checker.errors.add(line, LineProblem::Row(problem)),
        }
    }
    checker.finish(rows.len())?;
    Ok(rows)
}

fn parse_row(text: &str, places: &mut TaskPlaces) -> Result<ManifestRow, String> {
    let described = |error: serde_json::Error| JsonError::from(error).problem().to_owned();
    let is_short = text.contains("\"simulator\"") && !text.contains("\"rollout_id\"");
    let row = match is_short {
        false => return serde_json::from_str(text).map_err(described),
        true => serde_json::from_str::<ShortRow>(text).map_err(described)?,
    };
    let row = row.complete(places).map_err(|problem| problem.to_string())?;
    // The full form is checked as that of a stored row.
    let full = serde_json::to_value(&row).expect("a row of text and numbers serialises");
    serde_json::from_value(full).map_err(described)
}

/// Validates rows that were not parsed from a text; errors number them from 1.
pub fn check(rows: &[ManifestRow]) -> Result<(), ManifestErrors> {
    let mut checker = Checker::default();
    for (index, row) in rows.iter().enumerate() {
        checker.check(index + 1, row);
    }
    checker.finish(rows.len())
}

/// Returns rows as a manifest, with the reference's names.
pub fn to_text<'a>(rows: impl IntoIterator<Item = &'a ManifestRow>) -> String {
    let mut text = String::new();
    for row in rows {
        text.push_str(&row.published());
        text.push('\n');
    }
    text
}

/// Returns the execution model that the rows share, apart from those whose axis sets it; `wait`
/// without such a row.
pub(crate) fn execution(rows: &[ManifestRow]) -> Execution {
    let shares = |row: &&ManifestRow| !row.id.condition().sets_execution();
    rows.iter().find(shares).map_or(Execution::Wait, |row| row.execution.clone())
}

/// Returns the differences between two manifests by rollout id, ignoring the order of rows.
pub fn diff(left: &[ManifestRow], right: &[ManifestRow]) -> Vec<Difference> {
    let by_id = |rows: &[ManifestRow]| -> BTreeMap<RolloutId, Value> {
        let json = |row: &ManifestRow| serde_json::to_value(row).expect("a row serialises");
        rows.iter().map(|row| (row.id, json(row))).collect()
    };
    let (left, mut right) = (by_id(left), by_id(right));
    let mut differences = Vec::new();
    for (id, left) in left {
        match right.remove(&id) {
            None => differences.push(Difference::OnlyLeft(id)),
            Some(right) => compare("", &left, &right, &mut |column, left, right| {
                differences.push(Difference::Value {
                    id,
                    column: column.to_owned(),
                    left: left.to_string(),
                    right: right.to_string(),
                });
            }),
        }
    }
    differences.extend(right.into_keys().map(Difference::OnlyRight));
    differences
}

/// One difference between two manifests.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Difference {
    OnlyLeft(RolloutId),
    OnlyRight(RolloutId),
    Value {
        id: RolloutId,
        /// The column, for example `perturb.camera.d_azimuth_deg`.
        column: String,
        /// JSON value in the first manifest.
        left: String,
        /// JSON value in the second manifest.
        right: String,
    },
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (Self::OnlyLeft(id) | Self::OnlyRight(id) | Self::Value { id, .. }) = self;
        let id = id.published();
        match self {
            Self::OnlyLeft(_) => write!(f, "{id}: only in the first manifest"),
            Self::OnlyRight(_) => write!(f, "{id}: only in the second manifest"),
            Self::Value { column, left, right, .. } => {
                write!(f, "{id}: {column} is {left} in the first manifest, {right} in the second")
            }
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct ManifestErrors {
    listed: Vec<LineError>,
    count: usize,
}

#[derive(Clone, Debug, PartialEq)]
pub struct LineError {
    /// The line, from 1.
    pub line: usize,
    pub problem: LineProblem,
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LineProblem {
    #[error("{0}")]
    Row(String),
    #[error("{id} is already in line {first}")]
    Duplicate { id: RolloutId, first: usize },
    #[error("{id}: {column} differ from those of its configuration in line {first}")]
    Unpaired {
        id: RolloutId,
        /// Words for the values that differ, such as `initial states`.
        column: String,
        first: usize,
    },
    #[error(
        "{id}: execution model `{given}`, but `{expected}` in line {first}: put rows of different \
             models into separate manifests"
    )]
    Execution { id: RolloutId, given: Execution, expected: Execution, first: usize },
    #[error(
        "{id}: {}, but {} in line {first}: put rows of different benchmarks into separate manifests",
        protocol_text(given),
        protocol_text(expected)
    )]
    Protocol { id: RolloutId, given: Option<String>, expected: Option<String>, first: usize },
    #[error(
        "{id}: its number stands for task {given}, but for {expected} in line {first}: rows that \
         extend a campaign begin with its tasks, in the order in which it has them"
    )]
    Task { id: RolloutId, given: String, expected: String, first: usize },
    #[error("more than {MAX_ROWS} rows: divide the manifest")]
    TooMany,
    #[error("the manifest has no rows")]
    NoRows,
    #[error("{id}: parameters of axis {axis} have radius {given:.3}, at {level} it is {expected}")]
    Radius {
        id: RolloutId,
        axis: Axis,
        level: Level,
        /// The parameters' radius in normalised coordinates.
        given: f64,
        expected: f64,
    },
}

impl ManifestErrors {
    pub fn listed(&self) -> &[LineError] {
        &self.listed
    }

    pub fn count(&self) -> usize {
        self.count
    }

    fn add(&mut self, line: usize, problem: LineProblem) {
        self.count += 1;
        if self.listed.len() < MAX_LISTED {
            self.listed.push(LineError { line, problem });
        }
    }
}

impl fmt::Display for ManifestErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The number of errors, which may exceed that of lines: a line can have several.
        let errors = if self.count == 1 { "error" } else { "errors" };
        write!(f, "read manifest: {} {errors}", self.count)?;
        for LineError { line, problem } in &self.listed {
            write!(f, "\n  line {line}: {problem}")?;
        }
        match self.count - self.listed.len() {
            0 => Ok(()),
            more => write!(f, "\n  and {more} more"),
        }
    }
}

impl std::error::Error for ManifestErrors {}

#[derive(Default)]
struct Checker {
    lines_of_ids: BTreeMap<RolloutId, usize>,
    configurations: BTreeMap<(TaskRef, Level, u16), Configuration>,
    /// Keys of other simulators' tasks, each with the line it was read from.
    simulated: BTreeMap<TaskRef, (String, usize)>,
    /// Execution model of the first row outside the latency axis, and the row's line.
    execution: Option<(Execution, usize)>,
    /// Protocol of the first row, and the row's line.
    protocol: Option<(Option<String>, usize)>,
    errors: ManifestErrors,
}

/// Initial state and axis parameters that all rows of a configuration at one level share, each
/// with the line it was read from.
struct Configuration {
    init_id: (usize, u16),
    values: BTreeMap<Axis, (usize, Vec<f64>)>,
}

impl Checker {
    fn check(&mut self, line: usize, row: &ManifestRow) {
        if let Err(problem) = check_radii(row) {
            self.errors.add(line, problem);
        }
        let id = row.id;
        if !id.condition().sets_execution() {
            self.check_execution(line, row);
        }
        if row.simulator.is_some() {
            let of_this_row = (TaskKey::of_row(row), line);
            let given = of_this_row.0.clone();
            let (expected, first) = self.simulated.entry(id.task()).or_insert(of_this_row).clone();
            if given != expected {
                self.errors.add(line, LineProblem::Task { id, given, expected, first });
            }
        }
        let (expected, first) = self.protocol.get_or_insert_with(|| (row.protocol.clone(), line));
        if *expected != row.protocol {
            let (given, expected, first) = (row.protocol.clone(), expected.clone(), *first);
            self.errors.add(line, LineProblem::Protocol { id, given, expected, first });
        }
        let first = *self.lines_of_ids.entry(id).or_insert(line);
        if first != line {
            self.errors.add(line, LineProblem::Duplicate { id, first });
        } else if let Some((column, first)) = self.difference(line, row) {
            let problem = LineProblem::Unpaired { id, column, first };
            self.errors.add(line, problem);
        }
    }

    /// Compares the execution model with that of the first row given here. Rows of the latency axis
    /// are not given, because their level sets their model.
    fn check_execution(&mut self, line: usize, row: &ManifestRow) {
        let of_this_row = (row.execution.clone(), line);
        let (expected, first) = self.execution.get_or_insert(of_this_row).clone();
        if expected != row.execution {
            let problem = LineProblem::Execution {
                id: row.id,
                given: row.execution.clone(),
                expected,
                first,
            };
            self.errors.add(line, problem);
        }
    }

    /// Returns words for the first values in which a row contradicts its configuration, and the
    /// line of the contradicted row.
    fn difference(&mut self, line: usize, row: &ManifestRow) -> Option<(String, usize)> {
        let key = (row.id.task(), row.id.level(), row.id.config()?);
        let entry = self.configurations.entry(key);
        let configuration = entry.or_insert_with(|| Configuration {
            init_id: (line, row.init_id),
            values: BTreeMap::new(),
        });
        if configuration.init_id.1 != row.init_id {
            return Some(("initial states".to_owned(), configuration.init_id.0));
        }
        row.perturbation.axes().into_iter().find_map(|axis| {
            let values = row.perturbation.values(axis);
            let (first, expected) =
                configuration.values.entry(axis).or_insert_with(|| (line, values.clone()));
            (*expected != values).then(|| (format!("parameters of axis {axis}"), *first))
        })
    }

    fn finish(mut self, rows: usize) -> Result<(), ManifestErrors> {
        if rows > MAX_ROWS {
            self.errors.add(MAX_ROWS + 1, LineProblem::TooMany);
        }
        if rows == 0 && self.errors.count == 0 {
            self.errors.add(1, LineProblem::NoRows);
        }
        match self.errors.count {
            0 => Ok(()),
            _ => Err(self.errors),
        }
    }
}

fn protocol_text(protocol: &Option<String>) -> String {
    protocol.as_ref().map_or_else(|| "no protocol".to_owned(), |name| format!("protocol `{name}`"))
}

fn check_radii(row: &ManifestRow) -> Result<(), LineProblem> {
    // The units of another simulator may be its own.
    if row.simulator.is_some() {
        return Ok(());
    }
    let (id, level) = (row.id, row.id.level());
    let expected = row.radius();
    for axis in row.perturbation.axes() {
        let values = row.perturbation.values(axis);
        let normalised = values.iter().zip(unit(axis)).map(|(x, unit)| x / unit);
        let given = normalised.map(|x| x * x).sum::<f64>().sqrt();
        let rounding = unit(axis).iter().map(|unit| ROUNDING / unit);
        let rounding = rounding.map(|x| x * x).sum::<f64>().sqrt();
        if (given - expected).abs() > RADIUS_TOLERANCE * expected + rounding {
            return Err(LineProblem::Radius { id, axis, level, given, expected });
        }
    }
    Ok(())
}

fn compare(path: &str, left: &Value, right: &Value, report: &mut impl FnMut(&str, &Value, &Value)) {
    let (Value::Object(left_fields), Value::Object(right_fields)) = (left, right) else {
        if left != right {
            report(path, left, right);
        }
        return;
    };
    let mut keys: Vec<&String> = left_fields.keys().chain(right_fields.keys()).collect();
    keys.sort_unstable();
    keys.dedup();
    for key in keys {
        let mut path = path.to_owned();
        if !path.is_empty() {
            path.push('.');
        }
        let _ = write!(path, "{key}");
        let (left, right) = (left_fields.get(key), right_fields.get(key));
        compare(&path, left.unwrap_or(&Value::Null), right.unwrap_or(&Value::Null), report);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::Design;

    fn rows() -> Vec<ManifestRow> {
        Design::v0_1().expand().expect("rows")
    }

    fn check_refused(line: &str, expected: &str) {
        let valid = to_text(&rows()[..1]);
        let errors = parse(&format!("{valid}\n{line}\n")).expect_err(expected);
        assert_eq!(errors.count(), 1);
        assert_eq!(errors.listed()[0].line, 3);
        let message = errors.to_string();
        assert!(message.starts_with("read manifest: 1 error\n"), "{message}");
        assert!(message.contains(expected), "{message}");
    }

    #[test]
    fn a_manifest_is_parsed_from_its_text() {
        let rows = rows();
        let read = parse(&to_text(&rows)).expect("reads back");
        assert_eq!(read, rows);
        assert_eq!(diff(&read, &rows), []);
    }

    #[test]
    fn refused_lines_are_listed_with_number_and_reason() {
        let rows = rows();
        let sensor = to_text(&rows[4..5]);
        assert!(sensor.contains("sensor/L1"), "{sensor}");
        check_refused("{\"rollout_id\": ", "the text ends too early");
        check_refused(&to_text(&rows[..1]), "is already in line 1");
        check_refused(
            &sensor.replace("blur_sigma", "d_azimuth_deg"),
            "there is no field `d_azimuth_deg`",
        );
        check_refused(
            &sensor.replace("sensor/L1", "sensor/L2"),
            "`level` is L1, but the id says L2",
        );
        check_refused(&sensor.replace("L1", "L4"), "read level `L4`");
        check_refused(&sensor.replace("\"init_id\":43", "\"init_id\":50"), "0 to 49");
        check_refused(&sensor.replace("L1", "L2"), "axis sensor have radius 2.000, at L2 it is 4");
    }

    #[test]
    fn rows_that_differ_from_their_configuration_are_refused() {
        let rows = rows();
        let unit = &rows[1..8];
        assert!(check(unit).is_ok());
        let check = |change: fn(&mut ManifestRow), expected: &str| {
            let mut unit = unit.to_vec();
            change(&mut unit[6]);
            let message = check(&unit).expect_err(expected).to_string();
            assert!(message.contains(expected), "{message}");
        };
        check(
            |row| row.init_id += 1,
            "line 7: spatial/t0/simultaneous/L1/c00: initial states differ from those of its \
             configuration in line 1",
        );
        check(
            |row| {
                row.init_id += 1;
                row.execution = "hold:3".parse().expect("an execution model");
            },
            "read manifest: 2 errors\n  line 7: ",
        );
        check(
            |row| row.perturbation.robot.as_mut().expect("all axes").eef_dx_m *= -1.0,
            "parameters of axis robot differ from those of its configuration in line 3",
        );
    }

    #[test]
    fn every_duplicate_names_the_first_line_with_its_id() {
        let errors = parse(&to_text(&rows()[..1]).repeat(3)).expect_err("duplicates");
        let firsts = errors.listed().iter().map(|error| match error.problem {
            LineProblem::Duplicate { first, .. } => Some((error.line, first)),
            _ => None,
        });
        assert_eq!(firsts.collect::<Vec<_>>(), [Some((2, 1)), Some((3, 1))]);
    }

    #[test]
    fn many_errors_are_listed_up_to_a_bound() {
        let errors = parse(&"{}\n".repeat(50)).expect_err("fifty errors");
        assert_eq!((errors.count(), errors.listed().len()), (50, MAX_LISTED));
        assert!(errors.to_string().ends_with("and 30 more"), "{errors}");
    }

    #[test]
    fn differences_name_row_and_column() {
        let left = rows();
        let mut right = left.clone();
        right[1].perturbation.camera.as_mut().expect("a camera row").d_azimuth_deg = 1.0;
        right[2].instruction.push('!');
        let removed = right.pop().expect("rows").id;
        let differences: Vec<String> =
            diff(&left, &right).iter().map(Difference::to_string).collect();
        assert_eq!(differences.len(), 3, "{differences:?}");
        let all = differences.join("\n");
        assert!(all.contains(
            "spatial/t0/camera/L1/c00: perturb.d_azimuth_deg is 0.063986 in the first manifest, 1.0 \
             in the second"
        ));
        assert!(all.contains("language is \"pick up the black bowl"), "{all}");
        let removed = removed.published();
        assert!(all.contains(&format!("{removed}: only in the first manifest")), "{all}");
    }
}
