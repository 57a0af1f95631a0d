//! Schedule of a rollout under an execution model: the steps at which the policy is queried,
//! and the command of each control step. Counts control steps and reads no clock.
//!
//! The response to a query at step t with a delay of N steps takes effect at step t + N. Under
//! `wait` and `hold`, the first action of the response is executed at step t + N, and the next
//! query is due after `execute` actions, or after the last action of a shorter response. Under
//! `overlap`, action i belongs to step t + i, so that the first N actions are dropped; with L
//! actions in the response, the next query is due at t + max(N, min(execute, L − N)): after
//! `execute` steps, or earlier, so that the next response takes effect no later than the current
//! response ends, but never while a response is pending. When no action remains, the arm holds
//! still.

use crate::execution::Execution;
use crate::suite::TaskRef;

/// Number of components of an action: translation (3), rotation (3), gripper.
pub const ACTION_WIDTH: usize = 7;

/// One control step's action.
pub type Action = [f64; ACTION_WIDTH];

const GRIPPER: usize = ACTION_WIDTH - 1;
/// Gripper command that keeps the gripper open, as in the steps in which the scene settles.
const OPEN: f64 = -1.0;

#[derive(Clone, Debug)]
pub struct Schedule {
    execution: Execution,
    execute: u32,
    task: TaskRef,
    init_id: u16,
    step: u32,
    queries: u32,
    /// Step before which the next query is due.
    next_query: u32,
    /// The response whose actions are executed.
    current: Option<Answer>,
    /// The last response, until it takes effect.
    pending: Option<Answer>,
    gripper: f64,
}

#[derive(Clone, Debug)]
struct Answer {
    query: u32,
    /// Step of the first action, which may be dropped.
    first_step: u32,
    /// Step at which the response takes effect.
    effective_from: u32,
    actions: Vec<Action>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Query {
    /// Number of control steps until the response takes effect.
    pub delay: u32,
    /// Commands scheduled for the next steps. The first `delay` commands are executed regardless of
    /// the response; the later commands are the remaining actions of the previous response.
    pub under_way: Vec<Action>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    pub action: Action,
    /// Number of the query, and index in its response; `None` if the arm holds still.
    pub source: Option<(u32, usize)>,
}

impl Schedule {
    /// Creates the schedule of a rollout of `task` from an initial state, with a policy that
    /// executes `execute` actions of each response.
    pub fn new(execution: Execution, execute: usize, task: TaskRef, init_id: u16) -> Self {
        Self {
            execution,
            execute: u32::try_from(execute).unwrap_or(u32::MAX).max(1),
            task,
            init_id,
            step: 0,
            queries: 0,
            next_query: 0,
            current: None,
            pending: None,
            gripper: OPEN,
        }
    }

    /// The gripper is open by default.
    pub fn with_gripper(self, gripper: f64) -> Self {
        Self { gripper, ..self }
    }

    /// Returns the query that is due before the next step; `None` if no query is due. A query stays
    /// due until [`Self::answer`] is called.
    pub fn due(&self) -> Option<Query> {
        (self.step >= self.next_query).then(|| {
            let delay = self.delay();
            let remaining = self.current().map_or(&[][..], |answer| {
                let done = (self.step - answer.first_step) as usize;
                answer.actions.get(done..).unwrap_or_default()
            });
            let mut under_way = remaining.to_vec();
            let gripper = remaining.last().map_or(self.gripper, |action| action[GRIPPER]);
            // The arm holds still from the end of the current response until the next response
            // takes effect.
            if under_way.len() < delay as usize {
                under_way.resize(delay as usize, hold(gripper));
            }
            Query { delay, under_way }
        })
    }

    pub fn answer(&mut self, mut actions: Vec<Action>) {
        let (step, delay) = (self.step, self.delay());
        // The count fits, because the size of a message limits the number of actions.
        let mut count = actions.len() as u32;
        let (first_step, steps_to_query) = match self.execution {
            Execution::Wait | Execution::Hold(_) => {
                actions.truncate(self.execute as usize);
                count = count.min(self.execute);
                (step + delay, delay + count)
            }
            Execution::Overlap { .. } => {
                let usable = count.saturating_sub(delay);
                (step, delay.max(self.execute.min(usable)))
            }
        };
        if let Some(response) = self.pending.take() {
            self.current = Some(response);
        }
        self.pending =
            Some(Answer { query: self.queries, first_step, effective_from: step + delay, actions });
        self.queries += 1;
        self.next_query = step + steps_to_query.max(1);
    }

    pub fn advance(&mut self) -> Command {
        let step = self.step;
        if let Some(response) = self.pending.take_if(|answer| answer.effective_from <= step) {
            self.current = Some(response);
        }
        let scheduled = self.current().and_then(|answer| {
            let index = (step - answer.first_step) as usize;
            Some((*answer.actions.get(index)?, (answer.query, index)))
        });
        self.step += 1;
        match scheduled {
            Some((action, source)) => {
                self.gripper = action[GRIPPER];
                Command { action, source: Some(source) }
            }
            None => Command { action: hold(self.gripper), source: None },
        }
    }

    fn current(&self) -> Option<&Answer> {
        let effective = self.pending.as_ref().filter(|answer| answer.effective_from <= self.step);
        effective.or(self.current.as_ref())
    }

    fn delay(&self) -> u32 {
        let delays = self.execution.delays();
        delays.map_or(0, |delays| delays.of_query(self.task, self.init_id, self.queries).into())
    }
}

/// Returns the action that holds the arm still with the given gripper command.
fn hold(gripper: f64) -> Action {
    let mut action = [0.0; ACTION_WIDTH];
    action[GRIPPER] = gripper;
    action
}
