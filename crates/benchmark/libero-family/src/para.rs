//! LIBERO-Para: 4,092 sentences for the ten tasks of `libero_goal`, and its score PRIDE, which
//! weights each success by the distance of the sentence from the original.

/// Outcome of a rollout with a paraphrase.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Paraphrased {
    /// True if the rollout succeeded.
    pub success: bool,
    /// Similarity of content words, 0 to 1: `keyword_similarity` of the released table.
    pub keywords: f64,
    /// Similarity of structure, 0 to 1: `structural_similarity` of the released table.
    pub structure: f64,
}

/// Returns PRIDE in percent; `alpha` is the weight of the content words, 0.5 in the released
/// code. `None` if the distances of all sentences are 0.
pub fn pride(outcomes: &[Paraphrased], alpha: f64) -> Option<f64> {
    let distance = |outcome: &Paraphrased| {
        1.0 - (alpha * outcome.keywords + (1.0 - alpha) * outcome.structure)
    };
    let total: f64 = outcomes.iter().map(distance).sum();
    let successes = outcomes.iter().filter(|outcome| outcome.success);
    let reached: f64 = successes.map(distance).sum();
    (total > 0.0).then(|| 100.0 * reached / total)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected values computed by hand: distances 0.25 and 0.75 at α = 0.5.
    #[test]
    fn a_success_is_weighted_by_the_distance_of_its_sentence() {
        let near = Paraphrased {
            success: true,
            keywords: 1.0,
            structure: 0.5,
        };
        let far = Paraphrased {
            success: false,
            keywords: 0.5,
            structure: 0.0,
        };
        assert_eq!(pride(&[near, far], 0.5), Some(25.0));
        let far_success = Paraphrased {
            success: true,
            ..far
        };
        assert_eq!(pride(&[near, far_success], 0.5), Some(100.0));
        // Content words alone: distances 0 and 0.5.
        assert_eq!(pride(&[near, far], 1.0), Some(0.0));
        assert_eq!(pride(&[], 0.5), None);
    }
}
