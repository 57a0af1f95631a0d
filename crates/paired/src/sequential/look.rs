//! What one sees at a look.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use protocol::UnknownName;
use serde::{Deserialize, Serialize};

/// What an interval is about.
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
    /// Success rate of policy A − success rate of policy B.
    Difference,
}

impl Measure {
    /// All.
    pub const ALL: [Self; 6] = [
        Self::SSim,
        Self::RE,
        Self::RC,
        Self::RD,
        Self::I,
        Self::Difference,
    ];

    /// Those of one policy.
    pub const OF_ONE_POLICY: [Self; 5] = [Self::SSim, Self::RE, Self::RC, Self::RD, Self::I];

    /// Name in stop rules: `S_sim`, `R_e`, `R_c`, `R_d`, `I`, `difference`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SSim => "S_sim",
            Self::RE => "R_e",
            Self::RC => "R_c",
            Self::RD => "R_d",
            Self::I => "I",
            Self::Difference => "difference",
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
        let found = Self::ALL.into_iter().find(|it| it.name() == text);
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

/// An interval of a rate or a difference of rates over a finite population. Its
/// ends are whole numbers of units, so that none is rounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RateInterval {
    /// Least total over the population that is not ruled out.
    pub least: i64,
    /// Greatest total over the population that is not ruled out.
    pub greatest: i64,
    /// Units of the population.
    pub units: u64,
}

impl RateInterval {
    /// Lower end, a fraction.
    pub fn low(&self) -> f64 {
        self.least as f64 / self.units as f64
    }

    /// Upper end, a fraction.
    pub fn high(&self) -> f64 {
        self.greatest as f64 / self.units as f64
    }

    /// Upper end − lower end, a fraction; 0 once the value is known.
    pub fn width(&self) -> f64 {
        (self.greatest - self.least) as f64 / self.units as f64
    }

    /// Whether a value is outside; the ends are inside.
    pub fn excludes(&self, value: f64) -> bool {
        value < self.low() || self.high() < value
    }
}

/// What is known after some units. All intervals hold together, at all looks,
/// with a probability of 1 − α.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Look {
    /// Units that the intervals rest on: the drawn order up to its first
    /// incomplete unit.
    pub used: usize,
    /// Units that are complete and not used, because an earlier one is not.
    pub waiting: usize,
    /// Units of the population.
    pub units: usize,
    /// Interval of each measure.
    pub intervals: BTreeMap<Measure, RateInterval>,
}
