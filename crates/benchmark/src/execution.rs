//! Execution model of a campaign: behaviour of the robot during the latency of its policy.
//! Latency is counted in control steps, never in wall time, so that a campaign has the same
//! outcomes regardless of the speed of its policy's server. `schedule` selects the command of
//! each step.

use std::fmt;
use std::str::FromStr;

use serde::Deserialize;

use crate::names::serde_as_text;
use crate::streams::{MatchedRng, MatchedStream};
use crate::suite::TaskRef;

/// Control steps per second of LIBERO's robot.
pub const CONTROL_HZ: u32 = 20;
/// Ten seconds, in control steps.
pub const MAX_DELAY: u16 = 200;
const MAX_DISTINCT_DELAYS: usize = 32;
const MAX_WEIGHT: u32 = 1000;
/// Part of the key of drawn delays; it must change whenever the drawn values change.
const STREAM_VERSION: &str = "libero-ctrl/v0.1/latency/1";

/// Behaviour of the robot while a response is pending.
///
/// Written as `wait`, `hold:N`, `overlap:N` or `overlap:N,rtc`, where N is a number of control
/// steps or a distribution such as `3*812+4*188`: three steps with weight 812, four with 188.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub enum Execution {
    /// The simulation pauses, which is impossible on a real robot.
    #[default]
    Wait,
    /// The arm holds still, then executes the response from its first action.
    Hold(Delays),
    /// The arm continues with the previous response. Action i of the response to step t belongs
    /// to step t + i, so that the response loses one action per step of delay.
    Overlap {
        delays: Delays,
        /// Real-time chunking: the policy receives the commands that are executed during the delay.
        rtc: bool,
    },
}

/// Delays of responses, control steps: a constant, or a distribution from which the delay of each
/// response is drawn.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Delays {
    /// Pairs of steps and weight, sorted by steps; not empty.
    weighted: Vec<(u16, u32)>,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "read execution model: {problem}; write wait, hold:N, overlap:N or overlap:N,rtc with N \
     control steps from 0 to {MAX_DELAY}, or a distribution of steps*weight such as 3*812+4*188"
)]
pub struct ExecutionError {
    problem: String,
}

#[derive(Debug, thiserror::Error)]
#[error("read measured latencies: {problem}; `policy-gateway check --latency FILE` writes them")]
pub struct LatencyFileError {
    problem: String,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "execution model `{execution}` drops at least {dropped} actions of each answer, and an answer \
     has {horizon} at most: none would ever be executed. Choose a delay below {horizon}, \
     `hold:{dropped}`, which drops none, or a policy with longer answers"
)]
pub struct TooLate {
    pub execution: Execution,
    pub dropped: u16,
    pub horizon: usize,
}

impl Execution {
    pub fn is_wait(&self) -> bool {
        *self == Self::Wait
    }

    /// Returns true if the policy must receive the commands that are executed during the delay.
    pub fn is_rtc(&self) -> bool {
        matches!(self, Self::Overlap { rtc: true, .. })
    }

    pub fn delays(&self) -> Option<&Delays> {
        match self {
            Self::Wait => None,
            Self::Hold(delays) | Self::Overlap { delays, .. } => Some(delays),
        }
    }

    /// Checks that a policy whose responses have at most `horizon` actions can act at all.
    pub fn check(&self, horizon: usize) -> Result<(), TooLate> {
        match self {
            Self::Overlap { delays, .. } if usize::from(delays.shortest()) >= horizon => {
                Err(TooLate { execution: self.clone(), dropped: delays.shortest(), horizon })
            }
            _ => Ok(()),
        }
    }
}

impl Delays {
    /// Returns a constant delay; `None` if it exceeds [`MAX_DELAY`].
    pub fn fixed(steps: u16) -> Option<Self> {
        Self::weighted([(steps, 1)]).ok()
    }

    /// Creates a distribution; the weights of equal delays are added, and a sum is limited like a
    /// weight, so that the distribution's text can be parsed. The error is a clause for the message
    /// of [`ExecutionError`] or [`LatencyFileError`].
    fn weighted(given: impl IntoIterator<Item = (u16, u32)>) -> Result<Self, String> {
        let mut weighted = std::collections::BTreeMap::<u16, u32>::new();
        for (steps, weight) in given {
            if steps > MAX_DELAY {
                return Err(format!("a delay of {steps} control steps is too long"));
            }
            if !(1..=MAX_WEIGHT).contains(&weight) {
                return Err(format!("the weight {weight} is not from 1 to {MAX_WEIGHT}"));
            }
            *weighted.entry(steps).or_default() += weight;
        }
        let too_heavy = weighted.iter().find(|(_, weight)| **weight > MAX_WEIGHT);
        if let (2.., Some((steps, weight))) = (weighted.len(), too_heavy) {
            return Err(format!(
                "the weights of delay {steps} add up to {weight}, at most {MAX_WEIGHT} is possible"
            ));
        }
        match weighted.len() {
            0 => Err("no delay is given".to_owned()),
            1 => Ok(Self { weighted: weighted.into_keys().map(|steps| (steps, 1)).collect() }),
            2..=MAX_DISTINCT_DELAYS => Ok(Self { weighted: weighted.into_iter().collect() }),
            count => Err(format!(
                "{count} different delays are given, at most {MAX_DISTINCT_DELAYS} are possible"
            )),
        }
    }

    /// Creates the distribution of measured latencies from pairs of control steps and counts.
    /// The weight of a latency is its share of all counts in thousandths, at least one thousandth.
    pub fn measured(
        counts: impl IntoIterator<Item = (u16, u64)>,
    ) -> Result<Self, LatencyFileError> {
        let counts: Vec<(u16, u64)> = counts.into_iter().filter(|(_, count)| *count > 0).collect();
        let total = counts.iter().map(|(_, count)| *count as f64).sum::<f64>();
        let weight = |count: u64| {
            let thousandths = count as f64 / total * f64::from(MAX_WEIGHT);
            (thousandths.round() as u32).max(1)
        };
        Self::weighted(counts.iter().map(|&(steps, count)| (steps, weight(count))))
            .map_err(|problem| LatencyFileError { problem })
    }

    /// Parses a file of measured latencies: JSON with the number of responses by delay in
    /// control steps, `{"delay_steps": {"3": 812, "4": 188}}`. Other fields are ignored.
    pub fn from_json(text: &str) -> Result<Self, LatencyFileError> {
        #[derive(Deserialize)]
        struct File {
            delay_steps: std::collections::BTreeMap<u16, u64>,
        }
        let file: File = serde_json::from_str(text).map_err(|error| LatencyFileError {
            problem: crate::wording::JsonError::from(error).to_string(),
        })?;
        Self::measured(file.delay_steps)
    }

    pub fn shortest(&self) -> u16 {
        self.weighted[0].0
    }

    pub fn longest(&self) -> u16 {
        self.weighted[self.weighted.len() - 1].0
    }

    /// Returns the delay of the response to a query. The delay is the same in all rollouts of a
    /// task from the same initial state, regardless of the perturbation, so that paired rollouts
    /// have the same delays.
    pub fn of_query(&self, task: TaskRef, init_id: u16, query: u32) -> u16 {
        if let [(only, _)] = self.weighted[..] {
            return only;
        }
        let stream = MatchedStream::named(&format!("{STREAM_VERSION}/{task}/i{init_id}"));
        self.pick(&mut stream.at(query, 0))
    }

    fn pick(&self, rng: &mut MatchedRng) -> u16 {
        let total: u32 = self.weighted.iter().map(|(_, weight)| weight).sum();
        let mut position = rng.random() * f64::from(total);
        for &(steps, weight) in &self.weighted {
            position -= f64::from(weight);
            if position < 0.0 {
                return steps;
            }
        }
        self.longest()
    }
}

impl fmt::Display for Delays {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let [(only, _)] = self.weighted[..] {
            return write!(f, "{only}");
        }
        let terms = self.weighted.iter();
        let terms: Vec<String> = terms.map(|(steps, weight)| format!("{steps}*{weight}")).collect();
        f.write_str(&terms.join("+"))
    }
}

impl fmt::Display for Execution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Wait => f.write_str("wait"),
            Self::Hold(delays) => write!(f, "hold:{delays}"),
            Self::Overlap { delays, rtc: false } => write!(f, "overlap:{delays}"),
            Self::Overlap { delays, rtc: true } => write!(f, "overlap:{delays},rtc"),
        }
    }
}

impl FromStr for Delays {
    type Err = ExecutionError;

    fn from_str(text: &str) -> Result<Self, ExecutionError> {
        delays(text).map_err(|problem| ExecutionError { problem })
    }
}

impl FromStr for Execution {
    type Err = ExecutionError;

    fn from_str(text: &str) -> Result<Self, ExecutionError> {
        let error = |problem: String| ExecutionError { problem };
        if text.is_empty() {
            return Err(error("no model is given".to_owned()));
        }
        if text == "wait" {
            return Ok(Self::Wait);
        }
        let Some((model, rest)) = text.split_once(':') else {
            return Err(error(format!("`{text}` lacks a delay")));
        };
        match model {
            "hold" => Ok(Self::Hold(delays(rest).map_err(error)?)),
            "overlap" => {
                let without_rtc = rest.strip_suffix(",rtc");
                Ok(Self::Overlap {
                    delays: delays(without_rtc.unwrap_or(rest)).map_err(error)?,
                    rtc: without_rtc.is_some(),
                })
            }
            other => Err(error(format!("there is no model `{other}`"))),
        }
    }
}

/// Parses delays; the error is a clause for the message of [`ExecutionError`].
fn delays(text: &str) -> Result<Delays, String> {
    let number = |text: &str| -> Result<u32, String> {
        // Rejects signs and spaces, so that each model has only one text.
        let digits = Some(text).filter(|text| text.bytes().all(|byte| byte.is_ascii_digit()));
        let value = digits.and_then(|digits| digits.parse().ok());
        value.ok_or_else(|| match text {
            "" => "a number is missing".to_owned(),
            _ => format!("`{text}` is not a number"),
        })
    };
    let steps =
        |text: &str| -> Result<u16, String> { Ok(number(text)?.try_into().unwrap_or(u16::MAX)) };
    if !text.contains('*') {
        return Delays::weighted([(steps(text)?, 1)]);
    }
    let mut weighted = Vec::new();
    for term in text.split('+') {
        let Some((delay, weight)) = term.split_once('*') else {
            return Err(format!("`{term}` has no weight"));
        };
        weighted.push((steps(delay)?, number(weight)?));
    }
    Delays::weighted(weighted)
}

serde_as_text!(Execution);
