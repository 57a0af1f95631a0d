//! From goal predicates to skills, in an order in which they do not undo one
//! another. Not responsible for how a skill is carried out.

use super::transfer::{Place, Transfer};
use super::world::{Predicate, World};

/// A skill at work.
#[derive(Debug)]
pub(super) enum Skill {
    Transfer(Transfer),
}

/// The skills that make `world`'s goal true, first to last.
///
/// # Errors
/// Names a predicate that the expert has no skill for.
pub(super) fn plan(world: &World) -> Result<Vec<Skill>, String> {
    world.goal.iter().map(skill).collect()
}

fn skill(predicate: &Predicate) -> Result<Skill, String> {
    let arguments: Vec<&str> = predicate.arguments.iter().map(String::as_str).collect();
    match (predicate.name.as_str(), arguments.as_slice()) {
        ("on", [object, on]) => Ok(transfer(object, Place::On((*on).to_owned()))),
        ("in", [object, region]) => Ok(transfer(object, Place::In((*region).to_owned()))),
        (name, arguments) => Err(format!(
            "the expert has no skill for the goal '{name} {}'; run this task with another policy",
            arguments.join(" ")
        )),
    }
}

fn transfer(object: &str, place: Place) -> Skill {
    Skill::Transfer(Transfer::new(object.to_owned(), place))
}
