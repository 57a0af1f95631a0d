//! Reasons for which the expert cannot act.

/// Error: the expert does not support the scene or its goal.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExpertError {
    /// The scene has too many entities.
    #[error("the scene has {given} objects, fixtures and regions; the expert supports {most}")]
    Entities {
        /// Number of entities.
        given: usize,
        /// Largest number that the expert supports.
        most: usize,
    },
    /// The goal names an entity that the scene lacks.
    #[error("the scene has no object, fixture or region named '{name}'")]
    NoEntity { name: String },
    /// The scene lacks a joint.
    #[error("the scene has no joint named '{name}'")]
    NoJointNamed { name: String },
    /// The fixture to turn on or close has no joint.
    #[error("'{fixture}' has no joint")]
    NoJoint { fixture: String },
    /// The region to open or close is not in a drawer.
    #[error("'{region}' is in no drawer")]
    NoDrawer { region: String },
    /// No grasp of the object is known.
    #[error("'{object}' cannot be held")]
    NotGraspable { object: String },
    /// The goal needs a skill that the expert lacks.
    #[error("the expert has no skill for the goal '{goal}'; run this task with another policy")]
    NoSkill {
        /// Predicate and arguments of the goal.
        goal: String,
    },
    /// A number is not finite or outside the supported range.
    #[error("{field} of '{owner}' is {value}, outside the range that the expert supports")]
    OutOfRange {
        field: &'static str,
        /// Name of the entity.
        owner: String,
        value: f64,
    },
}
