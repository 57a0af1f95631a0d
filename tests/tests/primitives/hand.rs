//! Reaches goals without a policy: sets joints beyond their thresholds, puts objects at their goal
//! positions, just clear of other objects, and releases them. Everything is computed from the goal
//! and the scene.

use benchmark::{Entity, Predicate};
use scene::catalog::{Articulation, Threshold};
use scene::{Instance, Scene};
use sim::episode::NO_OP;
use sim::mujoco::ObjectKind;
use sim::{Environment, Episode};

use crate::table::{MAX_OVERLAP, deepest_overlap, entities};

/// Distance beyond its threshold at which a joint is set, m or rad, if its range allows.
const THRESHOLD_MARGIN: f64 = 0.02;
/// Largest overlap of an object with anything else at its release, m.
const FREE_OVERLAP: f64 = 0.001;
/// Steps of the search for free space, upwards and sideways, m.
const LIFT_STEP: f64 = 0.005;
const SIDEWAYS_STEP: f64 = 0.02;
/// Limits of the search: height, m, and number of sideways steps.
const MAX_LIFT: f64 = 0.25;
const MAX_SIDEWAYS_STEPS: i32 = 4;
/// Control steps after which a released object lies still.
const REST_STEPS: usize = 20;
/// Number of releases of an object after which its goal counts as out of reach.
const MAX_TRIALS: usize = 40;

/// Makes the goal of a settled scene true and lets everything come to rest. The error describes
/// what prevents this.
pub(crate) fn reach_goal(episode: &mut Episode<'_>) -> Result<(), String> {
    let environment = episode.environment();
    let scene = environment.scene().clone();
    let mut state = resting_state(environment);
    for predicate in openings(&scene).iter().chain(&scene.goal) {
        if let [name] = predicate.arguments.as_slice() {
            move_joints(environment, &scene, &predicate.name, name, &mut state)?;
        }
    }
    let mut reached: Vec<usize> = Vec::new();
    for (index, predicate) in scene.goal.iter().enumerate() {
        if predicate.arguments.len() == 2 {
            reached.push(index);
            state = place_object(episode, &state, &scene.goal, &reached)
                .ok_or_else(|| format!("no placement of the object makes {predicate} true"))?;
        }
    }
    let environment = episode.environment();
    environment.load(&state);
    wait_for_rest(environment)?;
    let truths = environment.goal_truths();
    let untrue = scene.goal.iter().zip(truths).find(|(_, holds)| !holds);
    match untrue {
        Some((predicate, _)) => Err(format!("{predicate} does not stay true at rest")),
        None => Ok(()),
    }
}

/// Returns an `open` predicate for each drawer or door that objects enter and that stays open.
fn openings(scene: &Scene) -> Vec<Predicate> {
    let must_be_closed = |name: &String| {
        let close = |goal: &Predicate| goal.name == "close" && goal.arguments[0] == *name;
        scene.goal.iter().any(close)
    };
    let mut openings = Vec::new();
    for predicate in scene.goal.iter().filter(|predicate| predicate.name == "in") {
        let region = scene.region(&predicate.arguments[1]);
        if let Some(region) = region.filter(|region| !region.joints.is_empty())
            && !must_be_closed(&region.name)
        {
            openings
                .push(Predicate { name: "open".to_owned(), arguments: vec![region.name.clone()] });
        }
    }
    openings
}

/// Returns the state with all velocities zero: time, positions, velocities.
fn resting_state(environment: &Environment) -> Vec<f64> {
    let (model, data) = (environment.model(), environment.data());
    let mut state = vec![data.time_secs()];
    state.extend(data.qpos(model));
    state.extend(vec![0.0; model.nv()]);
    state
}

fn wait_for_rest(environment: &mut Environment) -> Result<(), String> {
    for _ in 0..REST_STEPS {
        environment.step(&NO_OP).map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// Puts the joints of a region or an instance beyond the predicate's threshold.
fn move_joints(
    environment: &Environment,
    scene: &Scene,
    predicate: &str,
    name: &str,
    state: &mut [f64],
) -> Result<(), String> {
    let (instance, joints) = joints_of(scene, name);
    let threshold = match (predicate, instance.category.articulation) {
        ("open", Articulation::OpenClose { open, .. }) => open,
        ("close", Articulation::OpenClose { close, .. }) => close,
        ("turnon", Articulation::OnOff { on, .. }) => Threshold::Above(on),
        ("turnoff", Articulation::OnOff { off, .. }) => Threshold::Below(off),
        _ => return Err(format!("{name} has no joint threshold for `{predicate}`")),
    };
    let model = environment.model();
    for joint in joints {
        let id = model.id(ObjectKind::Joint, joint).expect("in the model");
        let range = &model.jnt_range()[id * 2..][..2];
        let position = match threshold {
            Threshold::Above(limit) => (limit + THRESHOLD_MARGIN).min(range[1]),
            Threshold::Below(limit) => (limit - THRESHOLD_MARGIN).max(range[0]),
        };
        if !threshold.holds(position) {
            return Err(format!(
                "{joint} moves from {} to {}: too little to {predicate}",
                range[0], range[1]
            ));
        }
        // The state begins with the time, followed by the positions.
        state[1 + model.jnt_qposadr()[id] as usize] = position;
    }
    Ok(())
}

fn joints_of<'a>(scene: &'a Scene, name: &str) -> (&'a Instance, &'a [String]) {
    if let Some(instance) = scene.instance(name) {
        return (instance, &instance.joints);
    }
    let region = scene.region(name).expect("the goal was resolved");
    let parent = region.parent.as_deref().expect("a parent with joints");
    let instance = scene.instance(parent).expect("the region's parent");
    (instance, &region.joints)
}

/// Makes the last of the reached predicates true while the earlier ones stay true: releases its
/// object on or in its place, at one position after another. Returns the state at rest; `None` if
/// no position works.
fn place_object(
    episode: &mut Episode<'_>,
    state: &[f64],
    goal: &[Predicate],
    reached: &[usize],
) -> Option<Vec<f64>> {
    let index = *reached.last()?;
    let [object, place] = goal[index].arguments.as_slice() else {
        return None;
    };
    episode.environment().load(state);
    let place = entity(episode, place);
    let preferred = share_offset(goal, index, &place);
    let resting = entity(episode, object);
    let underside = resting.pos[2] - (resting.centre[2] - resting.half_extents[2]);
    let lowest = place.centre[2] - place.half_extents[2] + underside;
    let address = free_joint(episode.environment(), object);
    let environment = episode.environment();
    let mut trials = 0;
    for [x, y] in sideways_offsets(preferred) {
        let from = [place.pos[0] + x, place.pos[1] + y, lowest];
        if !lift_free(environment, state, address, from) {
            continue;
        }
        trials += 1;
        if trials > MAX_TRIALS {
            return None;
        }
        if wait_for_rest(environment).is_ok()
            && reached.iter().all(|index| environment.goal_truths()[*index])
            && deepest_overlap(environment).0 <= MAX_OVERLAP
        {
            return Some(resting_state(environment));
        }
    }
    None
}

/// Returns the offset from the place's centre, m, for an object that shares the place with other
/// objects of the goal: the middle of its share of the longer side.
fn share_offset(goal: &[Predicate], index: usize, place: &Entity) -> [f64; 2] {
    let shares = |predicate: &Predicate| predicate.arguments.get(1) == Some(&place.name);
    let count = goal.iter().filter(|predicate| shares(predicate)).count();
    let before = goal[..index].iter().filter(|p| shares(p)).count();
    let share = (2 * before + 1) as f64 / count as f64 - 1.0;
    let [half_x, half_y, _] = place.half_extents;
    let along_x = half_x > half_y;
    let offset = share * half_x.max(half_y);
    // The place's axes in the world frame; places lie flat and are rotated about z.
    let [w, _, _, z] = place.quat_wxyz;
    let (sin, cos) = (2.0 * z.atan2(w)).sin_cos();
    if along_x { [offset * cos, offset * sin] } else { [-offset * sin, offset * cos] }
}

/// Raises the object of this free joint from a position until it overlaps nothing, and leaves the
/// scene in that state. Returns false if no height up to [`MAX_LIFT`] is free.
fn lift_free(environment: &mut Environment, state: &[f64], address: usize, from: [f64; 3]) -> bool {
    let mut state = state.to_vec();
    // The state begins with the time; the object's rotation is unchanged.
    let position = 1 + address..1 + address + 3;
    state[position.clone()].copy_from_slice(&from);
    while state[position.end - 1] < from[2] + MAX_LIFT {
        environment.load(&state);
        if deepest_overlap(environment).0 <= FREE_OVERLAP {
            return true;
        }
        state[position.end - 1] += LIFT_STEP;
    }
    false
}

fn entity(episode: &mut Episode<'_>, name: &str) -> Entity {
    let all = entities(episode);
    let found = all.into_iter().find(|entity| entity.name == name);
    found.expect("the goal was resolved")
}

/// Returns the index of the first position coordinate of an object's free joint.
fn free_joint(environment: &Environment, object: &str) -> usize {
    let instance = environment.scene().instance(object);
    let joint = instance.and_then(|instance| instance.joints.last());
    let joint = joint.expect("objects move freely");
    let model = environment.model();
    let id = model.id(ObjectKind::Joint, joint).expect("in the model");
    model.jnt_qposadr()[id] as usize
}

/// Returns sideways offsets, m, in order of their distance from the preferred one.
fn sideways_offsets(preferred: [f64; 2]) -> Vec<[f64; 2]> {
    let steps =
        || (-MAX_SIDEWAYS_STEPS..=MAX_SIDEWAYS_STEPS).map(|step| f64::from(step) * SIDEWAYS_STEP);
    let mut sideways_offsets: Vec<_> = steps().flat_map(|x| steps().map(move |y| [x, y])).collect();
    sideways_offsets.sort_by(|a, b| {
        let distance = |at: &[f64; 2]| (at[0] - preferred[0]).hypot(at[1] - preferred[1]);
        distance(a).total_cmp(&distance(b))
    });
    sideways_offsets
}
