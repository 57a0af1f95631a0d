//! Where LIBERO's placement sampler puts the fixtures. Their poses are not
//! part of the released initial states, so the sampler's random stream has to
//! be followed draw by draw: NumPy's legacy generator, seeded immediately
//! before one construction's seeded reset, objects and fixtures in `:init`
//! order, rejections included. Poses of movable objects are computed only as
//! far as they decide a rejection; the initial state overwrites them.

use protocol::numpy::LegacyRng;

use crate::arena::Arena;
use crate::bddl::{Problem, Rectangle};
use crate::catalog::Articulation;
use crate::error::SceneError;
use crate::instance::InstanceKind;
use crate::object::{Footprint, ObjectPart};

/// A fixture's pose in the world.
#[derive(Debug, Clone, PartialEq)]
pub struct FixturePose {
    /// The fixture's outermost body.
    pub root_body: String,
    /// m.
    pub pos: [f64; 3],
    /// w x y z.
    pub quat: [f64; 4],
}

/// Height of a movable object's underside over the workspace when placed, m.
const OBJECT_Z_OFFSET: f64 = 0.01;
/// Attempts before the original gives up.
const MAX_ATTEMPTS: usize = 5000;
/// Arm joints, for each of which a reset draws one normal number, even though
/// LIBERO scales that noise by zero.
const ARM_JOINTS: usize = 7;
/// The list of joint samplers has been filled twice by the time of the first
/// seeded reset: once in construction, once in the reset itself.
const JOINT_SAMPLER_ROUNDS: usize = 2;

struct Placed {
    pos: [f64; 3],
    footprint: Footprint,
}

/// Follows one seeded reset and returns the fixtures' poses.
pub(crate) fn place_fixtures(
    problem: &Problem,
    arena: &Arena,
    parts: &[ObjectPart],
    env_seed: u32,
) -> Result<Vec<FixturePose>, SceneError> {
    let mut rng = LegacyRng::seed(env_seed);
    for _ in 0..ARM_JOINTS {
        rng.randn();
    }
    for _ in 0..JOINT_SAMPLER_ROUNDS * joint_samplers(problem, parts) {
        rng.random_sample();
    }
    let mut placed: Vec<Placed> = Vec::new();
    let mut poses = Vec::new();
    for predicate in &problem.init {
        let [name, region] = predicate.arguments.as_slice() else {
            continue;
        };
        let (Some(part), Some(region)) = (find(parts, name), problem.region(region)) else {
            continue;
        };
        // Objects on or in others are placed after all fixtures, so their
        // draws decide nothing here.
        if predicate.name != "on" || find(parts, &region.target).is_some() {
            continue;
        }
        let fixture = part.instance.kind == InstanceKind::Fixture;
        let inset = if !fixture && arena.whole_object_in_region {
            part.footprint.radius
        } else {
            0.0
        };
        let z_offset = if fixture {
            arena.fixture_z_offset
        } else {
            OBJECT_Z_OFFSET
        };
        let mut attempts = 0;
        let pos = loop {
            if attempts == MAX_ATTEMPTS || region.ranges.is_empty() {
                return Err(SceneError::NoRoom {
                    object: name.clone(),
                    region: region.name.clone(),
                    attempts,
                });
            }
            attempts += 1;
            let pos = sample_position(&mut rng, &region.ranges, inset, arena);
            let pos = [
                pos[0],
                pos[1],
                z_offset + arena.workspace_offset[2] - part.footprint.bottom,
            ];
            if fixture
                || placed
                    .iter()
                    .all(|other| is_clear(pos, part.footprint, other))
            {
                break pos;
            }
        };
        if fixture {
            let yaw = rng.uniform(
                region.yaw[0].min(region.yaw[1]),
                region.yaw[0].max(region.yaw[1]),
            );
            poses.push(FixturePose {
                root_body: part.instance.root_body.clone(),
                pos,
                quat: [(yaw / 2.0).cos(), 0.0, 0.0, (yaw / 2.0).sin()],
            });
        } else {
            for _ in 0..part.instance.category.rotation_draws {
                rng.random_sample();
            }
        }
        placed.push(Placed {
            pos,
            footprint: part.footprint,
        });
    }
    Ok(poses)
}

fn find<'a>(parts: &'a [ObjectPart], name: &str) -> Option<&'a ObjectPart> {
    parts.iter().find(|part| part.instance.name == name)
}

/// How many joints the initial state sets by drawing: one sampler for each
/// open, close, turn-on or turn-off statement about something that can.
fn joint_samplers(problem: &Problem, parts: &[ObjectPart]) -> usize {
    problem
        .init
        .iter()
        .filter(|predicate| {
            matches!(
                predicate.name.as_str(),
                "open" | "close" | "turnon" | "turnoff"
            ) && parts.iter().any(|part| {
                part.instance.category.articulation != Articulation::None
                    && predicate.arguments.iter().any(|argument| {
                        *argument == part.instance.name || part.region_site(argument).is_some()
                    })
            })
        })
        .count()
}

fn sample_position(
    rng: &mut LegacyRng,
    ranges: &[Rectangle],
    inset: f64,
    arena: &Arena,
) -> [f64; 2] {
    let range = &ranges[rng.randint(ranges.len() as u32) as usize];
    // With a large radius the bounds cross; the original draws all the same.
    let x = rng.uniform(range.x[0] + inset, range.x[1] - inset) + arena.workspace_offset[0];
    let y = rng.uniform(range.y[0] + inset, range.y[1] - inset) + arena.workspace_offset[1];
    [x, y]
}

fn is_clear(pos: [f64; 3], footprint: Footprint, other: &Placed) -> bool {
    let distance = (pos[0] - other.pos[0]).hypot(pos[1] - other.pos[1]);
    let beside = distance > other.footprint.radius + footprint.radius;
    let above = pos[2] - other.pos[2] > other.footprint.top - footprint.bottom;
    beside || above
}
