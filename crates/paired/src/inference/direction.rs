//! Test of whether success depends on the direction. Configurations with the same number have the
//! same direction in all tasks, unless the campaign gives every task directions of its own: 40
//! tasks of ten configurations sample only ten directions, not four hundred.

use std::collections::BTreeMap;

use benchmark::{Directions, TaskRef};
use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

use crate::bootstrap::Bootstrap;
use crate::outcomes::{Count, Matched};

/// Number of random permutations; the smallest p-value is 1 / (`PERMUTATIONS` + 1).
const PERMUTATIONS: u32 = 1999;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DirectionTest {
    /// Simultaneous success under each direction, over all tasks. The key is the number that the
    /// direction's configurations have in every task.
    pub rates: BTreeMap<u16, f64>,
    /// p-value of the hypothesis that success is the same under all directions: the share of
    /// permutations of outcomes within tasks, the observed assignment among them, under which the
    /// directions' rates spread at least as far as the observed rates.
    pub p: f64,
}

impl DirectionTest {
    /// Runs the permutation form of Cochran's Q: the statistic is Σ_c n_c (s̄_c − s̄)² over the
    /// directions c, with n_c outcomes and the success rate s̄_c. Configurations, with the outcomes of
    /// all their replicates, are permuted within each task, which preserves each task's
    /// difficulty. The seed is fixed. `None` with fewer than two
    /// directions or tasks, or if directions are not shared.
    ///
    /// Source: W. G. Cochran, The comparison of percentages in matched samples, Biometrika
    /// 37 (1950), 256–266.
    pub(crate) fn of(matched: &[Matched], directions: Directions) -> Option<Self> {
        if directions == Directions::Own {
            return None;
        }
        let mut tasks: BTreeMap<TaskRef, BTreeMap<u16, Count>> = BTreeMap::new();
        for matched in matched.iter().filter(|matched| matched.simultaneous.success().is_some()) {
            let configurations = tasks.entry(matched.task).or_default();
            configurations.entry(matched.config).or_default().add(matched.simultaneous);
        }
        let mut numbers: Vec<u16> = tasks.values().flatten().map(|(c, _)| *c).collect();
        numbers.sort_unstable();
        numbers.dedup();
        if numbers.len() < 2 || tasks.len() < 2 {
            return None;
        }
        let index_of = |number: u16| numbers.binary_search(&number).expect("one of the numbers");
        let counts = || tasks.values().flatten().map(|(_, count)| count);
        let successes: u64 = counts().map(|count| count.successes).sum();
        let trials: u64 = counts().map(|count| count.n).sum();
        // The outcome, true or false, that occurs less often. Only the rarer outcome is permuted,
        // because Σ (n − s)² / n and Σ s² / n differ by a constant.
        let rarer = 2 * successes <= trials;
        let mut sizes = vec![0.0; numbers.len()];
        let mut rare = vec![0.0; numbers.len()];
        // Per task, the indices of its directions, and the rarer outcomes of each configuration
        // that has any.
        let mut indices: Vec<(Vec<usize>, Vec<f64>)> = Vec::new();
        for configurations in tasks.values() {
            let (mut task_indices, mut task_rare) = (Vec::new(), Vec::new());
            for (number, Count { successes, n }) in configurations {
                let count = if rarer { *successes } else { n - successes } as f64;
                task_indices.push(index_of(*number));
                task_rare.extend((count > 0.0).then_some(count));
                sizes[index_of(*number)] += *n as f64;
                rare[index_of(*number)] += count;
            }
            indices.push((task_indices, task_rare));
        }
        let spread = |rare: &[f64]| -> f64 {
            let squares = rare.iter().zip(&sizes);
            squares.map(|(sum, n)| sum * sum / n).sum()
        };
        // A permutation with an equal spread counts despite rounding errors.
        let observed = spread(&rare) - 1e-9;
        let rates = rare.iter().zip(&sizes).map(|(sum, n)| match rarer {
            true => sum / n,
            false => 1.0 - sum / n,
        });
        let rates = numbers.iter().copied().zip(rates).collect();
        let mut rng = ChaCha12Rng::seed_from_u64(Bootstrap::default().seed);
        let mut at_least_as_far = 0_u32;
        for _ in 0..PERMUTATIONS {
            rare.fill(0.0);
            for (indices, counts) in &mut indices {
                for (drawn, count) in counts.iter().enumerate() {
                    let remaining = indices.len() - drawn;
                    indices.swap(drawn, drawn + random_below(remaining, &mut rng));
                    rare[indices[drawn]] += count;
                }
            }
            at_least_as_far += u32::from(spread(&rare) >= observed);
        }
        let p = f64::from(at_least_as_far + 1) / f64::from(PERMUTATIONS + 1);
        Some(Self { rates, p })
    }

    pub fn range(&self) -> [f64; 2] {
        let rates = self.rates.values().copied();
        [rates.clone().fold(f64::INFINITY, f64::min), rates.fold(f64::NEG_INFINITY, f64::max)]
    }
}

/// Draws an integer uniformly from 0..`end`.
fn random_below(end: usize, rng: &mut ChaCha12Rng) -> usize {
    ((u64::from(rng.next_u32()) * end as u64) >> 32) as usize
}
