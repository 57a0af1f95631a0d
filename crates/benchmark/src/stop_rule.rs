//! Stop rules of campaigns, such as `width(I) < 0.08 and S_sim excludes 0.5`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::names::UnknownName;

const AND: &str = " and ";

const VALID: &str = "width(M) < X with X above 0 and up to 2 (0.08 is 8 percentage points), M \
                     excludes X with X from -1 to 1, or several of them with ` and ` between";

/// Quantity that an interval estimates. N is the number of configurations that the interval rests
/// on: complete configurations, in the drawn order up to the first incomplete one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "&'static str", try_from = "String")]
pub enum Measure {
    /// Success rate under simultaneous perturbation.
    SSim,
    /// Emergent failures / N.
    RE,
    /// Compensated successes / N.
    RC,
    /// Changed outcomes / N: `R_e` + `R_c`.
    RD,
    /// Net effect of simultaneity: `R_c` − `R_e`.
    I,
}

impl Measure {
    pub const ALL: [Self; 5] = [Self::SSim, Self::RE, Self::RC, Self::RD, Self::I];

    /// Returns the name in stop rules: `S_sim`, `R_e`, `R_c`, `R_d`, `I`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SSim => "S_sim",
            Self::RE => "R_e",
            Self::RC => "R_c",
            Self::RD => "R_d",
            Self::I => "I",
        }
    }
}

impl fmt::Display for Measure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Measure {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let found = Self::ALL.into_iter().find(|measure| measure.name() == text);
        found.ok_or_else(|| UnknownName {
            kind: "measure",
            given: text.to_owned(),
            valid: Self::ALL.map(Self::name).join(", "),
        })
    }
}

impl From<Measure> for &'static str {
    fn from(measure: Measure) -> Self {
        measure.name()
    }
}

impl TryFrom<String> for Measure {
    type Error = UnknownName;

    fn try_from(text: String) -> Result<Self, UnknownName> {
        text.parse()
    }
}

/// A stop rule: a campaign ends early when all clauses hold at the same evaluation.
///
/// The intervals are confidence sequences, which are valid at all evaluations at once, and
/// therefore under any stop rule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct StopRule {
    clauses: Vec<Clause>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clause {
    /// `width(M) < X`: the interval of M is narrower than X, a fraction.
    Width(Measure, f64),
    /// `M excludes X`: X is outside the interval of M over the campaign's configurations.
    Excludes(Measure, f64),
}

impl StopRule {
    pub fn clauses(&self) -> &[Clause] {
        &self.clauses
    }
}

impl Clause {
    pub const fn measure(&self) -> Measure {
        match *self {
            Self::Width(measure, _) | Self::Excludes(measure, _) => measure,
        }
    }
}

impl fmt::Display for Clause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Width(measure, width) => write!(f, "width({measure}) < {width}"),
            Self::Excludes(measure, value) => write!(f, "{measure} excludes {value}"),
        }
    }
}

impl FromStr for Clause {
    type Err = UnknownName;

    /// Parses a clause; spaces are optional where the clause is unambiguous without them.
    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let unknown = || unknown(text);
        if let Some(width) = text.trim().strip_prefix("width(") {
            let (measure, limit) = width.split_once(')').ok_or_else(unknown)?;
            let limit = limit.trim().strip_prefix('<').and_then(number);
            let limit = limit.filter(|&limit| limit > 0.0 && limit <= 2.0);
            return Ok(Self::Width(measure.trim().parse()?, limit.ok_or_else(unknown)?));
        }
        let (measure, value) = text.split_once(" excludes ").ok_or_else(unknown)?;
        let measure: Measure = measure.trim().parse()?;
        let value = number(value).filter(|value| (-1.0..=1.0).contains(value));
        Ok(Self::Excludes(measure, value.ok_or_else(unknown)?))
    }
}

impl fmt::Display for StopRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let clauses: Vec<String> = self.clauses.iter().map(Clause::to_string).collect();
        f.pad(&clauses.join(AND))
    }
}

impl FromStr for StopRule {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let clauses: Result<_, _> = text.split(AND).map(str::parse).collect();
        clauses.map(|clauses| Self { clauses })
    }
}

impl From<StopRule> for String {
    fn from(rule: StopRule) -> Self {
        rule.to_string()
    }
}

impl TryFrom<String> for StopRule {
    type Error = UnknownName;

    fn try_from(text: String) -> Result<Self, UnknownName> {
        text.parse()
    }
}

/// Parses a finite number and normalises −0 to 0.
fn number(text: &str) -> Option<f64> {
    let number: f64 = text.trim().parse().ok()?;
    number.is_finite().then_some(number + 0.0)
}

fn unknown(given: &str) -> UnknownName {
    UnknownName {
        kind: "stop rule",
        given: given.to_owned(),
        valid: format!("{VALID}; M is one of {}", Measure::ALL.map(Measure::name).join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn rule(text: &str) -> StopRule {
        text.parse().expect(text)
    }

    fn refusal_of(text: &str) -> String {
        text.parse::<StopRule>().expect_err(text).to_string()
    }

    fn clause() -> impl Strategy<Value = Clause> {
        let measure = prop::sample::select(Measure::ALL.to_vec());
        (measure, 1e-6..=1.0_f64, 0..2).prop_map(|(measure, value, kind)| match kind {
            0 => Clause::Width(measure, 2.0 * value),
            _ => Clause::Excludes(measure, 2.0 * value - 1.0),
        })
    }

    proptest! {
        #[test]
        fn a_rule_is_parsed_from_its_text_and_from_json(
            clauses in proptest::collection::vec(clause(), 1..4),
        ) {
            let rule = StopRule { clauses };
            prop_assert_eq!(rule.to_string().parse(), Ok(rule.clone()));
            let json = serde_json::to_string(&rule).expect("JSON");
            prop_assert_eq!(serde_json::from_str::<StopRule>(&json).expect("a rule"), rule);
        }

        #[test]
        fn parsing_never_panics(text: String) {
            let _ = text.parse::<StopRule>();
        }
    }

    #[test]
    fn equivalent_rules_are_written_the_same() {
        for text in [
            "width(I) < 0.08 and S_sim excludes 0.5",
            "width( I )<0.080 and  S_sim  excludes  5e-1",
            " width(I)  < 8e-2 and S_sim excludes +0.5 ",
        ] {
            assert_eq!(rule(text).to_string(), "width(I) < 0.08 and S_sim excludes 0.5");
        }
        assert_eq!(rule("I excludes -0").to_string(), "I excludes 0");
    }

    #[test]
    fn an_invalid_rule_is_refused_with_the_valid_forms() {
        for text in [
            "",
            "I",
            "width(I)",
            "width I < 0.1",
            "width(I) <= 0.1",
            "width(I) < 0",
            "width(I) < -0.1",
            "width(I) < 3",
            "width(I) < nan",
            "width(I) < 0.1 and",
            "width(I) < 0.1 or I excludes 0",
            "I excludes",
            "I excludes inf",
            "I excludes 1.5",
            "I excludes 0 for new tasks",
        ] {
            assert!(refusal_of(text).contains("valid are width(M) < X"), "{text}");
        }
        assert!(refusal_of("width(I) < 0.1 and and I excludes 0").contains("`and I`"));
        assert_eq!(
            refusal_of("width(S_conj) < 0.1"),
            "read measure `S_conj`: valid are S_sim, R_e, R_c, R_d, I"
        );
    }
}
