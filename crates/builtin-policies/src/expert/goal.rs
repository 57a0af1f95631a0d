//! Plans skills from goal predicates, in an order in which no skill undoes an earlier skill.

use std::collections::VecDeque;

use benchmark::Predicate;

use crate::expert::ExpertError;
use crate::expert::geometry::Vec3;
use crate::expert::motion::{Command, FINGERS_OPEN_M, Fingers, HandPose, Motion};
use crate::expert::place::{Place, Relation};
use crate::expert::routine::{self, Routine, RoutineTask};
use crate::expert::transfer::Transfer;
use crate::expert::world::{World, drawer_joint};

/// Distance by which the hand backs out from a handle before moving elsewhere, m.
const CLEAR_OF_HANDLE_M: f64 = 0.08;
/// Distance from the grip point to the box of an object within which the object may be
/// between the fingers, m.
const BETWEEN_FINGERS_M: f64 = 0.005;
/// The same for fingers that are opening, from which the object has already fallen a little, m.
const BETWEEN_OPENING_FINGERS_M: f64 = 0.03;

#[derive(Clone, Debug)]
pub(crate) enum Skill {
    Transfer(Box<Transfer>),
    Routine(Routine),
    /// Opens the fingers to release an object, and backs out from a handle.
    LetGo,
}

impl Skill {
    /// Returns the command for this step; `None` if the skill is complete.
    pub(crate) fn step(
        &mut self,
        world: &World,
        motion: &Motion,
    ) -> Result<Option<Command>, ExpertError> {
        match self {
            Self::Transfer(transfer) => transfer.step(world, motion),
            Self::Routine(routine) => routine.step(world, motion),
            Self::LetGo => Ok(let_go(world, motion)),
        }
    }

    fn can_continue(&self, world: &World) -> bool {
        let object = match self {
            Self::Transfer(transfer) => transfer.object(),
            Self::Routine(routine) => match routine.task() {
                RoutineTask::PullDrawer { .. } => {
                    return world.handle_at_grip(CLEAR_OF_HANDLE_M).is_some();
                }
                RoutineTask::Drag { object, .. } => object,
                _ => return false,
            },
            Self::LetGo => return false,
        };
        let mut at_grip = world.objects_at_grip(BETWEEN_FINGERS_M);
        at_grip.any(|object_at_grip| object_at_grip.name == object)
    }
}

/// Returns the command that opens the fingers and backs the hand out from a handle; `None` if the
/// hand is free.
fn let_go(world: &World, motion: &Motion) -> Option<Command> {
    let handle = world.handle_at_grip(CLEAR_OF_HANDLE_M);
    let is_open = world.opening > FINGERS_OPEN_M;
    let between = if motion.opens() { BETWEEN_OPENING_FINGERS_M } else { BETWEEN_FINGERS_M };
    let has_object_at_grip = world.objects_at_grip(between).next().is_some();
    let way_out = match (is_open, handle) {
        (true, Some(out)) => out * CLEAR_OF_HANDLE_M,
        (true, None) => return None,
        (false, None) if !has_object_at_grip => return None,
        (false, _) => Vec3::default(),
    };
    Some(Command {
        hand: HandPose { pos: world.grip + way_out, quat: world.grip_quat },
        fingers: Fingers::Open,
        pace: 1.0,
    })
}

#[derive(Clone, Copy)]
struct Takeover<'a> {
    motion: &'a Motion,
    earlier: &'a VecDeque<Skill>,
}

impl<'a> Takeover<'a> {
    fn transfer(self, object: &str) -> Option<&'a Transfer> {
        self.earlier.iter().find_map(|skill| match skill {
            Skill::Transfer(transfer) if transfer.object() == object => Some(transfer.as_ref()),
            _ => None,
        })
    }
}

/// Replans after another controller has driven the robot: like [`plan`], but the skill of the
/// held object comes first, so that the object is not dropped, or, if drawers must be opened, right
/// after their opening; and the first skill resumes at the phase that follows from the state of the
/// scene. Grasps are taken from `earlier`, the previous plan.
pub(crate) fn resume(
    world: &World,
    motion: &Motion,
    earlier: &VecDeque<Skill>,
) -> Result<Vec<Skill>, ExpertError> {
    let takeover = Takeover { motion, earlier };
    let mut skills = plan_after(world, Some(takeover))?;
    let mut holding_skill = None;
    for (index, skill) in skills.iter().enumerate() {
        if let Skill::Transfer(transfer) = skill
            && transfer.holds(takeover.transfer(transfer.object()), world, motion)?
        {
            holding_skill = Some(index);
            break;
        }
    }
    if let Some(index) = holding_skill {
        // A closed drawer must be pulled open before an object can go into it.
        let is_pull = |skill: &Skill| match skill {
            Skill::Routine(routine) => matches!(routine.task(), RoutineTask::PullDrawer { .. }),
            _ => false,
        };
        let first = skills.iter().rposition(is_pull).map_or(0, |pull| pull + 1);
        if first < index {
            skills[first..=index].rotate_right(1);
        }
    }
    match skills.first_mut() {
        Some(Skill::Transfer(transfer)) => {
            let earlier = takeover.transfer(transfer.object());
            transfer.resume(earlier, world, motion)?;
        }
        Some(Skill::Routine(routine)) => routine.resume(world, motion)?,
        Some(Skill::LetGo) | None => {}
    }
    let can_continue = skills.first().is_some_and(|skill| skill.can_continue(world));
    if !can_continue && let_go(world, motion).is_some() {
        skills.insert(0, Skill::LetGo);
    }
    Ok(skills)
}

/// Plans the skills that achieve `world`'s goal, in order: drawers are opened and stoves turned on
/// before objects are placed, and drawers and doors are closed afterwards. Predicates that already
/// hold are skipped.
pub(crate) fn plan(world: &World) -> Result<Vec<Skill>, ExpertError> {
    plan_after(world, None)
}

/// As [`plan`]. After a takeover, predicates are skipped where the expert, had it come there by
/// itself, would not have begun the next skill any earlier or later.
fn plan_after(world: &World, takeover: Option<Takeover<'_>>) -> Result<Vec<Skill>, ExpertError> {
    let (mut opening, mut placing, mut closing) = (Vec::new(), Vec::new(), Vec::new());
    for predicate in &world.goal {
        let arguments: Vec<&str> = predicate.arguments.iter().map(String::as_str).collect();
        match (predicate.name.as_str(), arguments.as_slice()) {
            ("open", [region]) => opening.extend(open(world, region, routine::DRAWER_OPEN_M)?),
            ("turnon", [stove]) => opening.extend(turn_on(world, stove, takeover)?),
            ("close", [target]) => closing.extend(close(world, target)?),
            ("on", [object, target]) => {
                placing.extend(put_on(world, predicate, object, target, takeover)?);
            }
            ("in", [object, region]) => {
                let place =
                    Place { relation: Relation::In, target: (*region).to_owned(), slot: 0.0 };
                let put = transfer(world, object, place, takeover)?;
                if put.is_some() {
                    opening.extend(open(world, region, routine::DRAWER_AJAR_M)?);
                }
                placing.extend(put);
            }
            _ => {
                let goal = format!("{} {}", predicate.name, predicate.arguments.join(" "));
                return Err(ExpertError::NoSkill { goal });
            }
        }
    }
    opening.append(&mut placing);
    opening.append(&mut closing);
    Ok(opening)
}

/// Plans to open the drawer of `region` to the joint position `to`, m; `None` if the region is in
/// no drawer, or in an open drawer.
fn open(world: &World, region: &str, to: f64) -> Result<Option<Skill>, ExpertError> {
    let joint = drawer_joint(region);
    let Some(position) = joint.and_then(|joint| world.joint(&joint).ok()) else {
        return Ok(None);
    };
    let pull = RoutineTask::PullDrawer { region: region.to_owned(), to };
    let is_open = position < to.max(routine::DRAWER_COUNTS_AS_OPEN_M);
    Ok((!is_open).then(|| Skill::Routine(Routine::new(pull))))
}

fn turn_on(
    world: &World,
    stove: &str,
    takeover: Option<Takeover<'_>>,
) -> Result<Option<Skill>, ExpertError> {
    let is_leaving = takeover.is_some() && routine::is_at_knob(world, stove)?;
    let is_on = routine::knob_is_on(routine::only_joint(world, stove)?) && !is_leaving;
    let turn = RoutineTask::TurnKnob { stove: stove.to_owned() };
    Ok((!is_on).then(|| Skill::Routine(Routine::new(turn))))
}

/// Plans to close a drawer, given by its region, or a door, given by its fixture; `None` if it is
/// closed.
fn close(world: &World, target: &str) -> Result<Option<Skill>, ExpertError> {
    let drawer = drawer_joint(target).and_then(|joint| world.joint(&joint).ok());
    let (task, is_closed) = match drawer {
        Some(position) => (
            RoutineTask::PushDrawer { region: target.to_owned() },
            routine::drawer_is_closed(position),
        ),
        None => {
            let position = routine::only_joint(world, target)?;
            (
                RoutineTask::PushDoor { microwave: target.to_owned() },
                routine::door_is_closed(position),
            )
        }
    };
    Ok((!is_closed).then(|| Skill::Routine(Routine::new(task))))
}

fn put_on(
    world: &World,
    predicate: &Predicate,
    object: &str,
    target: &str,
    takeover: Option<Takeover<'_>>,
) -> Result<Option<Skill>, ExpertError> {
    let slot = slot(&world.goal, predicate);
    let mut place = Place { relation: Relation::On, target: target.to_owned(), slot };
    if let Some(other) = other_object_at_target(&world.goal, predicate) {
        place.slot = free_slot(world, &place, object, other)?;
    }
    if routine::must_be_dragged(world.entity(object)?) && world.entity(target)?.is_region() {
        let task = RoutineTask::Drag { object: object.to_owned(), region: target.to_owned() };
        let is_placed = place.holds(world, world.entity(object)?)?;
        return Ok((!is_placed).then(|| Skill::Routine(Routine::new(task))));
    }
    transfer(world, object, place, takeover)
}

/// Returns the side of the target on which the predicate's object is placed, if exactly two
/// predicates of the goal have this target: -1 for the first, 1 for the second; otherwise 0.
fn slot(goal: &[Predicate], predicate: &Predicate) -> f64 {
    let shares_target = |other: &&Predicate| {
        other.name == predicate.name && other.arguments.last() == predicate.arguments.last()
    };
    let sharing: Vec<&Predicate> = goal.iter().filter(shares_target).collect();
    match sharing.as_slice() {
        [first, _] if *first == predicate => -1.0,
        [_, _] => 1.0,
        _ => 0.0,
    }
}

fn other_object_at_target<'a>(goal: &'a [Predicate], predicate: &Predicate) -> Option<&'a str> {
    let shares_target = |other: &&Predicate| {
        *other != predicate
            && other.name == predicate.name
            && other.arguments.last() == predicate.arguments.last()
    };
    goal.iter().find(shares_target)?.arguments.first().map(String::as_str)
}

/// Returns the side of the target that `place` has, or the opposite side if `other` is already at
/// the target and leaves more room on the opposite side.
fn free_slot(world: &World, place: &Place, object: &str, other: &str) -> Result<f64, ExpertError> {
    let (object, other) = (world.entity(object)?, world.entity(other)?);
    if !place.holds(world, other)? {
        return Ok(place.slot);
    }
    let clearance = |slot: f64| -> Result<f64, ExpertError> {
        let side = Place { slot, ..place.clone() };
        let rest = side.spot(world, object)?.rest;
        Ok((rest - other.pos).horizontal_norm())
    };
    let opposite = -place.slot;
    Ok(if clearance(opposite)? > clearance(place.slot)? { opposite } else { place.slot })
}

fn transfer(
    world: &World,
    object: &str,
    place: Place,
    takeover: Option<Takeover<'_>>,
) -> Result<Option<Skill>, ExpertError> {
    let transfer = Transfer::new(object.to_owned(), place);
    let is_done = match takeover {
        Some(takeover) => transfer.is_done(takeover.transfer(object), world, takeover.motion)?,
        None => transfer.is_placed(world)?,
    };
    Ok((!is_done).then(|| Skill::Transfer(Box::new(transfer))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expert::kinematic_scene::KinematicScene;

    const MUG: [f64; 3] = [0.03, 0.03, 0.05];
    const DRAWER: &str = "cabinet_1_top_region";

    fn mug_into_drawer_and_close_it(position: f64) -> KinematicScene {
        KinematicScene::new("close", &[DRAWER])
            .goal("in", &["mug_1", DRAWER])
            .object("mug_1", [0.0, 0.0, 0.05], MUG)
            .fixture("cabinet_1", [0.0, 0.3, 0.1], [0.1, 0.1, 0.1])
            .region(DRAWER, "cabinet_1", [0.0, 0.3, 0.15], [0.1, 0.08, 0.03])
            .joint("cabinet_1_top_level", position)
    }

    fn check(scene: &KinematicScene, expected: &[&str]) {
        let skills = plan(&scene.world()).expect("a plan");
        let shown: Vec<String> = skills.iter().map(|skill| format!("{skill:?}")).collect();
        assert_eq!(shown.len(), expected.len(), "{shown:#?}");
        for (skill, word) in shown.iter().zip(expected) {
            assert!(skill.contains(word), "{skill} does not show {word}");
        }
    }

    #[test]
    fn an_open_drawer_is_filled_before_it_is_closed() {
        check(&mug_into_drawer_and_close_it(-0.15), &["Transfer", "PushDrawer"]);
    }

    #[test]
    fn a_shut_drawer_is_opened_before_it_is_filled() {
        check(&mug_into_drawer_and_close_it(0.005), &["PullDrawer", "Transfer"]);
    }

    #[test]
    fn predicates_that_hold_are_skipped() {
        let scene = KinematicScene::new("in", &["mug_1", "basket_1_contain_region"])
            .goal("turnon", &["stove_1"])
            .object("mug_1", [0.0, 0.0, 0.05], MUG)
            .region("basket_1_contain_region", "basket_1", [0.0, 0.0, 0.07], [0.06, 0.06, 0.07])
            .fixture("stove_1", [0.0, 0.4, 0.05], [0.1, 0.1, 0.05])
            .joint("stove_1_button", 1.2);
        check(&scene, &[]);
    }

    #[test]
    fn two_objects_on_one_target_go_to_its_two_sides() {
        let scene = KinematicScene::new("on", &["mug_1", "stove_1_cook_region"])
            .goal("on", &["mug_2", "stove_1_cook_region"])
            .object("mug_1", [0.0, 0.0, 0.05], MUG)
            .object("mug_2", [0.1, 0.0, 0.05], MUG)
            .region("stove_1_cook_region", "stove_1", [0.3, 0.0, 0.0], [0.07, 0.07, 0.002]);
        check(&scene, &["slot: -1.0", "slot: 1.0"]);
    }

    #[test]
    fn a_flat_plate_is_dragged_to_its_region() {
        let scene = KinematicScene::new("on", &["plate_1", "table_front_region"])
            .object("plate_1", [0.0, 0.0, 0.0095], [0.069, 0.069, 0.0095])
            .region("table_front_region", "", [0.3, 0.0, 0.0], [0.04, 0.04, 0.007]);
        check(&scene, &["Drag"]);
    }

    #[test]
    fn a_goal_without_a_skill_is_refused_by_name() {
        let scene = KinematicScene::new("turnoff", &["stove_1"]);
        let refusal = plan(&scene.world()).unwrap_err().to_string();
        assert!(refusal.contains("turnoff stove_1"), "{refusal}");
    }

    #[test]
    fn a_goal_about_a_missing_entity_is_refused_by_name() {
        let scene = KinematicScene::new("on", &["ghost_1", "plate_1"]);
        let refusal = plan(&scene.world()).unwrap_err().to_string();
        assert!(refusal.contains("ghost_1"), "{refusal}");
    }
}
