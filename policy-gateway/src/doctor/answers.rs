//! A server's answers to all situations, as numbers. Pure functions.

use benchmark::Action;

/// A server's actions for each situation, averaged over the seeds with which it was queried.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Answers {
    /// Chunks by situation; each is a list of actions.
    pub chunks: Vec<Vec<Action>>,
    /// Standard deviation between answers to the same situation with different seeds, by component
    /// of an action; 0 for a single seed.
    pub spread: Action,
}

impl Answers {
    /// Averages several answers to each situation, given as `answers[situation][seed]`. Chunks are
    /// cut to the shortest length within a situation.
    pub(crate) fn averaged(answers: Vec<Vec<Vec<Action>>>) -> Self {
        let mut chunks = vec![];
        let mut squares = [0.0; 7];
        let mut degrees_of_freedom = 0_usize;
        for seeds in answers {
            let rows = seeds.iter().map(Vec::len).min().unwrap_or(0);
            let count = seeds.len() as f64;
            let mean = |row: usize, component: usize| {
                seeds.iter().map(|chunk| chunk[row][component]).sum::<f64>() / count
            };
            let means: Vec<Action> = (0..rows)
                .map(|row| std::array::from_fn(|component| mean(row, component)))
                .collect();
            for chunk in &seeds {
                for (row, mean) in chunk.iter().zip(&means) {
                    for component in 0..7 {
                        squares[component] += (row[component] - mean[component]).powi(2);
                    }
                }
            }
            degrees_of_freedom += rows * seeds.len().saturating_sub(1);
            chunks.push(means);
        }
        Self {
            chunks,
            spread: squares.map(|square| (square / degrees_of_freedom.max(1) as f64).sqrt()),
        }
    }

    /// Returns the largest absolute difference to `other`, with the index of its component in an
    /// action.
    pub(crate) fn largest_difference(&self, other: &Self) -> (f64, usize) {
        let pairs = self.chunks.iter().zip(&other.chunks);
        let rows = pairs.flat_map(|(chunk, other_chunk)| chunk.iter().zip(other_chunk));
        let differences = rows.flat_map(|(a, b)| {
            (0..7).map(move |component| ((a[component] - b[component]).abs(), component))
        });
        differences.fold((0.0, 0), |largest, next| if next.0 > largest.0 { next } else { largest })
    }

    pub(crate) fn component_count(&self) -> usize {
        self.chunks.iter().map(|chunk| 7 * chunk.len()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_of_several_seeds_have_means_and_a_spread() {
        let given = vec![
            vec![vec![[1.0; 7], [5.0; 7]], vec![[3.0; 7]]],
            vec![vec![[0.0; 7]], vec![[2.0; 7]]],
        ];
        let answers = Answers::averaged(given);
        assert_eq!(answers.chunks, [[[2.0; 7]], [[1.0; 7]]]);
        assert_eq!(answers.spread, [2.0_f64.sqrt(); 7]);
        assert_eq!(answers.component_count(), 14);
    }

    #[test]
    fn the_largest_difference_is_returned_with_its_component() {
        let answers = Answers::averaged(vec![vec![vec![[0.0; 7]]]]);
        let mut changed = answers.clone();
        changed.chunks[0][0][4] = -0.5;
        assert_eq!(answers.largest_difference(&changed), (0.5, 4));
    }
}
