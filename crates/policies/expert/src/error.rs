//! Reasons for which the expert cannot act.

/// Error: the expert does not support the scene or its goal.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExpertError {
    #[error("the scene has {given} objects, fixtures and regions; the expert supports {most}")]
    Entities { given: usize, most: usize },
    #[error("the scene has no object, fixture or region named '{name}'")]
    NoEntity { name: String },
    #[error("the scene has no joint named '{name}'")]
    NoJointNamed { name: String },
    #[error("'{fixture}' has no joint")]
    NoJoint { fixture: String },
    #[error("'{region}' is in no drawer")]
    NoDrawer { region: String },
    #[error("'{object}' cannot be held")]
    NotGraspable { object: String },
    #[error("the expert has no skill for the goal '{goal}'; run this task with another policy")]
    NoSkill { goal: String },
    #[error("{field} of '{owner}' is {value}, outside the range that the expert supports")]
    OutOfRange { field: &'static str, owner: String, value: f64 },
}
