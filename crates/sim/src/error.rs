//! What can go wrong in simulating a rollout.

use crate::mujoco::ObjectKind;

/// Why a rollout could not be simulated. None of these is a failure of the
/// policy: the rollout is retried.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// The scene's files are missing or wrong.
    #[error(transparent)]
    Scene(#[from] scene::SceneError),
    /// MuJoCo refused the composed model.
    #[error("compile the scene's model: {0}")]
    Compile(String),
    /// The model lacks something that every LIBERO scene has.
    #[error("find {kind:?} `{name}` in the model; is the asset pack complete?")]
    Missing {
        /// Of what kind.
        kind: ObjectKind,
        /// Its name.
        name: String,
    },
    /// An initial state does not fit the model.
    #[error(
        "load initial state {id} of {file}: it has {found} numbers and the model needs {needed}; \
         do the BDDL file, the initial states and the asset pack belong together?"
    )]
    StateWidth {
        /// Which state.
        id: usize,
        /// The file it is from.
        file: String,
        /// Its length.
        found: usize,
        /// 1 + nq + nv.
        needed: usize,
    },
    /// There is no such initial state.
    #[error("load initial state {id} of {file}: it holds {count}")]
    NoSuchState {
        /// Which state.
        id: usize,
        /// The file.
        file: String,
        /// How many it holds.
        count: usize,
    },
    /// The simulation diverged.
    #[error("simulate control step {control_step}: {problem}")]
    Unstable {
        /// Counted from the start of settling.
        control_step: u32,
        /// What MuJoCo said.
        problem: String,
    },
    /// The robot's inertia or Jacobian cannot be inverted.
    #[error("control the arm at control step {control_step}: its inertia matrix is singular")]
    Singular {
        /// Counted from the start of settling.
        control_step: u32,
    },
    /// A goal asks for something that an instance cannot answer.
    #[error("evaluate the goal {predicate}: {problem}")]
    Predicate {
        /// As in the BDDL file.
        predicate: String,
        /// Why not.
        problem: String,
    },
    /// An action is a pose, and the rollout distorts displacements.
    #[error(
        "command a pose while actuation is perturbed: the distortion acts on displacements; \
         command displacements (control=\"relative\"), or leave the actuation axis out"
    )]
    DistortedPose,
    /// A policy wants to look through a camera that the protocol does not give.
    #[error("look through camera `{0}`: policies have agentview and robot0_eye_in_hand")]
    Camera(String),
    /// OpenGL cannot be opened or used.
    #[error("draw off-screen: {problem}; {remedy}")]
    Graphics {
        /// What happened.
        problem: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A C allocation failed.
    #[error("allocate {0}: out of memory")]
    OutOfMemory(&'static str),
}

impl SimError {
    /// Whether it is this machine's fault, and would not happen on a sound one.
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
