//! The flags of `coordinator campaign create` for campaigns of LIBERO's family.

use std::path::PathBuf;

use clap::Args;
use libero_ctrl::{Benchmark, Rollouts, Variants};
use libero_family::pro::STATES;
use libero_family::protocol::Protocol;
use terminal::number;

use super::command::CommandError;
use super::files::read_suite_file;

/// Flags of a design, which conflict with `--suite`, `--manifest` and `--spec`.
#[rustfmt::skip]
pub(super) const DESIGN_FLAGS: [&str; 9] = [
    "axes", "subsets", "levels", "configs", "nominal", "design_seed", "directions",
    "placebo_radius", "placebo_configs",
];

/// Flags that conflict with `--suite-file`: those for LIBERO-Plus and LIBERO-PRO, and `--manifest`.
#[rustfmt::skip]
const VARIANT_FLAGS: [&str; 8] = [
    "suite", "manifest", "protocol", "variants", "suites", "dimensions", "difficulties", "runnable",
];

/// The flags that take the place of a design.
#[derive(Args, Debug)]
#[command(next_help_heading = "LIBERO-Plus, LIBERO-PRO and further benchmarks")]
pub(super) struct VariantFlags {
    /// Variants of a benchmark instead of a design: `libero-plus` or `libero-pro`, with the
    /// unperturbed rollouts of their tasks.
    #[arg(long, value_name = "BENCHMARK", hide_short_help = true,
        conflicts_with_all = DESIGN_FLAGS)]
    suite: Option<Benchmark>,
    /// Tasks of a suite file instead of a design: a further benchmark in JSON, as docs/FAMILY.md
    /// describes it. `-` reads standard input.
    #[arg(long, value_name = "FILE", hide_short_help = true,
        conflicts_with_all = DESIGN_FLAGS, conflicts_with_all = VARIANT_FLAGS)]
    suite_file: Option<PathBuf>,
    /// Evaluation protocol, see docs/FAMILY.md. If omitted, that of the benchmark's published
    /// table: `plus-official` or `pro-official`.
    #[arg(long, value_name = "NAME", requires = "suite", hide_short_help = true)]
    protocol: Option<Protocol>,
    /// Variants of LIBERO-Plus, by the benchmark's names.
    #[arg(
        long = "variant",
        value_name = "NAME,...",
        value_delimiter = ',',
        requires = "suite",
        hide_short_help = true
    )]
    variants: Vec<String>,
    /// Variants of these suites: `libero_goal` of LIBERO-Plus, `libero_goal_swap` of LIBERO-PRO.
    #[arg(
        long,
        value_name = "SUITE,...",
        value_delimiter = ',',
        requires = "suite",
        hide_short_help = true
    )]
    suites: Vec<String>,
    /// Variants of LIBERO-Plus in these dimensions: background, robot, camera, language, noise,
    /// layout, light.
    #[arg(
        long = "dimension",
        value_name = "NAME,...",
        value_delimiter = ',',
        requires = "suite",
        hide_short_help = true
    )]
    dimensions: Vec<String>,
    /// Variants of LIBERO-Plus of these difficulties: 1 to 5, or 0 for variants without a
    /// difficulty.
    #[arg(long = "difficulty", value_name = "N,...", value_delimiter = ',', requires = "suite",
        hide_short_help = true, value_parser = number(0..=5_u8, ""))]
    difficulties: Vec<u8>,
    /// Trials of each task of LIBERO-PRO or of a suite file. If omitted, 50 for LIBERO-PRO, and the
    /// number in the suite file.
    #[arg(long, value_name = "N", requires = "of_benchmark", hide_short_help = true,
        value_parser = number(1..=STATES, "trials"))]
    trials: Option<u16>,
    /// Leave out variants whose files are in no package index.
    #[arg(long, requires = "suite", hide_short_help = true)]
    runnable: bool,
}

impl VariantFlags {
    /// Returns the selected rollouts; `None` if no benchmark and no suite file is named.
    pub(super) fn rollouts(&self) -> Result<Option<Rollouts>, CommandError> {
        let Some(path) = &self.suite_file else {
            return Ok(self.selection().map(Rollouts::Variants));
        };
        let mut file = read_suite_file(path)?;
        file.trials = self.trials.unwrap_or(file.trials);
        Ok(Some(Rollouts::SuiteFile(Box::new(file))))
    }

    fn selection(&self) -> Option<Variants> {
        let benchmark = self.suite?;
        let protocol = self.protocol.unwrap_or(Protocol::official(benchmark));
        Some(Variants {
            benchmark,
            protocol: protocol.name.to_owned(),
            variants: self.variants.clone(),
            suites: self.suites.clone(),
            dimensions: self.dimensions.clone(),
            difficulties: self.difficulties.clone(),
            trials: self.trials,
            runnable: self.runnable,
        })
    }
}
