//! From goal predicates to skills, in an order in which they do not undo one
//! another. Not responsible for how a skill is carried out.

use super::motion::{Command, Motion};
use super::place::{Place, Relation};
use super::routine::{self, Deed, Routine};
use super::transfer::Transfer;
use super::world::{Predicate, World, drawer_joint};

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
/// before what is put in, and what closes comes after. What is seen to be done
/// already is left out.
///
/// # Errors
/// Names a predicate that the expert has no skill for, or an argument that the
/// scene lacks.
pub(super) fn plan(world: &World) -> Result<Vec<Skill>, String> {
    let (mut before, mut between, mut after) = (Vec::new(), Vec::new(), Vec::new());
    for predicate in &world.goal {
        let arguments: Vec<&str> = predicate.arguments.iter().map(String::as_str).collect();
        match (predicate.name.as_str(), arguments.as_slice()) {
            ("open", [region]) => before.extend(open(world, region, routine::DRAWER_OPEN_M)?),
            ("turnon", [stove]) => before.extend(turn_on(world, stove)?),
            ("close", [what]) => after.extend(close(world, what)?),
            ("on", [object, on]) => between.extend(put_on(world, predicate, object, on)?),
            ("in", [object, region]) => {
                let place = Place {
                    relation: Relation::In,
                    target: (*region).to_owned(),
                    slot: 0.0,
                };
                let put = transfer(world, object, place)?;
                if put.is_some() {
                    before.extend(open(world, region, routine::DRAWER_AJAR_M)?);
                }
                between.extend(put);
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

/// Opens the drawer of `region` as far as `to`, m, if it is in a drawer and
/// that is not open.
fn open(world: &World, region: &str, to: f64) -> Result<Option<Skill>, String> {
    let joint = drawer_joint(region);
    let Some(position) = joint.and_then(|joint| world.joint(&joint).ok()) else {
        return Ok(None);
    };
    let pull = Deed::PullDrawer {
        region: region.to_owned(),
        to,
    };
    let open = position < to.max(routine::OPEN_M);
    Ok((!open).then(|| Skill::Routine(Routine::new(pull))))
}

fn turn_on(world: &World, stove: &str) -> Result<Option<Skill>, String> {
    let on = routine::knob_is_on(routine::only_joint(world, stove)?);
    let turn = Deed::TurnKnob {
        stove: stove.to_owned(),
    };
    Ok((!on).then(|| Skill::Routine(Routine::new(turn))))
}

/// Closes a drawer by its region, or a door by its fixture.
fn close(world: &World, what: &str) -> Result<Option<Skill>, String> {
    let drawer = drawer_joint(what).and_then(|joint| world.joint(&joint).ok());
    let (deed, closed) = match drawer {
        Some(position) => (
            Deed::PushDrawer {
                region: what.to_owned(),
            },
            routine::drawer_is_closed(position),
        ),
        None => {
            let position = routine::only_joint(world, what)?;
            (
                Deed::PushDoor {
                    microwave: what.to_owned(),
                },
                routine::door_is_closed(position),
            )
        }
    };
    Ok((!closed).then(|| Skill::Routine(Routine::new(deed))))
}

fn put_on(
    world: &World,
    predicate: &Predicate,
    object: &str,
    on: &str,
) -> Result<Option<Skill>, String> {
    let place = Place {
        relation: Relation::On,
        target: on.to_owned(),
        slot: slot(&world.goal, predicate),
    };
    if routine::must_be_dragged(world.entity(object)?) && world.entity(on)?.is_region() {
        let deed = Deed::Drag {
            object: object.to_owned(),
            region: on.to_owned(),
        };
        let there = place.holds(world, world.entity(object)?)?;
        return Ok((!there).then(|| Skill::Routine(Routine::new(deed))));
    }
    transfer(world, object, place)
}

/// Which side of the target, where two objects are to go onto the same.
fn slot(goal: &[Predicate], predicate: &Predicate) -> f64 {
    let same = |other: &&Predicate| {
        other.name == predicate.name && other.arguments.last() == predicate.arguments.last()
    };
    let sharing: Vec<&Predicate> = goal.iter().filter(same).collect();
    match sharing.as_slice() {
        [first, _] if *first == predicate => -1.0,
        [_, _] => 1.0,
        _ => 0.0,
    }
}

fn transfer(world: &World, object: &str, place: Place) -> Result<Option<Skill>, String> {
    let there = place.holds(world, world.entity(object)?)?;
    let transfer = Transfer::new(object.to_owned(), place);
    Ok((!there).then(|| Skill::Transfer(transfer)))
}
