//! How objects lie: what overlaps, what has moved, what has fallen.

use scene::{InstanceKind, Predicate, Problem};
use sim::mujoco::ObjectKind;
use sim::predicates::Goal;
use sim::{Entity, EntityKind, Environment, Episode, ObservationRequest};

/// Movable objects may overlap with anything by this much at rest, m.
pub(crate) const MAX_OVERLAP: f64 = 0.005;
/// Horizontally an object comes to rest this close to where it was released, m.
const MAX_DRIFT: f64 = 0.15;

/// Everything in the scene.
pub(crate) fn entities(episode: &mut Episode<'_>) -> Vec<Entity> {
    let request = ObservationRequest {
        privileged: true,
        ..ObservationRequest::default()
    };
    let seen = episode.observe(&request).expect("nothing is drawn");
    seen.privileged.expect("asked for").entities
}

/// The deepest overlap of a movable object with anything, m, and who overlaps.
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

/// A scene as it was released: its objects float above where they belong.
pub(crate) struct Released<'a> {
    problem: &'a Problem,
    objects: Vec<Entity>,
}

impl<'a> Released<'a> {
    /// Remembers where everything is.
    pub(crate) fn look(problem: &'a Problem, episode: &mut Episode<'_>) -> Self {
        let mut objects = entities(episode);
        objects.retain(|entity| entity.kind == EntityKind::Object);
        Self { problem, objects }
    }

    /// What has left its place since.
    pub(crate) fn compare(&self, episode: &mut Episode<'_>) -> Vec<String> {
        let now = entities(episode);
        let mut problems = Vec::new();
        for before in &self.objects {
            let name = &before.name;
            let after = now.iter().find(|entity| entity.name == *name);
            let after = after.expect("objects do not vanish");
            let drift = (after.pos[0] - before.pos[0]).hypot(after.pos[1] - before.pos[1]);
            if !(drift <= MAX_DRIFT) {
                problems.push(format!("{name} moved {:.0} mm", drift * 1e3));
            }
        }
        problems.extend(
            untrue(&self.problem.init, episode.environment())
                .into_iter()
                .map(|predicate| format!("{predicate} does not hold at rest")),
        );
        problems
    }
}

/// Those of the statements about movable objects and joints that do not hold.
pub(crate) fn untrue(statements: &[Predicate], environment: &Environment) -> Vec<Predicate> {
    let scene = environment.scene();
    let about_fixture = |statement: &Predicate| {
        let first = scene.instance(&statement.arguments[0]);
        statement.arguments.len() == 2
            && first.is_none_or(|instance| instance.kind == InstanceKind::Fixture)
    };
    let mut checked = statements.to_vec();
    checked.retain(|statement| !about_fixture(statement));
    let mut beginning = scene.clone();
    beginning.goal = checked.clone();
    let goal = Goal::resolve(&beginning, environment.model()).expect("the scene was composed of them");
    let truths = goal.truths(environment.model(), environment.data());
    let pairs = checked.into_iter().zip(truths);
    pairs
        .filter(|(_, holds)| !holds)
        .map(|(statement, _)| statement)
        .collect()
}
