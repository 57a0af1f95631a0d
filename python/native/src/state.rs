use std::cell::RefCell;
use std::sync::Arc;

use benchmark::family::plus::CameraPose;
use builtin_policies::expert::Expert;
use numpy::{PyArray1, PyArrayDyn, PyArrayMethods};
use pyo3::prelude::*;
use sim::{
    ActionFrame, CompiledScene, Conditions, Drawer, Environment, Frame, ReadyScene, Renderer,
    RobotState,
};

use crate::action::WIDTH;
use crate::error::{invalid, simulation};
use crate::start::Start;

const LARGEST_SIDE: u32 = 4096;

thread_local! {
    /// OpenGL drawers of this thread; an OpenGL context belongs to the thread that opened it.
    static OPENGL: RefCell<Vec<(Renderer, Drawer)>> = const { RefCell::new(Vec::new()) };
}

pub(crate) struct State {
    pub(crate) environment: Environment,
    /// Pose of `agentview` after a hard reset; `None` keeps the scene's pose.
    pub(crate) camera: Option<CameraPose>,
    pub(crate) conditions: Option<Conditions>,
    /// Scripted expert. A rollout that uses the expert queries it at every step.
    pub(crate) expert: Expert,
    pub(crate) ready: Option<Arc<ReadyScene>>,
    pub(crate) renderer: Renderer,
}

impl State {
    /// Renders a frame, including the corruption of the sensor axis.
    pub(crate) fn frame(&mut self, camera: &str, size: [u32; 2]) -> PyResult<Frame> {
        let environment = &mut self.environment;
        let mut frame = with_drawer(self.renderer, |drawer| {
            environment.draw(drawer, camera, size[0], size[1])
        })?;
        if let Some(conditions) = &mut self.conditions {
            conditions.corrupt(&mut frame);
        }
        Ok(frame)
    }

    /// Actions and frames are no longer perturbed, and the expert is reset. The perturbed camera,
    /// lights and robot pose remain until the environment is loaded or hard-reset.
    pub(crate) fn end_rollout(&mut self) {
        self.conditions = None;
        self.expert = Expert::default();
    }

    pub(crate) fn begin(&mut self, start: &Start) -> PyResult<()> {
        self.end_rollout();
        self.conditions = start.begin(self.ready.as_deref(), &mut self.environment)?;
        Ok(())
    }

    /// Checks that a snapshot belongs to this environment's scene.
    ///
    /// # Errors
    /// `ValueError` if it belongs to another scene.
    pub(crate) fn check_scene(&self, snapshot: &Snapshot) -> PyResult<()> {
        if Arc::ptr_eq(self.environment.compiled(), &snapshot.compiled) {
            return Ok(());
        }
        Err(invalid(
            "restore a snapshot: it is of another scene; restore one that an environment of the \
             same task, assets and process took",
        ))
    }

    /// Restores a snapshot; the caller has checked its scene.
    pub(crate) fn restore(&mut self, snapshot: &Snapshot) {
        self.environment.restore(&snapshot.environment);
        self.conditions.clone_from(&snapshot.conditions);
        self.expert.clone_from(&snapshot.expert);
    }

    /// The expert is stateful and should be queried at every control step of a rollout.
    pub(crate) fn expert_action(&mut self) -> PyResult<[f64; WIDTH]> {
        let observation = self.environment.privileged().map_err(simulation)?;
        let action = self
            .expert
            .act(&observation)
            .map_err(|problem| invalid(format_args!("query the expert: {problem}")))?;
        Ok(action.map(f64::from))
    }

    /// Writes the actions that the expert takes in the next steps if it drives, until the goal
    /// holds; the state remains unchanged. Returns false if the expert makes no progress in them.
    pub(crate) fn foresee(&mut self, actions: &mut [[f64; WIDTH]]) -> PyResult<bool> {
        let before = self.snapshot()?;
        let result = self.demonstrate(actions);
        self.restore(&before);
        result
    }

    fn demonstrate(&mut self, actions: &mut [[f64; WIDTH]]) -> PyResult<bool> {
        let steps = actions.len() as u32;
        for foreseen in actions {
            let action = self.expert_action()?;
            if self.expert.is_retreating() {
                return Ok(false);
            }
            *foreseen = action;
            if self.step(&action, ActionFrame::Relative)? {
                return Ok(true);
            }
        }
        Ok(!self.expert.makes_no_progress(steps))
    }

    pub(crate) fn snapshot(&mut self) -> PyResult<Snapshot> {
        Ok(Snapshot {
            environment: self.environment.snapshot().map_err(simulation)?,
            conditions: self.conditions.clone(),
            expert: self.expert.clone(),
            compiled: Arc::clone(self.environment.compiled()),
        })
    }

    /// Notifies the expert that the robot did not execute the expert's last action.
    pub(crate) fn interrupt_expert(&mut self) {
        self.expert.interrupt();
    }

    /// Executes one control step as a campaign does. Returns true if the goal holds after it.
    pub(crate) fn step(&mut self, action: &[f64; WIDTH], frame: ActionFrame) -> PyResult<bool> {
        let environment = &mut self.environment;
        let success = match &mut self.conditions {
            Some(conditions) => conditions.step(environment, action, frame),
            None => environment.step_in(action, frame),
        };
        success.map_err(simulation)
    }
}

/// Calls `draw` with this thread's drawer for a renderer, which is opened at the first use.
pub(crate) fn with_drawer<T>(
    renderer: Renderer,
    draw: impl FnOnce(&Drawer) -> Result<T, sim::SimError>,
) -> PyResult<T> {
    if renderer == Renderer::Software {
        return draw(&Drawer::Software).map_err(simulation);
    }
    OPENGL.with_borrow_mut(|drawers| {
        let at = match drawers.iter().position(|(opened, _)| *opened == renderer) {
            Some(at) => at,
            None => {
                let drawer = Drawer::open(renderer).map_err(simulation)?;
                drawers.push((renderer, drawer));
                drawers.len() - 1
            }
        };
        draw(&drawers[at].1).map_err(simulation)
    })
}

/// Everything that an environment's next step depends on, including its scripted expert.
#[pyclass(frozen, module = "rollout_libero._native")]
pub(crate) struct Snapshot {
    pub(crate) environment: sim::Snapshot,
    pub(crate) conditions: Option<Conditions>,
    pub(crate) expert: Expert,
    pub(crate) compiled: Arc<CompiledScene>,
}

pub(crate) fn picture_size(width: u32, height: u32) -> PyResult<[u32; 2]> {
    match (1..=LARGEST_SIDE).contains(&width) && (1..=LARGEST_SIDE).contains(&height) {
        true => Ok([width, height]),
        false => Err(invalid(format_args!(
            "draw {width} × {height} pixels: each side may have 1 to {LARGEST_SIDE}"
        ))),
    }
}

pub(crate) fn robot_readings(robot: &RobotState) -> [(&'static str, &[f64]); 7] {
    [
        ("eef_pos", &robot.eef_pos),
        ("eef_quat", &robot.eef_quat_xyzw),
        ("eef_axis_angle", &robot.eef_axis_angle),
        ("joint_pos", &robot.joint_pos),
        ("joint_vel", &robot.joint_vel),
        ("gripper_pos", &robot.gripper_pos),
        ("gripper_vel", &robot.gripper_vel),
    ]
}

/// Flattens segments to the kind and id of each pixel's object, -1 for the background.
pub(crate) fn pairs(segments: Vec<Option<sim::Segment>>) -> Vec<i32> {
    segments
        .into_iter()
        .flat_map(|segment| segment.map_or([-1, -1], |segment| [segment.kind, segment.id]))
        .collect()
}

pub(crate) fn shaped<'py, T: numpy::Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    PyArray1::from_vec(py, values).reshape(shape)
}
