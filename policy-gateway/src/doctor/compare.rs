//! `policy-gateway compare A B`: compares two servers' actions for the same observations, and
//! explains a difference. Policies with random noise are compared by means over several seeds,
//! unless equal seeds give both servers equal noise.

use policy_backends::description::{self, DescriptionDifference};
use serde::Serialize;

use crate::doctor::answers::Answers;
use crate::doctor::difference::{self, COMPONENT_NAMES, Difference, Kind, LargestDifference, size};
use crate::doctor::fit::{Limit, fit};
use crate::doctor::probe::{ExaminationError, Probe};
use crate::doctor::randomness::{REPEATABLE, Randomness, SEEDS_PER_MEAN};
use crate::doctor::search::{Explanation, SearchResult, SearchSetup};
use crate::doctor::server_pair::{SEED, ServerPair, Side};

/// Number of standard errors within which two means count as equal.
const STANDARD_ERRORS: f64 = 2.5;
/// Share of the answers' standard deviation below which differences count as rounding.
const ROUNDING: f64 = 0.02;

#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    pub descriptions: Vec<DescriptionDifference>,
    /// Differences between the answers; empty if the answers count as the same.
    pub differences: Vec<Difference>,
    /// Method of the comparison, and the sizes of the differences.
    pub note: String,
}

struct AnswerPair {
    a: Answers,
    b: Answers,
}

impl AnswerPair {
    async fn query(
        servers: &ServerPair,
        seeds: &(dyn Fn(usize) -> Vec<u64> + Sync),
    ) -> Result<Self, ExaminationError> {
        let all = servers.situation_count();
        Ok(Self {
            a: servers.query(Side::A, &[], all, seeds).await?,
            b: servers.query(Side::B, &[], all, seeds).await?,
        })
    }

    fn largest_difference(&self) -> LargestDifference {
        let (value, component) = self.a.largest_difference(&self.b);
        LargestDifference { value, component }
    }

    fn differ_by_rounding(&self) -> bool {
        let remaining = fit(&self.a, &self.b, &[f64::INFINITY; 7]).remaining;
        let deviations = standard_deviations(&self.b);
        (0..7).all(|component| {
            remaining[component] <= (ROUNDING * deviations[component]).max(REPEATABLE)
        })
    }
}

pub async fn compare(a: Probe, b: Probe) -> Result<Comparison, ExaminationError> {
    let mut descriptions = description::differences(&a.described, &b.described);
    // They may well differ between two implementations.
    let names = ["name", "checkpoint", "checkpoint digest", "parameter count"];
    descriptions.retain(|difference| !names.contains(&&*difference.what));
    let servers = ServerPair::new(a, b);
    let pair = AnswerPair::query(&servers, &|_| vec![SEED]).await?;
    let randomness = [
        Randomness::measure(&servers, Side::A, &pair.a).await?,
        Randomness::measure(&servers, Side::B, &pair.b).await?,
    ];
    let mut differences = seed_differences(&servers, randomness);
    let (answer_differences, note) = match randomness.iter().all(Randomness::is_repeatable) {
        true => compare_paired(&servers, &pair, randomness).await?,
        false => compare_means(&servers, randomness).await?,
    };
    for difference in answer_differences {
        match differences.iter_mut().find(|earlier| earlier.kind == difference.kind) {
            Some(earlier) => earlier.text = format!("{} {}", earlier.text, difference.text),
            None => differences.push(difference),
        }
    }
    Ok(Comparison { descriptions, differences, note })
}

fn seed_differences(servers: &ServerPair, randomness: [Randomness; 2]) -> Vec<Difference> {
    let sides = [(Side::A, "A"), (Side::B, "B")].into_iter().zip(randomness);
    for ((side, letter), randomness) in sides {
        if !randomness.is_repeatable() && !servers.described(side).unseeded {
            let text = format!(
                "{letter} answers the same observation and seed differently every time, by up to \
                 {}, and does not declare this: its noise does not come from the seed.",
                size(randomness.repeat_difference)
            );
            return vec![Difference::new(Kind::Seed, text)];
        }
    }
    let [a, b] = randomness;
    let ignored = match (a.follows_seed(), b.follows_seed()) {
        (true, false) if b.is_repeatable() => ("A", "B", a.seed_difference),
        (false, true) if a.is_repeatable() => ("B", "A", b.seed_difference),
        _ => return vec![],
    };
    let (follows, ignores, by) = ignored;
    let text = format!(
        "{follows}'s answers follow the seed (seeds {SEED} and {} differ by up to {}), \
         {ignores}'s are the same for every seed.",
        SEED + 1,
        size(by),
    );
    vec![Difference::new(Kind::Seed, text)]
}

async fn compare_paired(
    servers: &ServerPair,
    pair: &AnswerPair,
    randomness: [Randomness; 2],
) -> Result<(Vec<Difference>, String), ExaminationError> {
    let is_random = randomness.iter().any(|randomness| randomness.seed_difference > REPEATABLE);
    let largest = pair.largest_difference();
    let seeds = |_: usize| vec![SEED];
    let setup = SearchSetup {
        servers,
        seeds: &seeds,
        floor: [REPEATABLE; 7],
        // If the servers' noise differs, no change to the observations makes the answers equal, so
        // that a search for several changes would be in vain.
        allows_several: !is_random,
    };
    match setup.search(&pair.a, &pair.b).await? {
        SearchResult::Explained(explanation) => {
            let note = format!(
                "{}; the largest difference, with unchanged observations, is {}",
                comparison_note(servers, &pair.a, "with the same seed"),
                size(largest.value)
            );
            Ok((difference::explained(&explanation, largest), note))
        }
        SearchResult::Unexplained(_) if pair.differ_by_rounding() => {
            let note = format!(
                "{}; they differ by up to {}, less than {ROUNDING} of their own standard \
                 deviation, as after rounding (bfloat16), through JPEG or on another processor",
                comparison_note(servers, &pair.a, "with the same seed"),
                size(largest.value)
            );
            Ok((vec![], note))
        }
        SearchResult::Unexplained(_) if is_random => compare_means(servers, randomness).await,
        SearchResult::Unexplained(closest) => {
            let note = comparison_note(servers, &pair.a, "with the same seed");
            Ok((vec![unexplained(pair, largest, &closest)], note))
        }
    }
}

async fn compare_means(
    servers: &ServerPair,
    randomness: [Randomness; 2],
) -> Result<(Vec<Difference>, String), ExaminationError> {
    // Different seeds for every situation keep the errors of the means independent.
    let seeds = |situation: usize| -> Vec<u64> {
        let first = SEED + 100 + (situation * SEEDS_PER_MEAN) as u64;
        (first..first + SEEDS_PER_MEAN as u64).collect()
    };
    let pair = AnswerPair::query(servers, &seeds).await?;
    let setup = SearchSetup {
        servers,
        seeds: &seeds,
        floor: floor(&pair, randomness),
        allows_several: true,
    };
    let largest = pair.largest_difference();
    let noise =
        randomness.map(|randomness| randomness.seed_difference.max(randomness.repeat_difference));
    let note = format!(
        "{}; the means differ by up to {}, and single answers to the same observation by {}",
        comparison_note(servers, &pair.a, &format!("{SEEDS_PER_MEAN} answers to each averaged")),
        size(largest.value),
        size(noise[0].max(noise[1])),
    );
    let mut differences = match setup.search(&pair.a, &pair.b).await? {
        SearchResult::Explained(explanation) => difference::explained(&explanation, largest),
        SearchResult::Unexplained(_) if pair.differ_by_rounding() => vec![],
        SearchResult::Unexplained(closest) => vec![unexplained(&pair, largest, &closest)],
    };
    if differences.is_empty() && randomness.iter().all(Randomness::follows_seed) {
        let text = format!(
            "both follow the seed, but the same seed gives them different noise: by up to {}. The \
             means of {SEEDS_PER_MEAN} seeds are alike.",
            size(randomness[0].seed_difference.max(randomness[1].seed_difference)),
        );
        differences.push(Difference::new(Kind::Seed, text));
    }
    Ok((differences, note))
}

/// Returns the largest distance between means that randomness explains, by component.
fn floor(pair: &AnswerPair, randomness: [Randomness; 2]) -> Limit {
    let [a, b] = randomness
        .map(|randomness| randomness.seed_difference > REPEATABLE || !randomness.is_repeatable());
    std::array::from_fn(|component| {
        let variance_of = |answers: &Answers| answers.spread[component].powi(2);
        let (variance_a, variance_b) = (variance_of(&pair.a), variance_of(&pair.b));
        // Noise that is the same for every seed does not average out: it shifts all means alike.
        let shared_noise = match (a, b) {
            (true, false) => 2.0 * variance_a,
            (false, true) => 2.0 * variance_b,
            _ => 0.0,
        };
        let error = ((variance_a + variance_b) / SEEDS_PER_MEAN as f64 + shared_noise).sqrt();
        (STANDARD_ERRORS * error).max(REPEATABLE)
    })
}

fn unexplained(pair: &AnswerPair, largest: LargestDifference, closest: &Explanation) -> Difference {
    let remaining = closest.fit.remaining.iter().copied().fold(0.0, f64::max);
    let attempt = difference::attempt(closest);
    let mut text = format!(
        "their answers differ by up to {} ({}), and none of the differences that are tried \
         explains it.",
        size(largest.value),
        COMPONENT_NAMES[largest.component],
    );
    for (letter, answers) in [("A", &pair.a), ("B", &pair.b)] {
        if standard_deviations(answers).iter().all(|number| *number <= REPEATABLE) {
            text.push_str(&format!(
                " {letter} answers all observations alike: run `policy-gateway check` on it."
            ));
        }
    }
    if !attempt.is_empty() {
        text.push_str(&format!(
            " The difference is smallest if {attempt}: then {} remains.",
            size(remaining)
        ));
    }
    Difference::new(Kind::Unexplained, text)
}

fn standard_deviations(answers: &Answers) -> Limit {
    let rows: Vec<_> = answers.chunks.iter().flatten().collect();
    let count = rows.len().max(1) as f64;
    std::array::from_fn(|component| {
        let mean = rows.iter().map(|row| row[component]).sum::<f64>() / count;
        let squares = rows.iter().map(|row| (row[component] - mean).powi(2));
        (squares.sum::<f64>() / count).sqrt()
    })
}

fn comparison_note(servers: &ServerPair, answers: &Answers, method: &str) -> String {
    format!(
        "compared {} numbers of the answers to {} observations, {method}",
        answers.component_count(),
        servers.situation_count(),
    )
}
