use crate::mujoco::ObjectKind;

/// Errors of the simulation: no failures of the policy, so the rollout is retried.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    #[error(transparent)]
    Scene(#[from] scene::SceneError),
    #[error("compile the scene's model: {0}")]
    Compile(String),
    #[error("find {kind:?} `{name}` in the model; is the asset pack complete?")]
    Missing { kind: ObjectKind, name: String },
    #[error(
        "load initial state {id} of {file}: the state has {found} numbers and the model needs \
         {needed}; do the BDDL file, the initial states and the asset pack belong together?"
    )]
    StateWidth {
        id: usize,
        file: String,
        found: usize,
        /// Numbers that the model needs: 1 + nq + nv.
        needed: usize,
    },
    #[error("load initial state {id} of {file}: the file has {count} states")]
    NoSuchState { id: usize, file: String, count: usize },
    #[error("simulate control step {control_step}: {problem}")]
    Unstable {
        /// Control step, counted from the start of settling.
        control_step: u32,
        problem: String,
    },
    #[error(
        "control the arm at control step {control_step}: a matrix of its controller has no inverse"
    )]
    Singular { control_step: u32 },
    #[error("evaluate the goal {predicate}: {problem}")]
    Predicate { predicate: String, problem: String },
    #[error(
        "command a pose while actuation is perturbed: the distortion acts on displacements; \
         command displacements (control=\"relative\"), or leave the actuation axis out"
    )]
    DistortedPose,
    #[error("draw a frame of camera `{0}`: policies receive agentview and robot0_eye_in_hand")]
    Camera(String),
    #[error(transparent)]
    Corruption(#[from] benchmark::family::corruption::UnsuitedPicture),
    #[error("draw off-screen: {problem}; {remedy}")]
    Graphics { problem: String, remedy: &'static str },
    #[error("allocate {0}: out of memory")]
    OutOfMemory(&'static str),
}

impl SimError {
    /// True if another machine could simulate the rollout, for example when files are missing.
    pub fn is_machine_fault(&self) -> bool {
        matches!(
            self,
            SimError::Scene(
                scene::SceneError::Read { .. }
                    | scene::SceneError::Unpack { .. }
                    | scene::SceneError::NotLiberos { .. }
                    | scene::SceneError::Assets(_)
            ) | SimError::Graphics { .. }
                | SimError::OutOfMemory(_)
        )
    }
}
