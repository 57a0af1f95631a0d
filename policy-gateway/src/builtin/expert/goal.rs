//! From goal predicates to skills, in an order in which they do not undo one
//! another. Not responsible for how a skill is carried out.

use super::motion::{Command, Motion};
use super::routine::{self, Deed, Routine};
use super::transfer::{Place, Transfer};
use super::world::{Predicate, World};

/// A skill at work.
#[derive(Debug)]
pub(super) enum Skill {
    Transfer(Transfer),
    Routine(Routine),
}

impl Skill {
    /// The command for this step; none once the skill is over.
    ///
    /// # Errors
    /// Names an entity or joint that the scene lacks.
    pub(super) fn step(
        &mut self,
        world: &World,
        motion: &Motion,
    ) -> Result<Option<Command>, String> {
        match self {
            Self::Transfer(transfer) => transfer.step(world, motion),
            Self::Routine(routine) => routine.step(world, motion),
        }
    }
}

/// The skills that make `world`'s goal true, first to last: what opens comes
/// before what is put in, and what closes comes after. What a joint shows to
/// be done already is left out.
///
/// # Errors
/// Names a predicate that the expert has no skill for, or an argument that the
/// scene lacks.
pub(super) fn plan(world: &World) -> Result<Vec<Skill>, String> {
    let (mut before, mut between, mut after) = (Vec::new(), Vec::new(), Vec::new());
    for predicate in &world.goal {
        let arguments: Vec<&str> = predicate.arguments.iter().map(String::as_str).collect();
        match (predicate.name.as_str(), arguments.as_slice()) {
            ("open", [region]) => before.extend(open(world, region)?),
            ("turnon", [stove]) => before.extend(turn_on(world, stove)?),
            ("close", [what]) => after.push(close(world, what)?),
            ("on", [object, on]) => between.push(put_on(world, object, on)?),
            ("in", [object, region]) => {
                before.extend(open(world, region)?);
                between.push(transfer(object, Place::In((*region).to_owned())));
            }
            _ => return Err(no_skill(predicate)),
        }
    }
    before.append(&mut between);
    before.append(&mut after);
    Ok(before)
}

fn no_skill(predicate: &Predicate) -> String {
    format!(
        "the expert has no skill for the goal '{} {}'; run this task with another policy",
        predicate.name,
        predicate.arguments.join(" ")
    )
}

/// Opens the drawer of `region`, if it is in a drawer that is not open.
fn open(world: &World, region: &str) -> Result<Option<Skill>, String> {
    let joint = routine::drawer_joint(region);
    let Some(position) = joint.and_then(|joint| world.joint(&joint).ok()) else {
        return Ok(None);
    };
    let pull = Deed::PullDrawer {
        region: region.to_owned(),
    };
    Ok((!routine::drawer_is_open(position)).then(|| Skill::Routine(Routine::new(pull))))
}

fn turn_on(world: &World, stove: &str) -> Result<Option<Skill>, String> {
    let on = routine::knob_is_on(routine::only_joint(world, stove)?);
    let turn = Deed::TurnKnob {
        stove: stove.to_owned(),
    };
    Ok((!on).then(|| Skill::Routine(Routine::new(turn))))
}

/// Closes a drawer by its region, or a door by its fixture.
fn close(world: &World, what: &str) -> Result<Skill, String> {
    let in_drawer = routine::drawer_joint(what).is_some_and(|joint| world.joint(&joint).is_ok());
    let deed = if in_drawer {
        Deed::PushDrawer {
            region: what.to_owned(),
        }
    } else {
        Deed::PushDoor {
            microwave: what.to_owned(),
        }
    };
    Ok(Skill::Routine(Routine::new(deed)))
}

fn put_on(world: &World, object: &str, on: &str) -> Result<Skill, String> {
    if routine::must_be_dragged(world.entity(object)?) {
        let deed = Deed::Drag {
            object: object.to_owned(),
            region: on.to_owned(),
        };
        return Ok(Skill::Routine(Routine::new(deed)));
    }
    Ok(transfer(object, Place::On(on.to_owned())))
}

fn transfer(object: &str, place: Place) -> Skill {
    Skill::Transfer(Transfer::new(object.to_owned(), place))
}
