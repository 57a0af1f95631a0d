//! Positions of objects at rest: overlaps, displacements and falls.

use benchmark::{Entity, EntityKind, Predicate};
use scene::arena::arena;
use scene::{InstanceKind, Problem};
use sim::mujoco::ObjectKind;
use sim::predicates::Goal;
use sim::{Environment, Episode, ObservationRequest};

/// Largest allowed overlap of a movable object with another body at rest, m.
pub(crate) const MAX_OVERLAP: f64 = 0.005;
/// Largest allowed horizontal distance between an object's released and resting positions, m.
pub(crate) const MAX_DRIFT: f64 = 0.15;

pub(crate) fn entities(episode: &mut Episode<'_>) -> Vec<Entity> {
    let request = ObservationRequest { privileged: true, ..ObservationRequest::default() };
    let observation = episode.observe(&request).expect("nothing is rendered");
    observation.privileged.expect("privileged state").entities
}

/// Returns the deepest overlap of a movable object with another geom, m, and the names of the two
/// geoms.
pub(crate) fn deepest_overlap(environment: &Environment) -> (f64, String) {
    let (scene, model) = (environment.scene(), environment.model());
    let objects = scene.instances.iter();
    let movable: Vec<usize> = objects
        .filter(|instance| instance.kind == InstanceKind::Object)
        .flat_map(|instance| &instance.contact_geoms)
        .map(|geom| model.id(ObjectKind::Geom, geom).expect("a geom of the model"))
        .collect();
    let mut deepest = (0.0, String::new());
    for contact in environment.data().contacts() {
        let geoms = contact.geoms.map(|geom| geom as usize);
        if -contact.distance > deepest.0 && geoms.iter().any(|geom| movable.contains(geom)) {
            let names = geoms.map(|geom| {
                let name = model.name(ObjectKind::Geom, geom);
                name.unwrap_or_else(|| format!("geom {geom}"))
            });
            deepest = (-contact.distance, names.join(" and "));
        }
    }
    deepest
}

/// A scene at its release, when objects float above their resting places.
pub(crate) struct Released<'a> {
    problem: &'a Problem,
    objects: Vec<Entity>,
}

impl<'a> Released<'a> {
    pub(crate) fn record(problem: &'a Problem, episode: &mut Episode<'_>) -> Self {
        let mut objects = entities(episode);
        objects.retain(|entity| entity.kind == EntityKind::Object);
        Self { problem, objects }
    }

    /// Describes the objects that have moved by more than `drift` m or fallen since their release,
    /// and the initial statements that do not hold.
    pub(crate) fn compare(&self, episode: &mut Episode<'_>, drift: f64) -> Vec<String> {
        let at_rest = entities(episode);
        let workspace = workspace_height(self.problem);
        let mut problems = Vec::new();
        for before in &self.objects {
            let name = &before.name;
            let after = at_rest.iter().find(|entity| entity.name == *name);
            let after = after.expect("objects do not vanish");
            let moved = (after.pos[0] - before.pos[0]).hypot(after.pos[1] - before.pos[1]);
            if moved.is_nan() || moved > drift {
                problems.push(format!("{name} moved {:.0} mm", moved * 1e3));
            }
            let height = after.centre[2] - after.half_extents[2] - workspace;
            if height < -MAX_OVERLAP {
                let below = -height * 1e3;
                problems.push(format!("{name} lies {below:.1} mm below the workspace"));
            }
        }
        let untrue = untrue_statements(&self.problem.init, episode.environment());
        problems.extend(
            untrue.into_iter().map(|statement| format!("{statement} does not hold at rest")),
        );
        problems
    }
}

/// Returns the height of the surface on which zones lie, m: 0 for a floor, whose arena declares an
/// offset slightly below 0.
fn workspace_height(problem: &Problem) -> f64 {
    let arena = arena(&problem.name).expect("the scene was composed");
    arena.workspace_offset[2].max(0.0)
}

/// Returns the initial statements of a problem that should hold and do not: objects on or in
/// anything but a zone, and joints that are open, closed, on or off. Zones are left out, since in
/// LIBERO itself some objects lie beyond the border of their zone.
fn untrue_statements(init: &[Predicate], environment: &Environment) -> Vec<Predicate> {
    let scene = environment.scene();
    let is_object = |name: &String| {
        let instance = scene.instance(name);
        instance.is_some_and(|instance| instance.kind == InstanceKind::Object)
    };
    let is_zone = |name: &String| {
        let region = scene.region(name);
        region.is_some_and(|region| region.parent.is_none())
    };
    let mut statements = init.to_vec();
    statements.retain(|statement| match statement.arguments.as_slice() {
        [upper, lower] => is_object(upper) && !is_zone(lower),
        _ => true,
    });
    let goal = Goal::resolve(&statements, scene, environment.model());
    let goal = goal.expect("LIBERO's own statements");
    let truths = goal.truths(environment.model(), environment.data());
    let pairs = statements.into_iter().zip(truths);
    pairs.filter(|(_, holds)| !holds).map(|(statement, _)| statement).collect()
}
