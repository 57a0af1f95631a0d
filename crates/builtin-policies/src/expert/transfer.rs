//! Skill that picks an object up and places it: a state machine driven by the observation at
//! every step. A missed grasp or a lost object starts another attempt with the next grasp.

use crate::expert::ExpertError;
use crate::expert::geometry::{Quat, Vec3};
use crate::expert::grasp::{self, Grasp, Purpose};
use crate::expert::motion::{
    Command, FINGERS_OPEN_M, FINGERTIP_M, Fingers, HandLoad, HandPose, Motion, detour,
    is_partly_open, pointing_down, pointing_down_like,
};
use crate::expert::place::{Place, Spot};
use crate::expert::world::{Entity, World};

/// Height above a grasp at which the hand starts its descent, m.
const HOVER_M: f64 = 0.04;
/// Retreat of the hand from a released object, m.
const RETREAT_M: f64 = 0.05;
/// Tolerances for proceeding to the next phase, m and rad.
const NEAR_M: f64 = 0.008;
const NEAR_RAD: f64 = 0.06;
/// Tolerances for recognising a descending hand: angle from the grasp, rad, and height above
/// the grasp at which an object may have stopped the hand, m.
const TURNED_RAD: f64 = 0.15;
const STOPPED_M: f64 = 0.015;
/// Angle of the hand from the grasp up to which closing fingers go on closing, rad: an object may
/// turn between the fingers.
const CLOSING_RAD: f64 = 0.6;
/// Distance from the grip point to an object's box within which the object can be held, m.
const BESIDE_M: f64 = 0.005;
/// Horizontal distance of a held object from its place within which the object continues its
/// descent, m.
const OVER_REST_M: f64 = 0.02;
/// Distance from the grasp within which the fingers close, m.
const DEEP_M: f64 = 0.003;
/// Slip of a held object relative to the hand beyond which it counts as lost, m.
const LOST_M: f64 = 0.03;
/// Displacement per step below which a held object at its target counts as resting on it, m. A
/// descending hand moves twice as far, and a hand that releases the object springs back less.
const RESTING_M: f64 = 0.0015;
/// Height by which an object is lifted before the grasp is trusted, m.
const LIFT_M: f64 = 0.03;
/// Smallest and largest number of steps to wait for the fingers to close.
const CLOSING_STEPS: (u32, u32) = (5, 12);
const OPENING_STEPS: u32 = 5;
/// Number of steps after which a phase near obstacles ends regardless of progress, and after
/// which a movement through free space is given up.
const PATIENCE_STEPS: u32 = 60;
const TRAVEL_STEPS: u32 = 120;
/// Numbers of steps without motion after which an object that enters a covered region counts as
/// stopped, and a descending hand as unable to reach its grasp.
const BLOCKED_STEPS: (u32, u32) = (2, 10);
/// Distance from the goal within which a hand that runs out of steps proceeds anyway, m.
const ALMOST_M: f64 = 0.03;
/// Share of full vertical speed near obstacles.
const GENTLE: f64 = 0.4;

#[derive(Clone, Debug)]
pub(crate) struct Transfer {
    object: String,
    place: Place,
    phase: Phase,
    ticks: u32,
    /// Number of failed attempts, which selects the grasp to try next.
    failed_attempts: usize,
    grasp: Option<Grasp>,
    blocked: Option<Grasp>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Choose,
    Approach(Grip),
    Descend(Grip),
    Close(HandPose),
    Lift(Hold),
    Carry(Hold),
    Lower(Hold),
    Release { hand: HandPose, way_out: Vec3 },
    Retreat(HandPose),
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Grip {
    grasp: Grasp,
    quat: Quat,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Hold {
    quat: Quat,
    /// Object's centre relative to the grip point after the fingers closed.
    object_from_grip: Vec3,
    lifted_from: Vec3,
}

enum Next {
    Stay(Command),
    Go(Phase),
    Missed,
    Done,
}

impl Transfer {
    pub(crate) fn new(object: String, place: Place) -> Self {
        Self {
            object,
            place,
            phase: Phase::Choose,
            ticks: 0,
            failed_attempts: 0,
            grasp: None,
            blocked: None,
        }
    }

    pub(crate) fn object(&self) -> &str {
        &self.object
    }

    /// Returns true if the object is in the hand. The fingers of a hand that held the object
    /// before, as `earlier` knows, may shift a little, as when the object touches something.
    pub(crate) fn holds(
        &self,
        earlier: Option<&Self>,
        world: &World,
        motion: &Motion,
    ) -> Result<bool, ExpertError> {
        let object = world.entity(&self.object)?;
        let held_before = earlier.and_then(Self::last_hold);
        let keeps = held_before.is_some_and(|hold| !hold.is_lost(world, object));
        let keeps = keeps && is_partly_open(world) && motion.holds_mechanism();
        Ok((keeps || motion.grasps(world)) && world.gap_to(object) < BESIDE_M)
    }

    fn last_hold(&self) -> Option<Hold> {
        match self.phase {
            Phase::Lift(hold) | Phase::Carry(hold) | Phase::Lower(hold) => Some(hold),
            _ => None,
        }
    }

    /// Returns true if the object is in its place, judging by bounding boxes.
    pub(crate) fn is_placed(&self, world: &World) -> Result<bool, ExpertError> {
        self.place.holds(world, world.entity(&self.object)?)
    }

    /// Returns true if nothing is left to be done after another controller has driven the robot.
    /// An object in the hand counts as placed only where it can be released, and not already above
    /// its place; a released object counts as placed where the hand would have released it.
    pub(crate) fn is_done(
        &self,
        earlier: Option<&Self>,
        world: &World,
        motion: &Motion,
    ) -> Result<bool, ExpertError> {
        let object = world.entity(&self.object)?;
        let spot = self.place.spot(world, object)?;
        if self.holds(earlier, world, motion)? {
            let is_resting = spot.is_at_brim(object) && motion.per_step().norm() < RESTING_M;
            let is_released_here = spot.can_release(world, object) || is_resting;
            return Ok(is_released_here && self.is_placed(world)?);
        }
        let is_free = world.gap_to(object) >= BESIDE_M;
        Ok(self.is_placed(world)? || (is_free && spot.can_stay(object)))
    }

    /// Resumes at the phase derived from the state of the world. `earlier` is the same skill
    /// before another controller drove the robot.
    pub(crate) fn resume(
        &mut self,
        earlier: Option<&Self>,
        world: &World,
        motion: &Motion,
    ) -> Result<(), ExpertError> {
        if let Some(earlier) = earlier {
            (self.failed_attempts, self.grasp) = (earlier.failed_attempts, earlier.grasp);
            self.blocked = earlier.blocked;
        }
        let object = world.entity(&self.object)?;
        let spot = self.place.spot(world, object)?;
        let to_rest = Spot::hand_for(world, object, spot.rest) - world.grip;
        let is_over_rest = to_rest.horizontal_norm() < OVER_REST_M;
        let is_at_rest = is_over_rest && spot.can_release(world, object);
        let is_blocked = spot.can_release_blocked(to_rest)
            && (motion.still_steps() >= BLOCKED_STEPS.0 || motion.opens());
        // Fingers that have begun to open continue until they are clear of the object.
        let may_open = world.opening < FINGERS_OPEN_M || motion.opens();
        let is_released = (is_at_rest || is_blocked) && may_open;
        let phase = if world.gap_to(object) < BESIDE_M && is_released {
            let hand = upright_hand(world);
            // An object stopped before its place is pushed on while the fingers open, so that it
            // does not move back.
            let ahead = if is_at_rest { Vec3::default() } else { to_rest.at_height(0.0) };
            Phase::Release { hand: hand.moved(ahead), way_out: spot.way_out() }
        } else if self.holds(earlier, world, motion)? {
            let hold = self.hold(earlier, world, object);
            let to_approach_start = Spot::hand_for(world, object, spot.approach_start) - world.grip;
            if spot.can_approach(to_approach_start) || spot.is_entering(to_rest) {
                Phase::Lower(hold)
            } else if is_lifting(earlier, world, hold) {
                Phase::Lift(hold)
            } else {
                Phase::Carry(hold)
            }
        } else {
            let grasp = self.nearest_grasp(world, object)?;
            match current_phase(grasp, world, object, motion) {
                // Each resumption restarts the count of steps, so that a hand that cannot reach its
                // grasp is recognised by its steps without motion.
                Phase::Descend(_)
                    if motion.still_steps() % BLOCKED_STEPS.1 == BLOCKED_STEPS.1 - 1 =>
                {
                    self.blocked = Some(grasp);
                    let next_grasp = self.nearest_grasp(world, object)?;
                    current_phase(next_grasp, world, object, motion)
                }
                phase => phase,
            }
        };
        self.enter(phase);
        Ok(())
    }

    fn nearest_grasp(&mut self, world: &World, object: &Entity) -> Result<Grasp, ExpertError> {
        let purpose = self.purpose(world, object)?;
        let (earlier, blocked) = (self.grasp.as_ref(), self.blocked.as_ref());
        let grasp = grasp::nearest(world, object, purpose, earlier, blocked);
        let grasp =
            grasp.ok_or_else(|| ExpertError::NotGraspable { object: self.object.clone() })?;
        self.grasp = Some(grasp);
        Ok(grasp)
    }

    /// Returns the hold of the object: the hold of `earlier` if the object has not slipped since,
    /// otherwise a new hold from the current poses.
    fn hold(&self, earlier: Option<&Self>, world: &World, object: &Entity) -> Hold {
        if let Some(hold) = earlier.and_then(Self::last_hold)
            && !hold.is_lost(world, object)
        {
            return hold;
        }
        Hold {
            quat: upright_hand(world).quat,
            object_from_grip: object.centre - world.grip,
            lifted_from: world.grip,
        }
    }

    fn purpose<'a>(&self, world: &'a World, object: &Entity) -> Result<Purpose<'a>, ExpertError> {
        Ok(Purpose {
            requirement: self.place.grasp_requirement(world)?,
            destination: self.place.spot(world, object)?.rest,
            owner: self.place.owner(world)?,
        })
    }

    /// Returns the command for this step; `None` when the object is released and the hand has
    /// retreated.
    pub(crate) fn step(
        &mut self,
        world: &World,
        motion: &Motion,
    ) -> Result<Option<Command>, ExpertError> {
        loop {
            match self.decide(world, motion)? {
                Next::Stay(command) => {
                    self.ticks += 1;
                    return Ok(Some(command));
                }
                Next::Go(phase) => self.enter(phase),
                Next::Missed => {
                    self.failed_attempts += 1;
                    self.enter(Phase::Choose);
                }
                Next::Done => return Ok(None),
            }
        }
    }

    fn enter(&mut self, phase: Phase) {
        if let Phase::Approach(grip) = phase {
            self.grasp = Some(grip.grasp);
        }
        self.phase = phase;
        self.ticks = 0;
    }

    fn decide(&self, world: &World, motion: &Motion) -> Result<Next, ExpertError> {
        let object = world.entity(&self.object)?;
        Ok(match self.phase {
            Phase::Choose => self.choose(world, object)?,
            Phase::Approach(grip) => self.approach(world, object, grip),
            Phase::Descend(grip) => self.descend(world, object, grip, motion),
            Phase::Close(hand) => self.close(world, object, hand, motion),
            Phase::Lift(hold) => self.lift(world, object, hold),
            Phase::Carry(hold) => self.carry(world, object, hold)?,
            Phase::Lower(hold) => self.lower(world, object, hold, motion)?,
            Phase::Release { hand, .. } if self.ticks < OPENING_STEPS => {
                stay(hand, Fingers::Open, 1.0)
            }
            Phase::Release { hand, way_out } => {
                Next::Go(Phase::Retreat(hand.moved(way_out * RETREAT_M)))
            }
            Phase::Retreat(hand) if near(world, hand) || self.is_overdue() => Next::Done,
            Phase::Retreat(hand) => stay(hand, Fingers::Open, 1.0),
        })
    }

    fn choose(&self, world: &World, object: &Entity) -> Result<Next, ExpertError> {
        let choices = grasp::choices(world, object, self.purpose(world, object)?);
        let grasp = choices[self.failed_attempts % choices.len()];
        let quat = pointing_down(grasp.closing);
        Ok(Next::Go(Phase::Approach(Grip { grasp, quat })))
    }

    fn approach(&self, world: &World, object: &Entity, grip: Grip) -> Next {
        let above = grip.hand(object).moved(Vec3::UP * HOVER_M);
        let is_close = (above.pos - world.grip).norm() < ALMOST_M;
        if near(world, above) || (is_close && self.is_overdue()) {
            return Next::Go(Phase::Descend(grip));
        }
        if self.ticks >= TRAVEL_STEPS {
            return Next::Missed;
        }
        // If the hand is beside the object, the object itself is an obstacle.
        let load = match world.grip.z < object.top() && world.gap_to(object) > 0.0 {
            true => HandLoad::Empty(FINGERTIP_M),
            false => HandLoad::For(object),
        };
        let pos = detour(world, above.pos, load);
        stay(HandPose { pos, ..above }, Fingers::Open, 1.0)
    }

    fn descend(&self, world: &World, object: &Entity, grip: Grip, motion: &Motion) -> Next {
        let hand = grip.hand(object);
        // In the first steps of a phase the hand has not yet set off.
        let has_stopped = self.ticks > 5 && motion.still_steps() >= 3;
        if (hand.pos - world.grip).norm() < DEEP_M || has_stopped || self.is_overdue() {
            return Next::Go(Phase::Close(HandPose { pos: world.grip, ..hand }));
        }
        // Moves sideways first if the fingers would come down on the object.
        let aside = (hand.pos - world.grip).horizontal_norm();
        let pos = if aside > 2.0 * NEAR_M { hand.pos.at_height(world.grip.z) } else { hand.pos };
        stay(HandPose { pos, ..hand }, Fingers::Open, GENTLE)
    }

    fn close(&self, world: &World, object: &Entity, hand: HandPose, motion: &Motion) -> Next {
        let (least, most) = CLOSING_STEPS;
        if self.ticks >= most || (self.ticks >= least && motion.finger_still_steps() >= 2) {
            return Next::Go(Phase::Lift(Hold {
                quat: hand.quat,
                object_from_grip: object.centre - world.grip,
                lifted_from: world.grip,
            }));
        }
        stay(hand, Fingers::Close, 1.0)
    }

    fn lift(&self, world: &World, object: &Entity, hold: Hold) -> Next {
        if hold.is_lost(world, object) || self.is_overdue() {
            return Next::Missed;
        }
        let goal = hold.lifted_from + Vec3::UP * (LIFT_M + NEAR_M);
        if world.grip.z > hold.lifted_from.z + LIFT_M {
            return Next::Go(Phase::Carry(hold));
        }
        hold_to(goal, hold, 1.0)
    }

    fn carry(&self, world: &World, object: &Entity, hold: Hold) -> Result<Next, ExpertError> {
        if hold.is_lost(world, object) || self.ticks >= TRAVEL_STEPS {
            return Ok(Next::Missed);
        }
        let spot = self.place.spot(world, object)?;
        let goal = Spot::hand_for(world, object, spot.approach_start);
        if spot.can_approach(goal - world.grip) {
            return Ok(Next::Go(Phase::Lower(hold)));
        }
        let pos = detour(world, goal, HandLoad::With(object));
        Ok(hold_to(pos, hold, 1.0))
    }

    fn lower(
        &self,
        world: &World,
        object: &Entity,
        hold: Hold,
        motion: &Motion,
    ) -> Result<Next, ExpertError> {
        let spot = self.place.spot(world, object)?;
        let has_stopped = self.ticks > 3 && motion.still_steps() >= 2;
        if spot.can_release(world, object) || has_stopped || self.is_overdue() {
            let hand = HandPose { pos: world.grip, quat: hold.quat };
            return Ok(Next::Go(Phase::Release { hand, way_out: spot.way_out() }));
        }
        let pos = Spot::hand_for(world, object, spot.rest);
        Ok(hold_to(pos, hold, GENTLE))
    }

    fn is_overdue(&self) -> bool {
        self.ticks >= PATIENCE_STEPS
    }
}

impl Grip {
    fn hand(&self, object: &Entity) -> HandPose {
        HandPose { pos: object.centre + self.grasp.offset, quat: self.quat }
    }
}

impl Hold {
    fn is_lost(&self, world: &World, object: &Entity) -> bool {
        (object.centre - world.grip - self.object_from_grip).norm() > LOST_M
    }
}

/// Returns the current position of the hand, with the orientation that points down and is nearest
/// to the hand's current orientation.
fn upright_hand(world: &World) -> HandPose {
    let closing = world.grip_quat.rotate(Vec3::new(1.0, 0.0, 0.0));
    HandPose { pos: world.grip, quat: pointing_down_like(world, closing.y.atan2(closing.x)) }
}

/// Returns true if the object has not yet been lifted since the fingers closed. If the hand moved
/// sideways before lifting, surrounding objects would tear the object out of the hand.
fn is_lifting(earlier: Option<&Transfer>, world: &World, hold: Hold) -> bool {
    let phase = earlier.map(|earlier| earlier.phase);
    let has_closed = matches!(phase, Some(Phase::Close(_) | Phase::Lift(_)));
    has_closed && world.grip.z < hold.lifted_from.z + LIFT_M
}

/// Derives the phase of a hand that does not yet hold the object from the pose of the hand.
fn current_phase(grasp: Grasp, world: &World, object: &Entity, motion: &Motion) -> Phase {
    let quat = pointing_down_like(world, grasp.closing);
    let grip = Grip { grasp, quat };
    let hand = grip.hand(object);
    let aside = (hand.pos - world.grip).horizontal_norm();
    let above = world.grip.z - hand.pos.z;
    let is_turned = hand.turn_from(world) < TURNED_RAD;
    let is_deep = above < NEAR_M || (above < STOPPED_M && motion.still_steps() >= 3);
    if is_turned && aside < NEAR_M && is_deep && motion.may_close(world) {
        return Phase::Close(HandPose { pos: world.grip, ..hand });
    }
    let is_closing = world.opening < FINGERS_OPEN_M && motion.may_close(world);
    let is_at_object = world.gap_to(object) < BESIDE_M && aside < ALMOST_M && above < STOPPED_M;
    if is_closing && is_at_object && hand.turn_from(world) < CLOSING_RAD {
        return Phase::Close(upright_hand(world));
    }
    let is_above_grasp = aside < 2.0 * NEAR_M && above < HOVER_M + 2.0 * NEAR_M;
    match is_turned && is_above_grasp && world.opening > FINGERS_OPEN_M {
        true => Phase::Descend(grip),
        false => Phase::Approach(grip),
    }
}

fn near(world: &World, hand: HandPose) -> bool {
    hand.is_near(world, NEAR_M, NEAR_RAD)
}

fn stay(hand: HandPose, fingers: Fingers, pace: f64) -> Next {
    Next::Stay(Command { hand, fingers, pace })
}

fn hold_to(pos: Vec3, hold: Hold, pace: f64) -> Next {
    stay(HandPose { pos, quat: hold.quat }, Fingers::Close, pace)
}

#[cfg(test)]
mod tests;
