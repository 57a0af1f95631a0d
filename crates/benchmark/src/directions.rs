//! Directions and initial states of configurations, drawn from the seed of a design. The shared
//! directions of configurations 0 to 9 are the protocol's presets; the shared directions of later
//! configurations, and all task-specific directions, are drawn on the unit sphere.

use serde::{Deserialize, Serialize};

use crate::axis::Axis;
use crate::presets::{PRESETS, half_space, preset_direction, unit};
use crate::streams::{MatchedRng, MatchedStream};
use crate::suite::{INIT_STATES_PER_TASK, TaskRef};

pub const MAX_CONFIGS: u16 = 1_000;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Directions {
    /// Shared by all tasks: a configuration has the same direction in each task, which is the
    /// protocol's preset for configurations 0 to 9. Results then hold for these directions only.
    #[default]
    Shared,
    /// Drawn separately for each task from the design's seed, also for configurations 0 to 9.
    /// Results then generalise to all directions, of which the configurations are a sample.
    Own,
}

impl Directions {
    /// Serialised records leave the default out.
    pub fn is_shared(&self) -> bool {
        *self == Self::Shared
    }
}

/// Part of the key of every random stream of this module; it must change whenever the drawn values
/// change.
const VERSION: &str = "libero-ctrl/configurations/1";

/// Returns the direction of a configuration in the normalised coordinates of an axis: a
/// unit vector, empty for the language axis.
///
/// A drawn direction is uniform on the sphere, then folded into the axis's half-spaces. It
/// depends only on `design_seed`, axis and configuration and, for [`Directions::Own`], on the
/// task.
pub(crate) fn direction(
    directions: Directions,
    task: TaskRef,
    axis: Axis,
    config: u16,
    design_seed: u64,
) -> Vec<f64> {
    let name = match directions {
        Directions::Shared if config < PRESETS => return preset_direction(axis, config).to_vec(),
        Directions::Shared => format!("{axis}/c{config}"),
        Directions::Own => format!("{task}/{axis}/c{config}"),
    };
    let mut rng = named_rng(design_seed, &name);
    // A normalised vector of independent normals is uniform on the sphere.
    let mut direction: Vec<f64> = unit(axis).iter().map(|_| rng.standard_normal()).collect();
    let length = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
    for component in &mut direction {
        *component /= length;
    }
    for &component in half_space(axis) {
        direction[component] = direction[component].abs();
    }
    direction
}

/// Initial state of a configuration of a task.
///
/// The presets have the protocol's states; later configurations have the remaining states of
/// the task in an order drawn from `design_seed`, so that fifty configurations cover all
/// fifty states. From the fifty-first configuration on, states repeat.
pub(crate) fn init_id(task: TaskRef, config: u16, design_seed: u64) -> u16 {
    let evaluated = task.eval_init_ids();
    let index = usize::from(config % INIT_STATES_PER_TASK);
    if let Some(&init_id) = evaluated.get(index) {
        return init_id;
    }
    let mut remaining: Vec<u16> =
        (0..INIT_STATES_PER_TASK).filter(|init_id| !evaluated.contains(init_id)).collect();
    let mut rng = named_rng(design_seed, &format!("{task}/init"));
    for last in (1..remaining.len()).rev() {
        let drawn = (rng.random() * (last + 1) as f64) as usize;
        remaining.swap(last, drawn);
    }
    remaining[index - evaluated.len()]
}

fn named_rng(design_seed: u64, name: &str) -> MatchedRng {
    MatchedStream::named(&format!("{VERSION}/{design_seed}/{name}")).fixed()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn shared(axis: Axis, config: u16, design_seed: u64) -> Vec<f64> {
        let task = "libero_goal/3".parse().expect("a task");
        direction(Directions::Shared, task, axis, config, design_seed)
    }

    #[test]
    fn own_directions_differ_by_task_axis_configuration_and_seed() {
        let draw = |task: TaskRef, axis, config, seed| {
            direction(Directions::Own, task, axis, config, seed)
        };
        let [task, other_task] =
            ["libero_goal/3", "libero_goal/4"].map(|text| text.parse().expect("a task"));
        for config in [0, 10] {
            let direction = draw(task, Axis::Camera, config, 1);
            let length = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!((length - 1.0).abs() < 1e-12 && direction[2] >= 0.0, "{direction:?}");
            assert_ne!(direction, draw(other_task, Axis::Camera, config, 1));
            assert_ne!(direction, draw(task, Axis::Camera, config, 2));
            assert_ne!(direction, draw(task, Axis::Lighting, config, 1));
            assert_ne!(direction, shared(Axis::Camera, config, 1));
        }
    }

    #[test]
    fn fifty_configurations_have_fifty_initial_states() {
        for task in TaskRef::all() {
            let states: BTreeSet<u16> = (0..50).map(|config| init_id(task, config, 7)).collect();
            assert_eq!(states.len(), 50, "{task}");
            assert_eq!(init_id(task, 53, 7), init_id(task, 3, 7));
        }
    }

    #[test]
    fn the_presets_do_not_depend_on_the_seed_of_the_design() {
        let task: TaskRef = "libero_goal/3".parse().expect("a task");
        for config in 0..PRESETS {
            assert_eq!(init_id(task, config, 1), task.eval_init_ids()[config as usize]);
            for axis in Axis::ALL {
                assert_eq!(shared(axis, config, 1), shared(axis, config, 2));
            }
        }
        let states = |seed| (10..50).map(|c| init_id(task, c, seed)).collect::<Vec<_>>();
        assert_ne!(states(1), states(2));
        assert_ne!(shared(Axis::Camera, 10, 1), shared(Axis::Camera, 10, 2));
    }

    /// A change here changes the configurations of every custom design and needs a new [`VERSION`].
    #[test]
    fn the_configurations_of_a_seed_never_change() {
        let task: TaskRef = "libero_goal/3".parse().expect("a task");
        let states: Vec<u16> = (10..16).map(|config| init_id(task, config, 0)).collect();
        assert_eq!(states, [35, 1, 29, 22, 45, 34]);
        let expected =
            [-0.752559361788223, -0.46056951937932705, 0.4261873060080315, -0.19973608837967805];
        assert_eq!(shared(Axis::Sensor, 10, 0), expected);
    }
}
