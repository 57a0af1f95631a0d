//! Schedule of a rollout: when the policy is asked, and which command is executed at each
//! control step, under an execution model. Counts control steps and reads no clock.
//!
//! A query at step t whose answer is N steps late takes effect at step t + N. Under `wait` and
//! `hold` its first action is executed then, and the next query is due once `execute` actions,
//! or all, have been. Under `overlap` action i belongs to step t + i, so that the first N are
//! dropped; the next query is due at t + max(N, min(execute, L − N)) with L actions in the
//! answer: after `execute` steps as ever, or so much earlier that its answer is there when this
//! one ends, but one at a time. Wherever no action is left the arm holds still.

use crate::execution::Execution;
use crate::suite::TaskRef;

/// Numbers of an action: translation, rotation, gripper.
pub const ACTION_WIDTH: usize = 7;

/// One control step's action.
pub type Action = [f64; ACTION_WIDTH];

/// Place of the gripper in an action.
const GRIPPER: usize = ACTION_WIDTH - 1;
/// Command that keeps the gripper open, as while the scene settles.
const OPEN: f64 = -1.0;

/// Schedule of one rollout.
#[derive(Clone, Debug)]
pub struct Schedule {
    execution: Execution,
    execute: u32,
    task: TaskRef,
    init_id: u16,
    /// The control step to come.
    step: u32,
    /// Queries answered so far.
    queries: u32,
    /// Step before which the next query is due.
    next_query: u32,
    /// The answer in effect.
    current: Option<Answer>,
    /// The answer that is under way.
    coming: Option<Answer>,
    /// The gripper's last command.
    gripper: f64,
}

#[derive(Clone, Debug)]
struct Answer {
    query: u32,
    /// Step of its first action, which may be dropped.
    first: u32,
    /// Step at which it takes effect.
    from: u32,
    actions: Vec<Action>,
}

/// A query that is due.
#[derive(Clone, Debug, PartialEq)]
pub struct Query {
    /// Control steps until its answer takes effect.
    pub delay: u32,
    /// Commands of the coming steps as they stand: the first `delay` are executed whatever is
    /// answered, those after them are what is left of the last answer.
    pub under_way: Vec<Action>,
}

/// A command and its source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// The action.
    pub action: Action,
    /// Its query and its place in the answer; none if the arm holds still.
    pub source: Option<(u32, usize)>,
}

impl Schedule {
    /// The schedule of a rollout of `task` from an initial state, with a policy of whose
    /// answers `execute` actions are executed.
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
            coming: None,
            gripper: OPEN,
        }
    }

    /// Begins with the gripper commanded so, in place of open.
    pub fn with_gripper(self, gripper: f64) -> Self {
        Self { gripper, ..self }
    }

    /// Returns the query that is due before the step to come, if one is. It stays due until it
    /// is answered.
    pub fn due(&self) -> Option<Query> {
        (self.step >= self.next_query).then(|| {
            let delay = self.delay();
            let left = self.current().map_or(&[][..], |it| {
                let done = (self.step - it.first) as usize;
                it.actions.get(done..).unwrap_or_default()
            });
            let mut under_way = left.to_vec();
            let gripper = left.last().map_or(self.gripper, |action| action[GRIPPER]);
            // Beyond the last answer the arm holds still until the next one.
            if under_way.len() < delay as usize {
                under_way.resize(delay as usize, hold(gripper));
            }
            Query { delay, under_way }
        })
    }

    /// Takes the answer to the query that is due.
    pub fn answer(&mut self, mut actions: Vec<Action>) {
        let (step, delay) = (self.step, self.delay());
        // An answer has no more actions than fit into a message.
        let mut count = actions.len() as u32;
        let (first, next) = match self.execution {
            Execution::Wait | Execution::Hold(_) => {
                actions.truncate(self.execute as usize);
                count = count.min(self.execute);
                (step + delay, delay + count)
            }
            Execution::Overlap { .. } => {
                let left = count.saturating_sub(delay);
                (step, delay.max(self.execute.min(left)))
            }
        };
        if let Some(arrived) = self.coming.take() {
            self.current = Some(arrived);
        }
        self.coming = Some(Answer {
            query: self.queries,
            first,
            from: step + delay,
            actions,
        });
        self.queries += 1;
        self.next_query = step + next.max(1);
    }

    /// Returns the command of the step to come, and goes on to the next step.
    pub fn advance(&mut self) -> Command {
        let step = self.step;
        if let Some(arrived) = self.coming.take_if(|it| it.from <= step) {
            self.current = Some(arrived);
        }
        let taken = self.current().and_then(|answer| {
            let place = (step - answer.first) as usize;
            Some((*answer.actions.get(place)?, (answer.query, place)))
        });
        self.step += 1;
        match taken {
            Some((action, source)) => {
                self.gripper = action[GRIPPER];
                Command {
                    action,
                    source: Some(source),
                }
            }
            None => Command {
                action: hold(self.gripper),
                source: None,
            },
        }
    }

    /// The answer in effect at the step to come.
    fn current(&self) -> Option<&Answer> {
        let arrived = self.coming.as_ref().filter(|it| it.from <= self.step);
        arrived.or(self.current.as_ref())
    }

    /// Delay of the answer to the query to come.
    fn delay(&self) -> u32 {
        let delays = self.execution.delays();
        delays.map_or(0, |delays| {
            delays
                .of_query(self.task, self.init_id, self.queries)
                .into()
        })
    }
}

/// The arm holds still, the gripper does as last commanded.
fn hold(gripper: f64) -> Action {
    let mut action = [0.0; ACTION_WIDTH];
    action[GRIPPER] = gripper;
    action
}
