//! Compares the interval of a half-success radius with the planted radius, in simulated campaigns
//! of 40 tasks whose thresholds are drawn from a population with a known median.

use benchmark::{Axis, Condition, Level, RolloutId, TaskRef, Thresholds};
use paired::adaptive::radii::{Curve, Measurement};
use paired::{Bootstrap, Outcome, Record};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::{measure, record, thresholds};

const CONFIGS: u16 = 10;
const CAMPAIGNS: u64 = 60;
/// Fewer resamplings than in reports: interval ends differ by a few per cent of the width.
const BOOTSTRAP: Bootstrap = Bootstrap { replicates: 300, seed: 1 };

/// A log-normal population of thresholds, with part of its variance between tasks.
#[derive(Clone, Copy)]
struct Population {
    condition: Condition,
    median: f64,
    /// Standard deviations of the logarithm: between tasks, and within a task.
    spread: [f64; 2],
    /// Share of the outcomes at the largest radius that are in quarantine.
    quarantined: f64,
}

fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (f64::from(rng.next_u32()) + 0.5) / (f64::from(u32::MAX) + 1.0)
}

/// Returns a nearly standard normal number, the sum of twelve uniform ones.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| uniform(rng)).sum::<f64>() - 6.0
}

impl Population {
    /// Returns the curve of a completely measured campaign of 40 tasks drawn from the population.
    fn curve(self, seed: u64) -> Curve {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let [between, within] = self.spread;
        let mut fails_at = Vec::new();
        for _ in TaskRef::all() {
            let of_task = between * normal(&mut rng);
            for _ in 0..CONFIGS {
                let threshold = self.median * (of_task + within * normal(&mut rng)).exp();
                fails_at.push((threshold, uniform(&mut rng) < self.quarantined));
            }
        }
        let planted = |task: TaskRef, config: u16| {
            let task = TaskRef::all().position(|other| other == task).expect("one of all");
            fails_at[task * usize::from(CONFIGS) + usize::from(config)]
        };
        let outcome = |id: RolloutId| match id.config() {
            None => Outcome::Success,
            Some(config) => match planted(id.task(), config) {
                (_, true) if id.level().radius() == LARGEST => Outcome::Quarantined,
                (threshold, _) => Outcome::from(id.level().radius() < threshold),
            },
        };
        let perturbed = |task, condition, level, config| {
            RolloutId::perturbed(task, condition, level, config).expect("perturbed")
        };
        // The single-axis rollouts determine the campaign's axes.
        let single_axes = [Axis::Camera, Axis::Language].map(Condition::Single);
        let conditions = single_axes.into_iter().chain([self.condition]);
        let source = TaskRef::all().flat_map(|task| {
            let conditions = conditions.clone();
            (0..CONFIGS).flat_map(move |config| {
                let ids = conditions.clone();
                let ids = ids.map(move |condition| perturbed(task, condition, Level::L2, config));
                ids.chain([RolloutId::nominal(task, config)])
            })
        });
        let mut source: Vec<Record> = source.map(|id| record(id, outcome(id))).collect();
        source.sort_by_key(|record| record.id);
        source.dedup_by_key(|record| record.id);
        let thresholds =
            Thresholds { conditions: vec![self.condition], ..thresholds(0.5, LARGEST) };
        let further = measure(&source, &thresholds, outcome);
        let measurement = Measurement::of(&source, &further, &thresholds);
        measurement.curves(&BOOTSTRAP).remove(0)
    }

    /// Returns the number of campaigns whose interval contains the median.
    fn covered(self) -> u64 {
        let contains = |seed: &u64| {
            let half = self.curve(*seed).half_success;
            let [low, high] = half.ci95.expect("forty tasks that differ");
            low <= self.median && self.median <= high
        };
        (0..CAMPAIGNS).filter(contains).count() as u64
    }
}

const LARGEST: f64 = 16.0;

const CAMERA: Population = Population {
    condition: Condition::Single(Axis::Camera),
    median: 5.3,
    spread: [0.4, 0.5],
    quarantined: 0.0,
};

/// Largest number of intervals that may miss the median: at least 93 % must contain it.
const MOST_MISSED: u64 = 4;

#[test]
fn an_interval_covers_the_median_of_the_population() {
    let covered = CAMERA.covered();
    assert!(covered + MOST_MISSED >= CAMPAIGNS, "{covered} of {CAMPAIGNS}");
}

#[test]
fn thresholds_without_a_known_failure_are_censored_and_cause_no_bias() {
    let population = Population { median: 9.0, quarantined: 0.3, ..CAMERA };
    let covered = population.covered();
    assert!(covered + MOST_MISSED >= CAMPAIGNS, "{covered} of {CAMPAIGNS}");
    let curve = population.curve(0);
    assert_eq!((curve.n, curve.left_out), (400, 0));
    assert!(curve.censored > 10, "{}", curve.censored);
    let last = curve.points.last().expect("points");
    let [low, high] = last.band;
    assert!(low < last.survival && last.survival < high, "{last:?}");
}

#[test]
fn without_radii_between_levels_the_interval_is_as_wide_as_the_bracket() {
    // Medians near L1, halfway between L1 and L2, and near L2.
    for median in [2.1, 3.0, 3.9] {
        let population = Population {
            condition: Condition::Single(Axis::Language),
            median,
            spread: [0.0; 2],
            quarantined: 0.0,
        };
        let half = population.curve(0).half_success;
        assert_eq!((half.radius, half.bounds), (None, Some([2.0, 4.0])));
        assert_eq!(half.ci95, Some([2.0, 4.0]));
    }
    let spread = Population {
        condition: Condition::Single(Axis::Language),
        median: 3.9,
        spread: [0.3, 0.4],
        quarantined: 0.0,
    };
    let covered = spread.covered();
    assert!(covered + MOST_MISSED >= CAMPAIGNS, "{covered} of {CAMPAIGNS}");
}
