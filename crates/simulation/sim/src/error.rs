//! Errors of the simulation of a rollout.

use crate::mujoco::ObjectKind;

/// Reason why a rollout could not be simulated. None of these is a failure of the policy:
/// the rollout is retried.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// The scene's files are missing or invalid.
    #[error(transparent)]
    Scene(#[from] scene::SceneError),
    /// MuJoCo rejected the composed model.
    #[error("compile the scene's model: {0}")]
    Compile(String),
    /// The model lacks an element that every LIBERO scene has.
    #[error("find {kind:?} `{name}` in the model; is the asset pack complete?")]
    Missing {
        /// Kind of the missing object.
        kind: ObjectKind,
        /// Name of the missing object.
        name: String,
    },
    /// An initial state does not fit the model.
    #[error(
        "load initial state {id} of {file}: it has {found} numbers and the model needs {needed}; \
         do the BDDL file, the initial states and the asset pack belong together?"
    )]
    StateWidth {
        /// Index of the initial state.
        id: usize,
        /// File of the initial states.
        file: String,
        /// Numbers in the state.
        found: usize,
        /// Numbers that the model needs: 1 + nq + nv.
        needed: usize,
    },
    /// There is no such initial state.
    #[error("load initial state {id} of {file}: it holds {count}")]
    NoSuchState {
        /// Index of the initial state.
        id: usize,
        /// File of the initial states.
        file: String,
        /// Number of states in the file.
        count: usize,
    },
    /// The simulation diverged.
    #[error("simulate control step {control_step}: {problem}")]
    Unstable {
        /// Control step, counted from the start of settling.
        control_step: u32,
        /// Warning of MuJoCo.
        problem: String,
    },
    /// The robot's inertia or Jacobian cannot be inverted.
    #[error("control the arm at control step {control_step}: its inertia matrix is singular")]
    Singular {
        /// Control step, counted from the start of settling.
        control_step: u32,
    },
    /// A goal holds a predicate that does not apply to its instance.
    #[error("evaluate the goal {predicate}: {problem}")]
    Predicate {
        /// Predicate as in the BDDL file.
        predicate: String,
        /// Reason why it cannot be evaluated.
        problem: String,
    },
    /// An action is a pose, but the rollout distorts displacements.
    #[error(
        "command a pose while actuation is perturbed: the distortion acts on displacements; \
         command displacements (control=\"relative\"), or leave the actuation axis out"
    )]
    DistortedPose,
    /// A policy requests a camera that the protocol does not offer.
    #[error("look through camera `{0}`: policies have agentview and robot0_eye_in_hand")]
    Camera(String),
    /// A picture is unsuitable for a variant's corruption.
    #[error(transparent)]
    Corruption(#[from] libero_family::corruption::UnsuitedPicture),
    /// OpenGL cannot be opened or used.
    #[error("draw off-screen: {problem}; {remedy}")]
    Graphics {
        /// Cause of the failure.
        problem: String,
        /// Remedy for the operator.
        remedy: &'static str,
    },
    /// A C allocation failed.
    #[error("allocate {0}: out of memory")]
    OutOfMemory(&'static str),
}

impl SimError {
    /// Returns true if the fault lies with this machine and would not occur on a working one.
    pub fn is_of_the_machine(&self) -> bool {
        matches!(
            self,
            SimError::Scene(
                scene::SceneError::Read { .. }
                    | scene::SceneError::NotLiberos { .. }
                    | scene::SceneError::Assets(_)
            ) | SimError::Graphics { .. }
                | SimError::OutOfMemory(_)
        )
    }
}
