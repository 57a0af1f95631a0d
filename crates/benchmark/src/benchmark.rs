//! Benchmarks of LIBERO's family, whose variants a campaign can run. `family` defines the
//! variants.

use std::fmt;
use std::str::FromStr;

use crate::names::{UnknownName, serde_as_text};

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Benchmark {
    Plus,
    Pro,
    Para,
}

impl Benchmark {
    pub const ALL: [Self; 3] = [Self::Plus, Self::Pro, Self::Para];

    /// Returns the name in results, which is also the name of the folder of the task files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Plus => "libero-plus",
            Self::Pro => "libero-pro",
            Self::Para => "libero-para",
        }
    }

    /// Returns the name in rollout ids.
    pub const fn tag(self) -> &'static str {
        match self {
            Self::Plus => "plus",
            Self::Pro => "pro",
            Self::Para => "para",
        }
    }

    pub const fn fetch_command(self) -> &'static str {
        match self {
            Self::Plus => "worker assets fetch --suite libero-plus",
            Self::Pro => "worker assets fetch --suite libero-pro",
            Self::Para => {
                "git clone https://github.com/cau-hai-lab/LIBERO-Para && git -C LIBERO-Para \
                 checkout dec2d93 && worker assets fetch --suite libero-para --checkout LIBERO-Para"
            }
        }
    }

    /// Returns the benchmark with the given name in rollout ids.
    pub(crate) fn from_tag(tag: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|benchmark| benchmark.tag() == tag)
    }
}

impl fmt::Display for Benchmark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Benchmark {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        Self::ALL
            .into_iter()
            .find(|benchmark| benchmark.name() == text)
            .ok_or_else(|| UnknownName::new("benchmark", text, &Self::ALL.map(Self::name)))
    }
}

serde_as_text!(Benchmark);
