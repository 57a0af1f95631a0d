//! The flags of `coordinator campaign create` for campaigns of LIBERO's family.

use clap::Args;
use libero_ctrl::{Benchmark, Variants};
use libero_family::pro::STATES;
use libero_family::protocol::Protocol;
use terminal::number;

/// Flags of a design, which conflict with `--suite`, `--manifest` and `--spec`.
#[rustfmt::skip]
pub(super) const DESIGN_FLAGS: [&str; 9] = [
    "axes", "subsets", "levels", "configs", "nominal", "design_seed", "directions",
    "placebo_radius", "placebo_configs",
];

/// The flags that take the place of a design.
#[derive(Args, Debug)]
#[command(next_help_heading = "LIBERO-Plus and LIBERO-PRO")]
pub(super) struct VariantFlags {
    /// Variants of a benchmark instead of a design: `libero-plus` or `libero-pro`, with the
    /// unperturbed rollouts of their tasks.
    #[arg(long, value_name = "BENCHMARK", hide_short_help = true,
        conflicts_with_all = DESIGN_FLAGS)]
    suite: Option<Benchmark>,
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
    /// Variants of LIBERO-Plus of these difficulties, 1 to 5, or 0 for those without one.
    #[arg(long = "difficulty", value_name = "N,...", value_delimiter = ',', requires = "suite",
        hide_short_help = true, value_parser = number(0..=5_u8, ""))]
    difficulties: Vec<u8>,
    /// Trials of each task of LIBERO-PRO. If omitted, 50.
    #[arg(long, value_name = "N", requires = "suite", hide_short_help = true,
        value_parser = number(1..=STATES, "trials"))]
    trials: Option<u16>,
    /// Leaves out variants whose files are in no package index.
    #[arg(long, requires = "suite", hide_short_help = true)]
    runnable: bool,
}

impl VariantFlags {
    /// Returns the selection; `None` if no benchmark is named.
    pub(super) fn selection(&self) -> Option<Variants> {
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
