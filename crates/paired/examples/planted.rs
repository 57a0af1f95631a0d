//! Cost and findings of each strategy on planted rules:
//! `cargo run --release -p adaptive --example planted`.
//!
//! A row is the mean over the rules of one kind. Its columns: the number of *further* subsets that
//! the search ran, which are those that an ordinary campaign does not run, and the share of all 56
//! of them; the numbers of rollouts and batches; the share of rules explained, and the share of the
//! explained rules whose minimal subsets are exactly the planted ones. The row `mean of
//! Kind::MIXTURE` has only the first two columns, averaged over the kinds in this constant. The
//! last rows are for noisy policies: each rollout contradicts the rule with the probability in the
//! row's name. If a rollout of the source campaign contradicts the rule, the transition may not
//! show and is then not searched.

#[path = "../tests/adaptive/subsets/planted.rs"]
mod planted;

use paired::adaptive::subsets::{Evidence, Repeats, Strategy};
use planted::{Kind, Rule, SearchResult, search_noisy, search_rule, seeded};

const RULES: usize = 2000;
const NOISY_RULES: usize = 400;
/// Number of subsets that an ordinary campaign does not run.
const FURTHER_SUBSETS: f64 = 56.0;

/// Means over the rules of one kind.
#[derive(Default)]
struct Mean {
    subsets: f64,
    rollouts: f64,
    batches: f64,
    explained: f64,
    /// Share of the explained rules that were explained exactly.
    exact: f64,
}

impl Mean {
    fn new(results: &[(SearchResult, bool)]) -> Self {
        let n = results.len() as f64;
        let explained = results.iter().filter(|(result, _)| result.explanation.is_some());
        let explained = explained.count() as f64;
        let mean = |value: &dyn Fn(&SearchResult) -> f64| {
            results.iter().map(|(result, _)| value(result)).sum::<f64>() / n
        };
        Self {
            subsets: mean(&|result| result.subsets as f64),
            rollouts: mean(&|result| f64::from(result.rollouts)),
            batches: mean(&|result| result.batches as f64),
            explained: explained / n,
            exact: results.iter().filter(|(_, exact)| *exact).count() as f64 / explained,
        }
    }

    fn print(&self, name: &str) {
        let share = 100.0 * self.subsets / FURTHER_SUBSETS;
        let (explained, exact) = (100.0 * self.explained, 100.0 * self.exact);
        println!(
            "{name:<22}{:>8.1}{share:>7.1} %{:>10.1}{:>9.1}{explained:>9.1} %{exact:>7.1} %",
            self.subsets, self.rollouts, self.batches
        );
    }
}

fn main() {
    for strategy in Strategy::ALL {
        println!(
            "\n{:<22}{:>8}{:>9}{:>10}{:>9}{:>11}{:>9}",
            format!("{strategy:?}"),
            "subsets",
            "of 56",
            "rollouts",
            "batches",
            "explained",
            "exact"
        );
        let mut mixture = Vec::new();
        for kind in Kind::MONOTONE.into_iter().chain(Kind::NON_MONOTONE) {
            let mut rng = seeded(1);
            let search = |_| {
                let rule = Rule::draw(kind, &mut rng);
                let result = search_rule(&rule, strategy);
                let exact = result.is_exact(&rule);
                (result, exact)
            };
            let mean = Mean::new(&(0..RULES).map(search).collect::<Vec<_>>());
            mean.print(&format!("{kind:?}"));
            if Kind::MIXTURE.contains(&kind) {
                mixture.push(mean.subsets);
            }
        }
        let mean = mixture.iter().sum::<f64>() / mixture.len() as f64;
        let share = 100.0 * mean / FURTHER_SUBSETS;
        println!("{:<22}{mean:>8.1}{share:>7.1} %", "mean of Kind::MIXTURE");
        for noise in [0.0, 0.02, 0.05, 0.1] {
            let mut rng = seeded(2);
            let search = |i: usize| {
                let rule = Rule::draw(Kind::MONOTONE[i % Kind::MONOTONE.len()], &mut rng);
                let evidence = Evidence::Repeated(Repeats::default());
                let result = search_noisy(&rule, strategy, evidence, noise, &mut rng);
                let exact = result.is_exact(&rule);
                (result, exact)
            };
            let mean = Mean::new(&(0..NOISY_RULES).map(search).collect::<Vec<_>>());
            mean.print(&format!("monotone, noise {:.0} %", 100.0 * noise));
        }
    }
}
