//! Python class of the schedule of queries whose responses take effect late.

use libero_ctrl::{ACTION_WIDTH, Action, Execution, TaskRef};
use numpy::{PyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::action::{self, Numbers};
use crate::error::{invalid, value};
use crate::state::shaped;

/// Delay of a response, control steps, and the commands scheduled for the next steps, [n, 7]. The
/// commands within the delay are executed regardless of the response.
type Query<'py> = (u32, Bound<'py, PyArrayDyn<f64>>);

/// Schedule of one rollout's commands and of its queries, whose responses take effect late, as in a
/// campaign's rollout with the same execution model.
#[pyclass(module = "rollout_libero._native")]
pub(crate) struct Schedule {
    execution: Execution,
    inner: libero_ctrl::Schedule,
}

#[pymethods]
impl Schedule {
    /// Creates the schedule of a rollout of `task` from an initial state. `execute` is the number
    /// of actions of each response that are executed; by default all. The gripper starts open.
    #[new]
    #[pyo3(signature = (execution, task, init_state, *, execute = None))]
    fn new(execution: &str, task: &str, init_state: u16, execute: Option<usize>) -> PyResult<Self> {
        let execution: Execution = execution.parse().map_err(value)?;
        let task: TaskRef = task.parse().map_err(value)?;
        if execute == Some(0) {
            return Err(invalid(
                "use execute 0: give 1 or more actions of each answer, or None for all",
            ));
        }
        let execute = execute.unwrap_or(usize::MAX);
        let inner = libero_ctrl::Schedule::new(execution.clone(), execute, task, init_state);
        Ok(Self { execution, inner })
    }

    /// Execution model.
    #[getter]
    fn execution(&self) -> String {
        self.execution.to_string()
    }

    /// True under real-time chunking: the policy is sent the commands of the query, too.
    #[getter]
    fn is_rtc(&self) -> bool {
        self.execution.is_rtc()
    }

    /// Returns the query that is due before the next control step; `None` if none is.
    fn due<'py>(&self, py: Python<'py>) -> PyResult<Option<Query<'py>>> {
        let query = self.inner.due();
        let query = query.map(|query| Ok((query.delay, rows(py, query.under_way)?)));
        query.transpose()
    }

    /// Sets the response to the due query: actions, [n, 7].
    fn answer(&mut self, actions: Numbers<'_>) -> PyResult<()> {
        if self.inner.due().is_none() {
            return Err(invalid(
                "answer a query: none is due; call advance until due() returns one",
            ));
        }
        let count = match *actions.shape() {
            [count, _] if count > 0 => count,
            ref shape => {
                return Err(invalid(format_args!(
                    "answer a query with actions of shape {shape:?}: expected [n, {ACTION_WIDTH}]"
                )));
            }
        };
        self.execution.check(count).map_err(value)?;
        let actions = action::actions(&actions, &[count, ACTION_WIDTH])?;
        self.inner.answer(actions);
        Ok(())
    }

    /// Returns the action of the next control step, 7 numbers, and advances by one step.
    fn advance<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        if self.inner.due().is_some() {
            return Err(invalid("advance a schedule: a query is due; call answer first"));
        }
        let command = self.inner.advance();
        shaped(py, command.action.to_vec(), &[ACTION_WIDTH])
    }

    /// Returns the actions of all control steps until the next query is due, [n, 7], and advances
    /// by as many.
    fn until_due<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let mut actions = Vec::new();
        while self.inner.due().is_none() {
            actions.push(self.inner.advance().action);
        }
        rows(py, actions)
    }

    /// Returns an independent copy.
    fn copy(&self) -> Self {
        Self { execution: self.execution.clone(), inner: self.inner.clone() }
    }
}

fn rows(py: Python<'_>, actions: Vec<Action>) -> PyResult<Bound<'_, PyArrayDyn<f64>>> {
    let shape = [actions.len(), ACTION_WIDTH];
    shaped(py, actions.into_flattened(), &shape)
}
