//! Named protocols: a harness's initial state, prompt and step budget for a rollout of a
//! variant. Results of different protocols are not comparable.

use std::fmt;
use std::str::FromStr;

pub use crate::{Beginning, Benchmark};
use crate::{Suite, UnknownName};

use crate::family::plus::Prompt;
use crate::family::selection::SelectionError;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Protocol {
    pub name: &'static str,
    pub benchmark: Benchmark,
    pub beginning: Beginning,
    pub prompt: Prompt,
    pub seed: u32,
    /// Number of control steps with the no-op action before the policy's first observation.
    pub waits: u32,
    /// Step budgets of the policy, in the order of [`Suite::ALL`].
    budgets: [u32; 4],
    /// Source code that the settings are taken from.
    pub source: &'static str,
}

/// Step budgets of openvla-oft, which most harnesses use.
const BUDGETS: [u32; 4] = [220, 280, 300, 520];

pub const PROTOCOLS: [Protocol; 9] = [
    Protocol {
        name: "plus-official",
        benchmark: Benchmark::Plus,
        beginning: Beginning::InitialState,
        prompt: Prompt::Released,
        seed: 0,
        waits: 10,
        budgets: BUDGETS,
        source: "openvla-oft as evaluated by LIBERO-plus, the source of the published table",
    },
    Protocol {
        name: "plus-openpi",
        benchmark: Benchmark::Plus,
        beginning: Beginning::InitialState,
        prompt: Prompt::Released,
        seed: 7,
        waits: 10,
        budgets: BUDGETS,
        source: "openpi 15a9616, examples/libero/main.py; the same in starVLA 0ed0aad and vla-eval \
                 e1ee9ad",
    },
    Protocol {
        name: "plus-lerobot",
        benchmark: Benchmark::Plus,
        beginning: Beginning::InitialState,
        prompt: Prompt::Released,
        seed: 0,
        waits: 10,
        budgets: [280, 280, 300, 520],
        source: "lerobot 7427f31, whose seed is an argument; 0 here",
    },
    Protocol {
        name: "plus-rlinf",
        benchmark: Benchmark::Plus,
        beginning: Beginning::Reset,
        prompt: Prompt::Released,
        seed: 0,
        waits: 15,
        budgets: [512; 4],
        source: "RLinf a3816b5 with LIBERO_SUFFIX unset, its first environment at seed 0",
    },
    Protocol {
        name: "plus-stripped",
        benchmark: Benchmark::Plus,
        beginning: Beginning::InitialState,
        prompt: Prompt::Stripped,
        seed: 0,
        waits: 10,
        budgets: BUDGETS,
        source: "this project: plus-official with prompts that do not reveal the change",
    },
    Protocol {
        name: "pro-official",
        benchmark: Benchmark::Pro,
        beginning: Beginning::InitialState,
        prompt: Prompt::Released,
        seed: 0,
        waits: 10,
        budgets: BUDGETS,
        source: "openvla-oft as in LIBERO-PRO's README; the prompt is that of the unperturbed task",
    },
    Protocol {
        name: "pro-openpi",
        benchmark: Benchmark::Pro,
        beginning: Beginning::InitialState,
        prompt: Prompt::Released,
        seed: 7,
        waits: 10,
        budgets: BUDGETS,
        source: "openpi 15a9616, examples/libero/main.py; the prompt is that of the unperturbed \
                 task",
    },
    Protocol {
        name: "pro-bddl",
        benchmark: Benchmark::Pro,
        beginning: Beginning::InitialState,
        prompt: Prompt::Bddl,
        seed: 0,
        waits: 10,
        budgets: BUDGETS,
        source: "this project: pro-official with the BDDL file's sentence as prompt, which states \
                 the changed task",
    },
    Protocol {
        name: "para-official",
        benchmark: Benchmark::Para,
        beginning: Beginning::InitialState,
        prompt: Prompt::Released,
        seed: 7,
        waits: 10,
        budgets: BUDGETS,
        source: "LIBERO-Para dec2d93, eval_scripts/examples; the prompt is the BDDL file's \
                 sentence with its capital letters",
    },
];

impl Protocol {
    pub const PLUS_OFFICIAL: Self = PROTOCOLS[0];
    pub const PRO_OFFICIAL: Self = PROTOCOLS[5];
    pub const PARA_OFFICIAL: Self = PROTOCOLS[8];

    /// Returns the protocol of a benchmark's published table or, for LIBERO-Para, of its scripts.
    pub const fn official(benchmark: Benchmark) -> Self {
        match benchmark {
            Benchmark::Plus => Self::PLUS_OFFICIAL,
            Benchmark::Pro => Self::PRO_OFFICIAL,
            Benchmark::Para => Self::PARA_OFFICIAL,
        }
    }

    pub fn check(&self, benchmark: Benchmark) -> Result<(), SelectionError> {
        match self.benchmark == benchmark {
            true => Ok(()),
            false => {
                Err(SelectionError::Foreign { protocol: self.name, benchmark: benchmark.name() })
            }
        }
    }

    /// Returns the step budget of the policy in a suite; suites that are not LIBERO's have that of `Long`.
    pub const fn budget(&self, suite: Suite) -> u32 {
        match suite {
            Suite::Spatial => self.budgets[0],
            Suite::Object => self.budgets[1],
            Suite::Goal => self.budgets[2],
            Suite::Long | Suite::Own | Suite::Simulated => self.budgets[3],
        }
    }
}

impl fmt::Display for Protocol {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl FromStr for Protocol {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        PROTOCOLS.into_iter().find(|protocol| protocol.name == text).ok_or_else(|| UnknownName {
            kind: "protocol",
            given: text.to_owned(),
            valid: PROTOCOLS.map(|protocol| protocol.name).join(", "),
        })
    }
}
