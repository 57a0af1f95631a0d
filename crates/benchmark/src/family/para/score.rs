//! LIBERO-Para's score PRIDE, which weights each success by the distance of the sentence from the
//! task's canonical instruction.

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Paraphrased {
    pub success: bool,
    /// Similarity of content words, about 0 to 1: `keyword_similarity` of the metadata.
    pub keywords: f64,
    /// Similarity of structure, 0 to 1: `structural_similarity` of the metadata.
    pub structure: f64,
}

/// Sums of the distances of sentences from the canonical instructions.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Distances {
    pub reached: f64,
    pub total: f64,
}

impl Distances {
    /// `alpha` is the weight of the content words, 0.5 in the released code.
    pub fn add(&mut self, outcome: &Paraphrased, alpha: f64) {
        let similarity = alpha * outcome.keywords + (1.0 - alpha) * outcome.structure;
        let distance = 1.0 - similarity;
        self.total += distance;
        if outcome.success {
            self.reached += distance;
        }
    }

    /// Returns PRIDE in per cent; `None` if the sum of the distances of all sentences is 0.
    pub fn pride(&self) -> Option<f64> {
        (self.total > 0.0).then(|| 100.0 * self.reached / self.total)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pride(outcomes: &[Paraphrased], alpha: f64) -> Option<f64> {
        let mut distances = Distances::default();
        for outcome in outcomes {
            distances.add(outcome, alpha);
        }
        distances.pride()
    }

    /// Expected values computed by hand: distances 0.25 and 0.75 at α = 0.5.
    #[test]
    fn a_success_is_weighted_by_the_distance_of_its_sentence() {
        let near = Paraphrased { success: true, keywords: 1.0, structure: 0.5 };
        let far = Paraphrased { success: false, keywords: 0.5, structure: 0.0 };
        assert_eq!(pride(&[near, far], 0.5), Some(25.0));
        let far_success = Paraphrased { success: true, ..far };
        assert_eq!(pride(&[near, far_success], 0.5), Some(100.0));
        assert_eq!(pride(&[near, far], 1.0), Some(0.0));
        assert_eq!(pride(&[], 0.5), None);
    }
}
