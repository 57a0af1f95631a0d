//! Explanation of a stop rule: the conclusion that an early end supports, and the configurations to
//! which it does not extend.

use benchmark::{Clause, Measure, StopRule};
use terminal::counted;

/// Returns one line per clause and a closing line on the scope of the rule. `configurations` is the
/// campaign's number of configurations at each level.
pub(super) fn explain_rule(rule: &StopRule, configurations: usize) -> Vec<String> {
    let configurations_text = counted(configurations as u64, "configuration");
    let mut lines: Vec<String> = rule
        .clauses()
        .iter()
        .map(|clause| {
            format!("an early end shows that {}", describe_clause(*clause, &configurations_text))
        })
        .collect();
    if rule.clauses().iter().any(is_certain_at_the_end) {
        lines.push(
            "a complete run shows with certainty whether emergent failures and compensated \
             successes are equally many; an early end proves no more, but saves rollouts"
                .to_owned(),
        );
    }
    lines.push(format!(
        "the confidence is 95 % at each level, over all looks (evaluations of the rule) together, \
         and for these {configurations_text} only: other tasks, initial states and directions may \
         differ. A difference that ends a campaign is likely to be larger at the last look than \
         over the whole campaign"
    ));
    lines
}

fn describe_clause(clause: Clause, configurations: &str) -> String {
    match clause {
        Clause::Width(measure, width) => format!(
            "{} over all {configurations} lies in an interval narrower than {}",
            describe_measure(measure),
            points(width)
        ),
        Clause::Excludes(Measure::I, 0.0) => format!(
            "emergent failures and compensated successes are not equally many among all \
             {configurations}"
        ),
        Clause::Excludes(measure, value) => format!(
            "{} over all {configurations} is not {}",
            describe_measure(measure),
            points(value)
        ),
    }
}

/// Returns true if a complete run decides the clause for certain: `I excludes 0` compares two
/// counts for equality.
fn is_certain_at_the_end(clause: &Clause) -> bool {
    matches!(clause, Clause::Excludes(Measure::I, 0.0))
}

fn describe_measure(measure: Measure) -> &'static str {
    match measure {
        Measure::SSim => "the success rate under simultaneous perturbation",
        Measure::RE => "the share of emergent failures",
        Measure::RC => "the share of compensated successes",
        Measure::RD => "the share of changed outcomes",
        Measure::I => "the net effect I of simultaneity",
    }
}

fn points(fraction: f64) -> String {
    let rounded = (fraction * 1e4).round() / 100.0;
    format!("{rounded} points")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_rule_is_explained_with_its_conclusion_and_scope() {
        let rule = "width(S_sim) < 0.1 and I excludes 0 and R_d excludes 0.05";
        let lines = explain_rule(&rule.parse().expect("a rule"), 400);
        assert_eq!(lines.len(), 5);
        let width = "success rate under simultaneous perturbation over all 400 configurations \
                     lies in an interval narrower than 10 points";
        assert!(lines[0].contains(width), "{}", lines[0]);
        assert!(lines[1].contains("are not equally many among all 400 configurations"));
        assert!(
            lines[2]
                .ends_with("share of changed outcomes over all 400 configurations is not 5 points")
        );
        assert!(lines[3].starts_with("a complete run shows with certainty"));
        assert!(lines[4].contains("these 400 configurations only"));
        let lines = explain_rule(&"width(I) < 0.08".parse().expect("a rule"), 1);
        assert!(lines.len() == 2 && lines[0].contains("over all 1 configuration "));
    }
}
