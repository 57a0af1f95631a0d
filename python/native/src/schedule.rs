use benchmark::{ACTION_WIDTH, Action, Execution, TaskRef};
use numpy::{PyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::action::{self, Numbers};
use crate::error::{invalid, value};
use crate::state::shaped;

/// Delay of a response, control steps, and the commands scheduled for the next steps, [n, 7]. The
/// commands within the delay are executed regardless of the response.
type Query<'py> = (u32, Bound<'py, PyArrayDyn<f64>>);

#[pyclass(module = "rollout_libero._native")]
pub(crate) struct Schedule {
    execution: Execution,
    inner: benchmark::Schedule,
}

#[pymethods]
impl Schedule {
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
        let inner = benchmark::Schedule::new(execution.clone(), execute, task, init_state);
        Ok(Self { execution, inner })
    }

    #[getter]
    fn execution(&self) -> String {
        self.execution.to_string()
    }

    #[getter]
    fn is_rtc(&self) -> bool {
        self.execution.is_rtc()
    }

    fn due<'py>(&self, py: Python<'py>) -> PyResult<Option<Query<'py>>> {
        let query = self.inner.due();
        let query = query.map(|query| Ok((query.delay, rows(py, query.under_way)?)));
        query.transpose()
    }

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

    fn advance<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        if self.inner.due().is_some() {
            return Err(invalid("advance a schedule: a query is due; call answer first"));
        }
        let command = self.inner.advance();
        shaped(py, command.action.to_vec(), &[ACTION_WIDTH])
    }

    fn until_due<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let mut actions = Vec::new();
        while self.inner.due().is_none() {
            actions.push(self.inner.advance().action);
        }
        rows(py, actions)
    }

    fn copy(&self) -> Self {
        Self { execution: self.execution.clone(), inner: self.inner.clone() }
    }
}

fn rows(py: Python<'_>, actions: Vec<Action>) -> PyResult<Bound<'_, PyArrayDyn<f64>>> {
    let shape = [actions.len(), ACTION_WIDTH];
    shaped(py, actions.into_flattened(), &shape)
}
